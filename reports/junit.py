"""JUnit XML: a test case for each trial of a run; and the elements of any such file."""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree

from gridtrack.common.errors import printable
from gridtrack.reports.chosen_scores import ExportedTable
from gridtrack.reports.notices import outcome_text

REPORT_SUITE = "gridtrack report"


def junit_of_tables(exported: Sequence[ExportedTable]) -> str:
    """A test case for each tracker on each recording, with its scores as output. A trial without a rank is a failure,
    with its reason."""
    cases = [(one.table, row) for one in exported if not one.table.pooled for row in one.table.rows]
    failures = sum(row.group == "unranked" for _, row in cases)
    suite = junit_suite(REPORT_SUITE, tests=len(cases), failures=failures, errors=0, skipped=0)
    for table, row in cases:
        case = junit_case(suite, row.name, table.recording)
        if row.group == "unranked":
            ElementTree.SubElement(case, "failure", message=printable(outcome_text(row)))
        scores = [f"{c.group} {c.heading}: {cell.text}" for c, cell in zip(table.columns, row.cells, strict=True)]
        ElementTree.SubElement(case, "system-out").text = printable("; ".join(scores))
    return xml_of(suite)


def junit_suite(name: str, **counts: int) -> ElementTree.Element:
    """A test suite with the numbers of its cases: `tests`, `failures`, `errors`, `skipped`."""
    return ElementTree.Element("testsuite", {"name": name} | {name: str(count) for name, count in counts.items()})


def junit_case(suite: ElementTree.Element, label: str, name: str) -> ElementTree.Element:
    """A new test case of a tracker in the suite."""
    classname = f"{suite.get('name')}.{printable(label)}"
    return ElementTree.SubElement(suite, "testcase", classname=classname, name=printable(name))


def xml_of(suite: ElementTree.Element) -> str:
    """The file of a suite."""
    ElementTree.indent(suite)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ElementTree.tostring(suite, encoding="unicode") + "\n"

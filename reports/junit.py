"""JUnit XML: of the regression gate a test case for each comparison, of a run one for each trial."""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree

from gridtrack.common.errors import printable
from gridtrack.evaluation.regression.recoveries import RecoveryRow
from gridtrack.evaluation.regression.speed import SpeedRow, TurnsRow
from gridtrack.evaluation.regression.verdict import AnyRow, Verdict
from gridtrack.reports.chosen_scores import ExportedTable
from gridtrack.reports.notices import outcome_text
from gridtrack.reports.verdict_text import place_of, rule_of, second_text, sentence_of

SUITE = "gridtrack regress"
REPORT_SUITE = "gridtrack report"


def junit_of(verdict: Verdict) -> str:
    """A test case for each tracker, score, stratum and step band, for each collapse, each tracker that recovered from
    failures, and each speed. A worse one is a failure; the output of each has the smallest fall that would be one."""
    rows, failures = verdict.decisive, len(verdict.worse)
    skipped = sum(row.verdict == "nothing to find" for row in rows)
    suite = _suite(tests=len(rows), failures=failures, errors=0, skipped=skipped)
    for row in rows:
        case = _case(suite, row.label, _case_name(row))
        sentence = printable(f"{sentence_of(row)}{second_text(verdict, row)}")
        if verdict.standing_of(row) == "worse":
            ElementTree.SubElement(case, "failure", message=sentence)
        elif row.verdict == "nothing to find":
            ElementTree.SubElement(case, "skipped", message="no cell was occupied")
        if row.verdict != "nothing to find":
            ElementTree.SubElement(case, "system-out").text = sentence
    ElementTree.SubElement(suite, "system-out").text = printable("; ".join([rule_of(verdict), *verdict.notes]))
    return _xml(suite)


def junit_of_unmeasured(reasons: Sequence[str]) -> str:
    """A test case with an error for each reason why nothing was measured."""
    suite = _suite(tests=len(reasons), failures=0, errors=len(reasons), skipped=0)
    for number, reason in enumerate(reasons, 1):
        ElementTree.SubElement(_case(suite, "run", f"measured {number}"), "error", message=printable(reason))
    return _xml(suite)


def junit_of_tables(exported: Sequence[ExportedTable]) -> str:
    """A test case for each tracker on each recording: a trial that is not ranked is a failure, with its reason; the
    output of each has its scores."""
    cases = [(one.table, row) for one in exported if not one.table.pooled for row in one.table.rows]
    failures = sum(row.group == "unranked" for _, row in cases)
    suite = _suite(REPORT_SUITE, tests=len(cases), failures=failures, errors=0, skipped=0)
    for table, row in cases:
        case = _case(suite, row.name, table.recording)
        if row.group == "unranked":
            ElementTree.SubElement(case, "failure", message=printable(outcome_text(row)))
        scores = [f"{c.group} {c.heading}: {cell.text}" for c, cell in zip(table.columns, row.cells, strict=True)]
        ElementTree.SubElement(case, "system-out").text = printable("; ".join(scores))
    return _xml(suite)


def _suite(name: str = SUITE, **counts: int) -> ElementTree.Element:
    return ElementTree.Element("testsuite", {"name": name} | {name: str(count) for name, count in counts.items()})


def _case(suite: ElementTree.Element, label: str, name: str) -> ElementTree.Element:
    classname = f"{suite.get('name')}.{printable(label)}"
    return ElementTree.SubElement(suite, "testcase", classname=classname, name=printable(name))


def _case_name(row: AnyRow) -> str:
    if isinstance(row, SpeedRow):
        return f"speed of {row.call}"
    if isinstance(row, TurnsRow):
        return f"speed of {row.call} in turns with {row.base}"
    if isinstance(row, RecoveryRow):
        return "recoveries"
    return f"{f'{row.recording}: ' if row.recording else ''}{row.score}, {place_of(row)}"


def _xml(suite: ElementTree.Element) -> str:
    ElementTree.indent(suite)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ElementTree.tostring(suite, encoding="unicode") + "\n"

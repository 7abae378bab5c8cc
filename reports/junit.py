"""The verdict of the regression gate as JUnit XML: a test case for each comparison."""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree

from gridtrack.common.errors import printable
from gridtrack.evaluation.regression.recoveries import RecoveryRow
from gridtrack.evaluation.regression.speed import SpeedRow
from gridtrack.evaluation.regression.verdict import AnyRow, Verdict
from gridtrack.reports.regression import place_of, rule_of, sentence_of

SUITE = "gridtrack regress"


def junit_of(verdict: Verdict) -> str:
    """A test case for each tracker, score, stratum and step band, for each collapse, each tracker that recovered from
    failures, and each speed. A worse one is a failure; the output of each has the smallest fall that would be one."""
    rows, failures = verdict.decisive, len(verdict.worse)
    skipped = sum(row.verdict == "nothing to find" for row in rows)
    suite = _suite(tests=len(rows), failures=failures, errors=0, skipped=skipped)
    for row in rows:
        case = _case(suite, row.label, _case_name(row))
        if row.verdict == "worse":
            ElementTree.SubElement(case, "failure", message=printable(sentence_of(row)))
        elif row.verdict == "nothing to find":
            ElementTree.SubElement(case, "skipped", message="no cell was occupied")
        if row.verdict != "nothing to find":
            ElementTree.SubElement(case, "system-out").text = printable(sentence_of(row))
    ElementTree.SubElement(suite, "system-out").text = printable("; ".join([rule_of(verdict), *verdict.notes]))
    return _xml(suite)


def junit_of_unmeasured(reasons: Sequence[str]) -> str:
    """A test case with an error for each reason why nothing was measured."""
    suite = _suite(tests=len(reasons), failures=0, errors=len(reasons), skipped=0)
    for number, reason in enumerate(reasons, 1):
        ElementTree.SubElement(_case(suite, "run", f"measured {number}"), "error", message=printable(reason))
    return _xml(suite)


def _suite(**counts: int) -> ElementTree.Element:
    return ElementTree.Element("testsuite", {"name": SUITE} | {name: str(count) for name, count in counts.items()})


def _case(suite: ElementTree.Element, label: str, name: str) -> ElementTree.Element:
    return ElementTree.SubElement(suite, "testcase", classname=f"{SUITE}.{printable(label)}", name=printable(name))


def _case_name(row: AnyRow) -> str:
    if isinstance(row, SpeedRow):
        return f"speed of {row.call}"
    if isinstance(row, RecoveryRow):
        return "recoveries"
    return f"{f'{row.recording}: ' if row.recording else ''}{row.score}, {place_of(row)}"


def _xml(suite: ElementTree.Element) -> str:
    ElementTree.indent(suite)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ElementTree.tostring(suite, encoding="unicode") + "\n"

"""Each tracker against the reference, laid out: differences in F1 with their intervals, and what they show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from gridtrack.reports.run import UNDEFINED, Difference, HeadlineTest, Run


@dataclass(frozen=True)
class DifferenceCell:
    """One comparison of the family in words."""

    value: str
    interval: str
    p: str
    verdict: str


@dataclass(frozen=True)
class DifferenceRow:
    """One tracker: its comparisons in the order of the columns, or why there are none."""

    tracker: str
    shown: tuple[DifferenceCell, ...]
    why_none: str


@dataclass(frozen=True)
class DifferenceTable:
    """All trackers against the reference on one recording, or on all together."""

    reference: str
    columns: tuple[tuple[str, float], ...]
    """Stratum and horizon, seconds."""
    units: str
    rows: tuple[DifferenceRow, ...]


def difference_table(run: Run, recording: str) -> DifferenceTable | None:
    """Those of one recording of a run; None where there are none, or nothing could be tested."""
    found = [one for one in run.summary.differences if one.recordings == recording]
    tested = [one for one in found if one.headline and not one.interval]
    if not tested:
        return None
    columns = tuple((test.stratum, test.horizon_s) for test in tested[0].headline)
    rows = tuple(DifferenceRow(one.tracker, _tests(one, columns), one.interval) for one in found)
    return DifferenceTable(tested[0].reference, columns, f"{tested[0].units} units, {tested[0].frames} frames", rows)


def _tests(difference: Difference, columns: Sequence[tuple[str, float]]) -> tuple[DifferenceCell, ...]:
    if difference.interval:
        return ()
    tests = {(test.stratum, test.horizon_s): test for test in difference.headline}
    return tuple(_shown(tests.get(column)) for column in columns)


def _shown(test: HeadlineTest | None) -> DifferenceCell:
    if test is None or test.f1 is None:
        return DifferenceCell(UNDEFINED, "", "", "not tested")
    interval = "" if test.f1_low is None or test.f1_high is None else f"[{test.f1_low:+.3f}, {test.f1_high:+.3f}]"
    return DifferenceCell(f"{test.f1:+.3f}", interval, _p(test.p_holm), test.verdict)


def _p(p: float | None) -> str:
    if p is None:
        return ""
    return "p < 0.001" if p < 0.001 else f"p = {p:.3f}"


def difference_markdown(differences: DifferenceTable) -> str:
    """The table for a terminal or a CI log."""
    head = ["tracker", *(f"{stratum} {horizon_s:g} s" for stratum, horizon_s in differences.columns)]
    lines = [head, ["---"] * len(head)]
    for row in differences.rows:
        shown = [f"{s.value} {s.interval} {s.p} {s.verdict}" for s in row.shown] or [row.why_none] + [""] * (
            len(differences.columns) - 1
        )
        lines.append([" ".join(row.tracker.replace("|", "\\|").split()), *shown])
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)

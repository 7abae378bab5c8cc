"""Each tracker against the reference, as a table: differences in F1 with intervals, p-values and verdicts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from gridtrack.evaluation.results.summary import HeadlineTest, TrackerDifference
from gridtrack.reports.markdown import cell_text, markdown_table
from gridtrack.reports.run import UNDEFINED, Run
from gridtrack.reports.table import LEAK


@dataclass(frozen=True)
class DifferenceCell:
    """One comparison of the family, as text."""

    value: str
    interval: str
    p: str
    verdict: str


@dataclass(frozen=True)
class DifferenceRow:
    """One tracker: its comparisons in the order of the columns, or the reason why there are none."""

    tracker: str
    cells: tuple[DifferenceCell, ...]
    reason: str


@dataclass(frozen=True)
class DifferenceTable:
    """All trackers against the reference, on one recording or pooled over all."""

    reference: str
    columns: tuple[tuple[str, float], ...]
    """Stratum and horizon, seconds."""
    units: str
    rows: tuple[DifferenceRow, ...]


def difference_table(run: Run, recording: str) -> DifferenceTable | None:
    """The table of one recording of a run; None where no tracker could be tested."""
    found = [one for one in run.summary.differences if one.recordings == recording]
    tested = [one for one in found if one.headline and not one.interval]
    if not tested:
        return None
    columns = tuple((test.stratum, test.horizon_s) for test in tested[0].headline)
    rows = tuple(
        DifferenceRow(_marked(run, one.tracker, recording), _cells_of(one, columns), one.interval) for one in found
    )
    reference = _marked(run, tested[0].reference, recording)
    return DifferenceTable(reference, columns, f"{tested[0].units} units, {tested[0].frames} frames", rows)


def _marked(run: Run, label: str, recording: str) -> str:
    """The label, marked where the tracker learned from frames of the recording."""
    row = run.summary.trackers.get(label)
    trial = row.recordings.get(recording) if row else None
    return f"{label} ({LEAK})" if trial and trial.leak else label


def _cells_of(difference: TrackerDifference, columns: Sequence[tuple[str, float]]) -> tuple[DifferenceCell, ...]:
    if difference.interval:
        return ()
    tests = {(test.stratum, test.horizon_s): test for test in difference.headline}
    return tuple(_difference_cell(tests.get(column)) for column in columns)


def _difference_cell(test: HeadlineTest | None) -> DifferenceCell:
    if test is None or test.f1 is None:
        return DifferenceCell(UNDEFINED, "", "", "not tested")
    interval = "" if test.f1_low is None or test.f1_high is None else f"[{test.f1_low:+.3f}, {test.f1_high:+.3f}]"
    return DifferenceCell(f"{test.f1:+.3f}", interval, p_text(test.p_holm), test.verdict)


def p_text(p: float | None) -> str:
    """A p-value with its letter; empty where there is none."""
    if p is None:
        return ""
    return "p < 0.001" if p < 0.001 else f"p = {p:.3f}"


def difference_markdown(differences: DifferenceTable) -> str:
    """The table as Markdown, for a terminal or a log of continuous integration."""
    headings = ["tracker", *(f"{stratum} {horizon_s:g} s" for stratum, horizon_s in differences.columns)]
    empty = [""] * (len(differences.columns) - 1)
    rows = []
    for row in differences.rows:
        cells = [f"{cell.value} {cell.interval} {cell.p} {cell.verdict}" for cell in row.cells]
        rows.append([cell_text(row.tracker), *(cells or [row.reason, *empty])])
    return markdown_table(headings, rows)

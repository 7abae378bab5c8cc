"""Each tracker against the reference, as a table: differences with intervals and p-values, in F1 with verdicts."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from gridtrack.evaluation.runs.summary import HeadlineTest, TrackerDifference
from gridtrack.reports.markdown import cell_text, markdown_table
from gridtrack.reports.run import UNDEFINED, ReportedRun
from gridtrack.reports.table import FORGIVING, FORGIVING_NAME, name_in

BESIDE_F1 = {
    "nll": ("log loss", 4),
    "pr_auc": ("PR-AUC", 3),
    FORGIVING: (FORGIVING_NAME, 3),
    "soft_iou": ("soft IoU", 3),
    "beam_error": ("beam error, m", 3),
}
"""Scores that have a line each below F1: their names, and the digits of a difference."""


@dataclass(frozen=True)
class DifferenceCell:
    """One comparison of the family, as text."""

    value: str
    interval: str
    p: str
    verdict: str


@dataclass(frozen=True)
class DifferenceRow:
    """One tracker and score: the comparisons in the order of the columns, or the reason why there are none."""

    tracker: str
    name: str
    """The label of the tracker as it is shown."""
    score: str
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


def difference_table(run: ReportedRun, recording: str) -> DifferenceTable | None:
    """The table of one recording of a run; None where no tracker could be tested."""
    found = [one for one in run.summary.differences if one.recordings == recording]
    tested = [one for one in found if one.headline and not one.interval]
    if not tested:
        return None
    columns = tuple((test.stratum, test.horizon_s) for test in tested[0].headline)
    rows = tuple(row for one in found for row in _rows_of(one, name_in(run, one.tracker, recording), columns))
    units = f"{tested[0].units} units, {tested[0].frames} frames"
    return DifferenceTable(name_in(run, tested[0].reference, recording), columns, units, rows)


def _rows_of(difference: TrackerDifference, name: str, columns: Sequence[tuple[str, float]]) -> Iterator[DifferenceRow]:
    """The row of F1, and where there was a comparison those of the other scores that the run has."""
    label = difference.tracker
    if difference.interval:
        yield DifferenceRow(label, name, "F1", (), difference.interval)
        return
    tests = {(test.stratum, test.horizon_s): test for test in difference.headline}
    chosen = [tests.get(column) for column in columns]
    yield DifferenceRow(label, name, "F1", tuple(_f1_cell(test) for test in chosen), "")
    for score, (score_name, digits) in BESIDE_F1.items():
        if any(test is not None and getattr(test, score) is not None for test in chosen):
            cells = tuple(_uncorrected_cell(test, score, digits) for test in chosen)
            yield DifferenceRow(label, name, score_name, cells, "")


def _f1_cell(test: HeadlineTest | None) -> DifferenceCell:
    if test is None or test.f1 is None:
        return DifferenceCell(UNDEFINED, "", "", "not tested")
    interval = interval_text(test.f1_low, test.f1_high, 3)
    return DifferenceCell(f"{test.f1:+.3f}", interval, p_text(test.p_holm), test.verdict)


def _uncorrected_cell(test: HeadlineTest | None, score: str, digits: int) -> DifferenceCell:
    value = None if test is None else getattr(test, score)
    if value is None:
        return DifferenceCell(UNDEFINED, "", "", "not tested")
    low, high, p = (getattr(test, f"{score}_{end}") for end in ("low", "high", "p"))
    return DifferenceCell(f"{value:+.{digits}f}", interval_text(low, high, digits), p_text(p), "uncorrected")


def interval_text(low: float | None, high: float | None, digits: int) -> str:
    """An interval of differences with their signs; empty where there is none."""
    return "" if low is None or high is None else f"[{low:+.{digits}f}, {high:+.{digits}f}]"


def p_text(p: float | None) -> str:
    """A p-value with its letter; empty where there is none."""
    if p is None:
        return ""
    return "p < 0.001" if p < 0.001 else f"p = {p:.3f}"


def difference_markdown(differences: DifferenceTable, text: Callable[[str], str] = cell_text) -> str:
    """The table as Markdown, with names as `text` writes them."""
    headings = ["tracker", *(f"{stratum} {horizon_s:g} s" for stratum, horizon_s in differences.columns)]
    empty = [""] * (len(differences.columns) - 1)
    rows = []
    for row in differences.rows:
        cells = [f"{cell.value} {cell.interval} {cell.p} {cell.verdict}" for cell in row.cells]
        rows.append([f"{text(row.name)}, {row.score}", *(cells or [text(row.reason), *empty])])
    return markdown_table(headings, rows)

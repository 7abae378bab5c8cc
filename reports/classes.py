"""Scores of classes: the recall of each class, and the quality of the class probabilities of occupied cells."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from gridtrack.evaluation.runs.result_files import Curve
from gridtrack.evaluation.runs.summary import ClassDifference, ClassScores, TrialSummary
from gridtrack.evaluation.scoring.semantics import VISIBILITIES
from gridtrack.reports.run import ReportedRun
from gridtrack.reports.table import HeadlineTable, TableRow, name_in


@dataclass(frozen=True)
class ClassCell:
    """The class probabilities of one tracker, on cells of one visibility at one step.

    `loss` is the log loss of a scan and `accuracy` the balanced accuracy; `difference` is the log loss less that of the
    reference. None where it is not known.
    """

    loss: float | None
    interval: tuple[float, float] | None
    difference: float | None
    difference_interval: tuple[float, float] | None
    accuracy: float | None


@dataclass(frozen=True)
class ClassRow:
    """One tracker that forecasts classes: its cells in the order of the columns."""

    row: TableRow
    cells: tuple[ClassCell, ...]


@dataclass(frozen=True)
class ClassTables:
    """Recall by class at the decisive step, and the class probabilities at step 0 and at the decisive step."""

    horizon: str
    recall_columns: tuple[tuple[str, str], ...]
    """Visibility and class of each column."""
    recalls: tuple[tuple[TableRow, tuple[float | None, ...]], ...]
    columns: tuple[tuple[str, str], ...]
    """Visibility and horizon of each pair of columns; none where no tracker forecasts classes."""
    rows: tuple[ClassRow, ...]
    reference: str
    """The row that the differences are taken from; empty where there are none."""
    why_no_interval: str
    """Why the log loss has no interval; empty where it has one."""


def class_tables(table: HeadlineTable, run: ReportedRun | None) -> ClassTables | None:
    """The tables of a recording whose classes are known; None for one without.

    Differences are those of `run`; with None there are none.
    """
    rows = [row for row in table.rows if row.trial.recall_by_class]
    if not rows:
        return None
    step, horizon = table.decisive.step, table.decisive.heading
    recall_columns = tuple(dict.fromkeys(column for row in rows for column in _occurring(row.trial, step)))
    forecasting = [row for row in rows if row.trial.semantics]
    visibilities = [v for v in VISIBILITIES if any(_class_scores(row.trial, v) for row in forecasting)]
    columns = [(visibility, when, at) for visibility in visibilities for when, at in (("now", 0), (horizon, step))]
    differences = run.summary.class_differences if run else ()
    paired = {one.tracker: one for one in differences if one.recordings == table.recording}
    found = [scores for row in forecasting for v in visibilities if (scores := _class_scores(row.trial, v))]
    return ClassTables(
        horizon,
        recall_columns,
        tuple((row, _recalls(row.trial, recall_columns, step)) for row in rows),
        tuple((visibility, when) for visibility, when, _ in columns),
        tuple(ClassRow(row, tuple(_class_cell(row, v, at, paired) for v, _, at in columns)) for row in forecasting),
        next((name_in(run, one.reference, table.recording) for one in paired.values() if run), ""),
        next((scores.interval for scores in found if scores.interval), ""),
    )


def _occurring(trial: TrialSummary, step: int) -> Iterator[tuple[str, str]]:
    """Visibility and class of which there are cells at `step`."""
    recalls = trial.recall_by_class or {}
    return ((v, name) for v in VISIBILITIES for name, c in recalls.get(v, {}).items() if c.cells[step])


def _recalls(trial: TrialSummary, columns: Sequence[tuple[str, str]], step: int) -> tuple[float | None, ...]:
    recalls = trial.recall_by_class or {}
    found = (recalls.get(visibility, {}).get(name) for visibility, name in columns)
    return tuple(None if one is None else one.recall[step] for one in found)


def _class_scores(trial: TrialSummary, visibility: str) -> ClassScores | None:
    return trial.semantics.kinds.get(visibility) if trial.semantics else None


def _class_cell(row: TableRow, visibility: str, step: int, differences: Mapping[str, ClassDifference]) -> ClassCell:
    scores = _class_scores(row.trial, visibility)
    if scores is None:
        return ClassCell(None, None, None, None, None)
    paired = differences[row.label].kinds.get(visibility) if row.label in differences else None
    return ClassCell(
        scores.nll_per_scan[step],
        _interval_at(scores.nll_per_scan_low, scores.nll_per_scan_high, step),
        None if paired is None else paired.nll_per_scan[step],
        None if paired is None else _interval_at(paired.nll_per_scan_low, paired.nll_per_scan_high, step),
        scores.balanced_accuracy[step],
    )


def _interval_at(low: Curve | None, high: Curve | None, step: int) -> tuple[float, float] | None:
    ends = (low[step] if low else None), (high[step] if high else None)
    return None if ends[0] is None or ends[1] is None else (ends[0], ends[1])

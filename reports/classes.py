"""What things are, on the page: which of each class were found, and what occupied cells were taken for."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from gridtrack.reports.run import ClassDifference, Run
from gridtrack.reports.table import HeadlineTable, TableRow
from gridtrack.reports.trial import ClassScores, Curve, Trial

KINDS = ("visible", "occluded")
Value = float | None
Interval = tuple[float, float] | None


@dataclass(frozen=True)
class Meaning:
    """What a tracker took the cells of one kind for at one step: log loss a scan, and balanced accuracy.

    `less` is the log loss less that of the reference.
    """

    loss: Value
    interval: Interval
    less: Value
    less_interval: Interval
    accuracy: Value


@dataclass(frozen=True)
class MeaningRow:
    """One tracker that gives classes: its meanings in the order of the columns."""

    row: TableRow
    meanings: tuple[Meaning, ...]


@dataclass(frozen=True)
class ClassTables:
    """What was found of each class at the decisive step, and what cells were taken for, now and then."""

    horizon: str
    columns: tuple[tuple[str, str], ...]
    """Kind and class of every column of recall."""
    recalls: tuple[tuple[TableRow, tuple[Value, ...]], ...]
    meant: tuple[tuple[str, str], ...]
    """Kind and horizon of every column of meanings; none where no tracker gives classes."""
    meanings: tuple[MeaningRow, ...]
    reference: str
    """Whose log loss the others' is set against; empty where nothing is paired."""
    why_none: str
    """Why a log loss has no interval, where it has none."""


def class_tables(table: HeadlineTable, run: Run | None) -> ClassTables | None:
    """The rows of a recording whose classes are known; None without. Differences are of one `run`, if given."""
    rows = [row for row in table.rows if row.trial.recall_by_class]
    if not rows:
        return None
    step, horizon = table.decisive.step, table.decisive.heading
    columns = tuple(dict.fromkeys(column for row in rows for column in _known(row.trial, step)))
    meaning = [row for row in rows if row.trial.semantics]
    kinds = [kind for kind in KINDS if any(_of_kind(row.trial, kind) for row in meaning)]
    marks = [(kind, when, at) for kind in kinds for when, at in (("now", 0), (horizon, step))]
    paired = run.summary.class_differences if run else ()
    differences = {one.tracker: one for one in paired if one.recordings == table.recording}
    found = [of for row in meaning for kind in kinds if (of := _of_kind(row.trial, kind))]
    return ClassTables(
        horizon,
        columns,
        tuple((row, _recalls(row.trial, columns, step)) for row in rows),
        tuple((kind, when) for kind, when, _ in marks),
        tuple(MeaningRow(row, tuple(_meaning(row, kind, at, differences) for kind, _, at in marks)) for row in meaning),
        next((one.reference for one in differences.values()), ""),
        next((of.interval for of in found if of.interval), ""),
    )


def _known(trial: Trial, step: int) -> Iterator[tuple[str, str]]:
    """Kind and class of what there is to find at `step`."""
    by_kind = trial.recall_by_class or {}
    return ((kind, name) for kind in KINDS for name, c in by_kind.get(kind, {}).items() if c.cells[step])


def _recalls(trial: Trial, columns: Sequence[tuple[str, str]], step: int) -> tuple[Value, ...]:
    by_kind = trial.recall_by_class or {}
    found = (by_kind.get(kind, {}).get(name) for kind, name in columns)
    return tuple(None if one is None else one.recall[step] for one in found)


def _of_kind(trial: Trial, kind: str) -> ClassScores | None:
    return trial.semantics.kinds.get(kind) if trial.semantics else None


def _meaning(row: TableRow, kind: str, step: int, differences: Mapping[str, ClassDifference]) -> Meaning:
    scores = _of_kind(row.trial, kind)
    if scores is None:
        return Meaning(None, None, None, None, None)
    less = differences[row.label].kinds.get(kind) if row.label in differences else None
    return Meaning(
        scores.nll_per_scan[step],
        _interval(scores.nll_per_scan_low, scores.nll_per_scan_high, step),
        None if less is None else less.nll_per_scan[step],
        None if less is None else _interval(less.nll_per_scan_low, less.nll_per_scan_high, step),
        scores.balanced_accuracy[step],
    )


def _interval(low: Curve | None, high: Curve | None, step: int) -> Interval:
    ends = (low[step] if low else None), (high[step] if high else None)
    return None if ends[0] is None or ends[1] is None else (ends[0], ends[1])

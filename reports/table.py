"""The headline table: one row per tracker, the scores that a comparison is read by; the page and the terminal share it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Literal

from gridtrack.reports.run import UNDEFINED, Run, StratumScores, TrackerEntry, Trial

HORIZONS_S = (0.5, 1.0, 2.0, 2.5)
"""The horizons that F1 is shown at, as far as a run looks ahead."""
DETAIL_HORIZON_S = 1.0
"""The horizon of the other scores; also the one that rows are sorted by."""

Standing = Literal["ranked", "floor", "apart"]
"""Complete trials of trackers, complete trials of the floor, and trials that are partial or gave nothing."""


@dataclass(frozen=True)
class Column:
    """A score at one step: where it is found, what it is called, and which way is better (0: neither by itself)."""

    group: str
    heading: str
    stratum: str
    score: str
    step: int
    better: int = 1

    def of(self, trial: Trial) -> float | None:
        """Its value for one trial, None where it is not defined."""
        scores = trial.strata.get(self.stratum)
        return None if scores is None else curve_of(scores, self.score)[self.step]


@dataclass(frozen=True)
class Cell:
    """One number of the table, and whether it is the best of its column among complete trials."""

    value: float | None
    best: bool = False

    @property
    def text(self) -> str:
        """Three decimals, or a dash where the score is not defined."""
        return UNDEFINED if self.value is None else f"{self.value:.3f}"


@dataclass(frozen=True)
class Row:
    """One tracker on one recording."""

    run: str
    label: str
    entry: TrackerEntry
    trial: Trial
    standing: Standing
    cells: tuple[Cell, ...]

    @property
    def name(self) -> str:
        """The label, before it the run where several are shown."""
        return f"{self.run}: {self.label}" if self.run else self.label

    @property
    def frames(self) -> str:
        """Frames scored, of those expected where they differ."""
        scored, expected = self.trial.frames_scored, self.trial.frames_expected
        return str(scored) if scored == expected else f"{scored} of {expected}"


@dataclass(frozen=True)
class HeadlineTable:
    """The table of one recording: rows ranked first, then the floor, then what stands apart."""

    recording: str
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    comparable: bool
    """Whether all rows are of the same frames: only then is a best one marked."""

    @property
    def groups(self) -> tuple[tuple[str, int], ...]:
        """The groups of columns, and how many columns each has."""
        return tuple((group, len(list(columns))) for group, columns in groupby(self.columns, key=lambda c: c.group))

    def standing(self, standing: Standing) -> tuple[Row, ...]:
        """The rows of one standing."""
        return tuple(row for row in self.rows if row.standing == standing)


def headline_tables(runs: Sequence[Run]) -> tuple[HeadlineTable, ...]:
    """One table per recording; with several runs their rows stand in one table, each named by its run."""
    names = dict.fromkeys(name for run in runs for name in run.summary.recordings)
    return tuple(_table(runs, name) for name in names)


def _table(runs: Sequence[Run], recording: str) -> HeadlineTable:
    shown = [run for run in runs if recording in run.summary.recordings]
    columns = tuple(_columns(shown, recording))
    rows = [
        _row(run.name if len(runs) > 1 else "", label, entry, entry.recordings[recording], columns)
        for run in shown
        for label, entry in run.summary.trackers.items()
        if recording in entry.recordings
    ]
    order = ("ranked", "floor", "apart")
    rows.sort(key=lambda row: (order.index(row.standing), -_sort_value(row, columns)))
    stretches = [run.summary.recordings[recording] for run in shown]
    frames = [(stretch, run.identity_of(recording)) for stretch, run in zip(stretches, shown, strict=True)]
    comparable = all(stretch.parity for stretch in stretches) and frames.count(frames[0]) == len(frames)
    return HeadlineTable(recording, columns, tuple(_with_best(rows, columns) if comparable else rows), comparable)


def _columns(runs: Sequence[Run], recording: str) -> Iterator[Column]:
    """The columns that every one of the runs can fill: a step stands for the same horizon in each, or is left out."""
    stretches = [run.summary.recordings[recording] for run in runs]
    for stratum in ("moving", "visible"):
        for horizon_s in HORIZONS_S:
            steps = {stretch.step_at(horizon_s) for stretch in stretches}
            step = steps.pop() if len(steps) == 1 else None
            if step is not None:
                heading = f"{stretches[0].horizons_s[step]:.3g} s"
                yield Column(f"F1, {stratum}", heading, stratum, "f1", step)
    steps = {stretch.step_at(DETAIL_HORIZON_S) for stretch in stretches}
    step = steps.pop() if len(steps) == 1 else None
    if step is not None:
        group = f"moving, {stretches[0].horizons_s[step]:.3g} s"
        yield Column(group, "precision", "moving", "precision", step, 0)
        yield Column(group, "recall", "moving", "recall", step, 0)
        yield Column(group, "log loss", "moving", "nll", step, -1)
        yield Column(group, "Brier", "moving", "brier", step, -1)


def _row(run: str, label: str, entry: TrackerEntry, trial: Trial, columns: Sequence[Column]) -> Row:
    standing: Standing = "apart" if not trial.complete else "floor" if entry.floor else "ranked"
    return Row(run, label, entry, trial, standing, tuple(Cell(column.of(trial)) for column in columns))


def _sort_value(row: Row, columns: Sequence[Column]) -> float:
    """Moving F1 at the detail horizon, or at the first horizon where the run does not look that far."""
    at = next((i for i, c in enumerate(columns) if c.heading == f"{DETAIL_HORIZON_S:.3g} s"), 0)
    value = row.cells[at].value if columns else None
    return -1.0 if value is None else value


def _with_best(rows: Sequence[Row], columns: Sequence[Column]) -> Iterator[Row]:
    """Mark the best complete trials of each column; equal to the shown digits is equally good."""
    best: list[str | None] = []
    for i, column in enumerate(columns):
        values = [v for row in rows if row.standing != "apart" and (v := row.cells[i].value) is not None]
        pick = max if column.better > 0 else min
        best.append(Cell(pick(values)).text if len(values) > 1 and column.better else None)
    for row in rows:
        marked = (replace(cell, best=cell.text == top) for cell, top in zip(row.cells, best, strict=True))
        yield row if row.standing == "apart" else replace(row, cells=tuple(marked))


def curve_of(scores: StratumScores, score: str) -> tuple[float | None, ...]:
    """One score's curve by the name that summary.json gives it."""
    curve: tuple[float | None, ...] = getattr(scores, score)
    return curve


def as_markdown(table: HeadlineTable) -> str:
    """The table for a terminal or a CI log, best numbers in bold; what stands apart is named by its outcome."""
    head = ["tracker", *(f"{c.group} {c.heading}" for c in table.columns), "frames", "outcome"]
    lines = [head, ["---", *("---:" for _ in head[1:-1]), "---"]]
    lines += [
        [_plain(row.name), *(f"**{c.text}**" if c.best else c.text for c in row.cells), row.frames, row.trial.outcome]
        for row in table.rows
    ]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _plain(name: str) -> str:
    """A name that cannot break out of its table cell."""
    return " ".join(name.replace("|", "\\|").split())

"""The figures of scores, such as the precision-recall curve: the points of each row, from the sums of its trials."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.runs.comparisons import TESTED_STRATA
from gridtrack.evaluation.runs.finished import FinishedTrial, RunTrials, units_of
from gridtrack.evaluation.runs.summary import SUMMARY_FILE
from gridtrack.evaluation.runs.sums import ScoresError
from gridtrack.evaluation.scores.definition import Ratio, ScoreDefinition, Sums
from gridtrack.evaluation.scores.registry import built_in
from gridtrack.evaluation.statistics.jackknife import interval, ratio_replicates
from gridtrack.evaluation.statistics.units import UnitRule
from gridtrack.reports.run import ReportedRun
from gridtrack.reports.table import HeadlineTable, TableRow

Figures = dict[str, dict[str, dict[str, dict[str, Any]]]]
"""Points by score, stratum, step and name: numbers, or {value, low, high} of numbers."""


def score_figures(
    runs: Sequence[ReportedRun], tables: Sequence[HeadlineTable]
) -> tuple[dict[tuple[str, str], Figures], tuple[str, ...]]:
    """The figures of each row with scores, by recording and the name of the row, and notices of unreadable files.

    They are for the tested strata and the steps of the headline; scores of classes also for step 0. Pooled rows have
    the trials of their scores. Ratios have an interval if the scores have one, from the same units. Raises RunError and
    ReportError.
    """
    found: dict[tuple[str, str], Figures] = {}
    notices: dict[str, None] = {}
    for run in runs:
        trials = _TrialsOfRows(run)
        for table, row in _rows_of(run, tables):
            try:
                found[table.recording, row.name] = trials.figures(row, table)
            except ScoresError as error:
                notices[f"{row.name}: no curves of its probabilities: {error}"] = None
        notices |= trials.notices
    return found, tuple(notices)


def _rows_of(run: ReportedRun, tables: Sequence[HeadlineTable]) -> Iterator[tuple[HeadlineTable, TableRow]]:
    for table in tables:
        for row in table.rows:
            if row.run in ("", run.name) and row.label in run.summary.trackers and row.trial.strata:
                yield table, row


class _TrialsOfRows:
    """The trials of the rows of a run, and their units. The keys of `notices` are the notices."""

    def __init__(self, run: ReportedRun) -> None:
        self._run, self._trials = run, run.scored_trials()
        self._all = RunTrials({name: run.summary.recordings[name] for name in run.recordings}, [*self._trials.values()])
        self.notices: dict[str, None] = {}

    def figures(self, row: TableRow, table: HeadlineTable) -> Figures:
        """The figures of a row. Raises ScoresError."""
        trials = self._trials_of(row, table)
        units = units_of(self._rule(row, trials), [self._all.frames(trial) for trial in trials])
        steps = sorted({column.step for column in table.columns})
        found: Figures = {}
        for score in built_in():
            sums = [self._all.sums(trial) for trial in trials]
            layouts = [one.layouts[score.name] for one in sums if score.name in one.scores]
            if score.figure is None or len(layouts) < len(sums) or len({one.parts for one in layouts}) > 1:
                continue
            strata = [name for name in TESTED_STRATA if all(name in one.strata for one in layouts)]
            at = sorted({0, *steps}) if score.compared_with == "classes" else steps
            if own := self._points(score, trials, units, at, strata):
                found[score.name] = own
        return found

    def _points(
        self,
        score: ScoreDefinition,
        trials: Sequence[FinishedTrial],
        units: Sequence[NDArray[np.int64]],
        steps: Sequence[int],
        strata: Sequence[str],
    ) -> dict[str, dict[str, dict[str, Any]]]:
        """The points by stratum, step and name."""
        assert score.figure is not None
        total: NDArray[np.float64] | None = None
        parts: tuple[str, ...] = ()
        number = 1 + max(int(own.max(initial=-1)) for own in units)
        for trial, own in zip(trials, units, strict=True):
            at = [trial.steps[step] for step in steps]
            sums = self._all.sums(trial).by_unit(score.name, own, at, strata)
            total = np.zeros((number, *sums.values.shape[1:])) if total is None else total
            total[: len(sums.values)] += sums.values
            parts = sums.parts
        found: dict[str, dict[str, dict[str, Any]]] = {}
        for k, stratum in enumerate(strata):
            for s, step in enumerate(steps):
                assert total is not None
                if points := score.figure(Sums(total[:, s, k], parts)):
                    found.setdefault(stratum, {})[str(step)] = {name: _shown(one) for name, one in points.items()}
        return found

    def _trials_of(self, row: TableRow, table: HeadlineTable) -> list[FinishedTrial]:
        """The trials behind the scores of the row. Raises ScoresError."""
        if table.pooled and self._run.summary.recordings[table.recording].horizons_s != self._all.horizons_s:
            raise ScoresError(
                f"{self._run.path / SUMMARY_FILE}: pooled scores at other horizons than its recordings have"
            )
        names = self._run.recordings if table.pooled else (table.recording,)
        scored = [name for name in names if name in row.entry.recordings and row.entry.recordings[name].strata]
        if missing := [name for name in scored if (row.label, name) not in self._trials]:
            raise ScoresError(f"{self._run.trial_folder(row.label, missing[0])}: the record of the trial is missing")
        trials = [self._trials[row.label, name] for name in scored]
        return self._all.together(trial for trial in trials if trial.complete) if table.pooled else trials

    def _rule(self, row: TableRow, trials: Sequence[FinishedTrial]) -> UnitRule:
        """The rule of the scores of the row if they have intervals, else one unit."""
        if not row.trial.interval:
            try:
                return self._all.unit_rule([trial.record.recording for trial in trials])
            except ScoresError as error:  # of any trial: the blocks of a recording depend on all
                self.notices[f"no intervals of precision over recall: {error}"] = None
        return UnitRule(("",) * len(trials), None)


def _shown(points: NDArray[np.float64] | Ratio) -> Any:
    """Points (N,) or (N, M); ratios with their intervals if there are any."""
    if not isinstance(points, Ratio):
        return _short(points)
    found = interval(ratio_replicates(points), "odds")
    ends = {} if np.isnan(found.low).any() else {"low": _short(found.low), "high": _short(found.high)}
    return {"value": _short(found.value)} | ends


def _short(values: NDArray[np.float64]) -> Any:
    """The values to four digits; counts are whole numbers of any length."""
    if values.ndim > 1:
        return [_short(one) for one in values]
    return [int(value) if value.is_integer() and value > 1 else float(f"{value:.4g}") for value in values.tolist()]

"""The figures of scores, such as the precision-recall curve: the points of each row, from the sums of its trials."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.runs.comparisons import TESTED_STRATA
from gridtrack.evaluation.runs.estimates import selected
from gridtrack.evaluation.runs.finished import FinishedTrial, RunTrials
from gridtrack.evaluation.runs.summary import SUMMARY_FILE
from gridtrack.evaluation.runs.sums import ScoresError, TrialSums
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
        for rows in _rows_of(run, tables).values():
            found |= trials.figures(rows)
        notices |= trials.notices
    return found, tuple(notices)


def _rows_of(run: ReportedRun, tables: Sequence[HeadlineTable]) -> dict[str, list[tuple[HeadlineTable, TableRow]]]:
    """The rows of a run with scores, by label, each with its table."""
    found: dict[str, list[tuple[HeadlineTable, TableRow]]] = {}
    for table in tables:
        for row in table.rows:
            if row.run in ("", run.name) and row.label in run.summary.trackers and row.trial.strata:
                found.setdefault(row.label, []).append((table, row))
    return found


class _TrialsOfRows:
    """The trials of the rows of a run, and their units. The keys of `notices` are the notices."""

    def __init__(self, run: ReportedRun) -> None:
        self._run, self._trials = run, run.scored_trials()
        self._all = RunTrials({name: run.summary.recordings[name] for name in run.recordings}, [*self._trials.values()])
        self.notices: dict[str, None] = {}

    def figures(self, rows: Sequence[tuple[HeadlineTable, TableRow]]) -> dict[tuple[str, str], Figures]:
        """The figures of the rows of one label, by recording and name, without unreadable ones.

        A trial belongs to its own row and to the pooled one: it is read once, for both.
        """
        made: dict[tuple[str, str], _FiguresOfRow] = {}
        for table, row in rows:
            try:
                made[table.recording, row.name] = self._of_row(row, table)
            except ScoresError as error:
                self._note(row.name, error)
        for recording in self._run.recordings:
            self._all.forget_rows()
            for key, own in list(made.items()):
                try:
                    own.add(recording)
                except ScoresError as error:
                    self._note(key[1], error)
                    del made[key]
        return {key: own.figures for key, own in made.items()}

    def _note(self, name: str, error: ScoresError) -> None:
        self.notices[f"{name}: no curves of its probabilities: {error}"] = None

    def _of_row(self, row: TableRow, table: HeadlineTable) -> _FiguresOfRow:
        """The figures of a row before any trial is added. Raises ScoresError."""
        trials = self._trials_of(row, table)
        units = selected(self._all, trials, self._rule(row, trials)).units
        steps = sorted({column.step for column in table.columns})
        return _FiguresOfRow([self._all.sums(trial) for trial in trials], trials, units, steps)

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


@dataclass(frozen=True)
class _ScoreSums:
    """The sums (U, S, K, P) of a score at these steps (S) and strata (K)."""

    score: ScoreDefinition
    steps: Sequence[int]
    strata: Sequence[str]
    total: Sums

    def add(self, sums: TrialSums, units: NDArray[np.int64], steps_of_trial: Sequence[int]) -> None:
        """Add a trial with frames in `units` (F,). Raises ScoresError."""
        at = [steps_of_trial[step] for step in self.steps]
        found = sums.by_unit(self.score.name, units, at, self.strata).values
        self.total.values[: len(found)] += found

    @property
    def points(self) -> dict[str, dict[str, dict[str, Any]]]:
        """The points by stratum, step and name."""
        assert self.score.figure is not None
        found: dict[str, dict[str, dict[str, Any]]] = {}
        for k, stratum in enumerate(self.strata):
            for s, step in enumerate(self.steps):
                if points := self.score.figure(Sums(self.total.values[:, s, k], self.total.parts)):
                    found.setdefault(stratum, {})[str(step)] = {name: _shown(one) for name, one in points.items()}
        return found


class _FiguresOfRow:
    """The figures of one row, from its trials, which are added one by one."""

    def __init__(
        self,
        sums: Sequence[TrialSums],
        trials: Sequence[FinishedTrial],
        units: Sequence[NDArray[np.int64]],
        steps: Sequence[int],
    ) -> None:
        """`units` (F,) of each trial; `steps`: those of the headline."""
        names = [trial.record.recording for trial in trials]
        self._trials = dict(zip(names, zip(sums, units, (trial.steps for trial in trials), strict=True), strict=True))
        number = 1 + max(int(own.max(initial=-1)) for own in units)
        self._scores: list[_ScoreSums] = []
        for score in built_in():
            layouts = [one.layouts[score.name] for one in sums if score.name in one.scores]
            if score.figure is None or len(layouts) < len(sums) or len({one.parts for one in layouts}) > 1:
                continue
            strata = [name for name in TESTED_STRATA if all(name in one.strata for one in layouts)]
            at = sorted({0, *steps}) if score.compared_with == "classes" else steps
            total = np.zeros((number, len(at), len(strata), len(layouts[0].parts)))
            self._scores.append(_ScoreSums(score, at, strata, Sums(total, layouts[0].parts)))

    def add(self, recording: str) -> None:
        """Add the trial on a recording, if it is one of the row's. Raises ScoresError."""
        if recording in self._trials:
            for score in self._scores:
                score.add(*self._trials[recording])

    @property
    def figures(self) -> Figures:
        """The figures by score."""
        return {one.score.name: points for one in self._scores if (points := one.points)}


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

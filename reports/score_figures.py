"""The figures of scores, such as the precision-recall curve: the points of each row, from the sums of its trials."""

from __future__ import annotations

from collections.abc import Sequence
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
        trials = _TrialsOfRows(run, notices)
        of_run = [(row, table) for table in tables for row in table.rows if row.run in ("", run.name)]
        for label in run.summary.trackers:
            trials.all.forget_rows()  # of the label before: a trial belongs to its own row and to the pooled one
            for row, table in of_run:
                if row.label == label and row.trial.strata:
                    try:
                        found[table.recording, row.name] = trials.figures(row, table)
                    except ScoresError as error:
                        notices[f"{row.name}: no curves of its probabilities: {error}"] = None
    return found, tuple(notices)


class _TrialsOfRows:
    """The trials of the rows of a run, and their units."""

    def __init__(self, run: ReportedRun, notices: dict[str, None]) -> None:
        """The keys of `notices` are the notices."""
        self._run, self._trials, self._notices = run, run.scored_trials(), notices
        self.all = RunTrials({name: run.summary.recordings[name] for name in run.recordings}, [*self._trials.values()])

    def figures(self, row: TableRow, table: HeadlineTable) -> Figures:
        """The figures of a row by score. Raises ScoresError."""
        trials = self._trials_of(row, table)
        units = selected(self.all, trials, self._rule(row, trials)).units
        of_trials = [(self.all.sums(trial), own, trial.steps) for trial, own in zip(trials, units, strict=True)]
        steps = sorted({column.step for column in table.columns})
        return {score.name: points for score in built_in() if (points := _points(score, of_trials, steps))}

    def _trials_of(self, row: TableRow, table: HeadlineTable) -> list[FinishedTrial]:
        """The trials behind the scores of the row. Raises ScoresError."""
        if table.pooled and self._run.summary.recordings[table.recording].horizons_s != self.all.horizons_s:
            raise ScoresError(
                f"{self._run.path / SUMMARY_FILE}: pooled scores at other horizons than its recordings have"
            )
        names = self._run.recordings if table.pooled else (table.recording,)
        scored = [name for name in names if name in row.entry.recordings and row.entry.recordings[name].strata]
        if missing := [name for name in scored if (row.label, name) not in self._trials]:
            raise ScoresError(f"{self._run.trial_folder(row.label, missing[0])}: the record of the trial is missing")
        trials = [self._trials[row.label, name] for name in scored]
        return self.all.together(trial for trial in trials if trial.complete) if table.pooled else trials

    def _rule(self, row: TableRow, trials: Sequence[FinishedTrial]) -> UnitRule:
        """The rule of the scores of the row if they have intervals, else one unit."""
        if not row.trial.interval:
            try:
                return self.all.unit_rule([trial.record.recording for trial in trials])
            except ScoresError as error:  # of any trial: the blocks of a recording depend on all
                self._notices[f"no intervals of precision over recall: {error}"] = None
        return UnitRule(("",) * len(trials), None)


def _points(
    score: ScoreDefinition, trials: Sequence[tuple[TrialSums, NDArray[np.int64], Sequence[int]]], steps: Sequence[int]
) -> dict[str, dict[str, dict[str, Any]]]:
    """The points of a score by stratum, step and name, from the sums of trials, their units (F,) and their steps.

    `steps`: those of the headline. Empty if the score has no figure, or other parts in some trials. Raises ScoresError.
    """
    layouts = [sums.layouts[score.name] for sums, *_ in trials if score.name in sums.scores]
    if score.figure is None or len(layouts) < len(trials) or len({one.parts for one in layouts}) > 1:
        return {}
    strata = [name for name in TESTED_STRATA if all(name in one.strata for one in layouts)]
    at = sorted({0, *steps}) if score.compared_with == "classes" else steps
    number = 1 + max(int(units.max(initial=-1)) for _, units, _ in trials)
    total = np.zeros((number, len(at), len(strata), len(layouts[0].parts)))
    for sums, units, own_steps in trials:
        added = sums.by_unit(score.name, units, [own_steps[step] for step in at], strata).values
        total[: len(added)] += added
    found: dict[str, dict[str, dict[str, Any]]] = {}
    for k, stratum in enumerate(strata):
        for s, step in enumerate(at):
            if points := score.figure(Sums(total[:, s, k], layouts[0].parts)):
                found.setdefault(stratum, {})[str(step)] = {name: _shown(one) for name, one in points.items()}
    return found


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

"""Precision against recall at every threshold, and the share of occupied cells against p, from a trial's histograms."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.results.columns import CALIBRATION_BINS, PROBABILITY_EDGES
from gridtrack.evaluation.runs.finished import FinishedTrial
from gridtrack.evaluation.runs.summary import SUMMARY_FILE
from gridtrack.evaluation.scores.cells import for_calibration
from gridtrack.evaluation.scoring.metrics import ratio
from gridtrack.evaluation.scoring.score_store import ScoresError
from gridtrack.evaluation.statistics.jackknife import proportion_interval
from gridtrack.evaluation.statistics.pr_auc import summed_histograms
from gridtrack.evaluation.statistics.run_statistics import RunStatistics
from gridtrack.evaluation.statistics.score_intervals import HEADLINE_STRATA, common_strata
from gridtrack.evaluation.statistics.trial_files import TrialFiles
from gridtrack.evaluation.statistics.units import UnitRule
from gridtrack.reports.run import ReportedRun
from gridtrack.reports.table import HeadlineTable, TableRow

MOST_POINTS = 40
"""Points of a curve, at about equal steps of recall, and as many ends of flat parts; all would be some hundred."""
LEAST_CELLS = 50
"""A bin of fewer cells has no share of occupied cells: it is mostly noise."""
ProbabilityCurves = dict[str, dict[str, Any]]
"""By stratum and step."""


def probability_curves(
    runs: Sequence[ReportedRun], tables: Sequence[HeadlineTable]
) -> tuple[dict[tuple[str, str], ProbabilityCurves], tuple[str, ...]]:
    """The curves of each row with scores, by recording and the name of the row, and notices of unreadable files.

    They are of the strata and steps of the headline. Pooled rows have the counts of the trials that their scores have,
    and precision has an interval where it has one in the summary, of the same units. Raises RunError and ReportError.
    """
    found: dict[tuple[str, str], ProbabilityCurves] = {}
    notices: dict[str, None] = {}
    for run in runs:
        counts = _RunCounts(run)
        for label in run.summary.trackers:
            files = TrialFiles()
            for table, row in _rows_of(run, label, tables):
                try:
                    trials = counts.trials_of(row, table)
                    found[table.recording, row.name] = _curves_of(trials, files, counts.rule(row, trials), table)
                except ScoresError as error:
                    notices[f"{row.name}: no curves of its probabilities: {error}"] = None
        notices |= counts.notices
    return found, tuple(notices)


def _rows_of(run: ReportedRun, label: str, tables: Sequence[HeadlineTable]) -> Iterator[tuple[HeadlineTable, TableRow]]:
    """One row of a run wherever it has scores, pooled last: what was read of its trials is then kept."""
    for table in sorted(tables, key=lambda table: table.pooled):
        for row in table.rows:
            if row.label == label and row.run in ("", run.name) and row.trial.strata:
                yield table, row


class _RunCounts:
    """Which trials of a run a row has, and how their frames become units; `notices` as keys."""

    def __init__(self, run: ReportedRun) -> None:
        self._run, self._trials = run, run.scored_trials()
        recordings = {name: run.summary.recordings[name] for name in run.recordings}
        self._statistics = RunStatistics(recordings, list(self._trials.values()))
        self.notices: dict[str, None] = {}

    def trials_of(self, row: TableRow, table: HeadlineTable) -> list[FinishedTrial]:
        """The trials that the scores of the row are of. Raises ScoresError."""
        if table.pooled and self._run.summary.recordings[table.recording].horizons_s != self._statistics.horizons_s:
            raise ScoresError(
                f"{self._run.path / SUMMARY_FILE}: pooled scores at other horizons than its recordings have"
            )
        names = self._run.recordings if table.pooled else (table.recording,)
        scored = [name for name in names if name in row.entry.recordings and row.entry.recordings[name].strata]
        if missing := [name for name in scored if (row.label, name) not in self._trials]:
            raise ScoresError(f"{self._run.trial_folder(row.label, missing[0])}: the record of the trial is missing")
        trials = [self._trials[row.label, name] for name in scored]
        return self._statistics.together(trial for trial in trials if trial.complete) if table.pooled else trials

    def rule(self, row: TableRow, trials: Sequence[FinishedTrial]) -> UnitRule:
        """The rule of the scores of the row where they have intervals, else one unit."""
        if any(scores.precision_low for scores in row.trial.strata.values()):
            try:
                return self._statistics.unit_rule([trial.record.recording for trial in trials])
            except ScoresError as error:  # of any trial: the blocks of a recording depend on all
                self.notices[f"no intervals of precision over recall: {error}"] = None
        return UnitRule(("",) * len(trials), None)


def _curves_of(
    trials: Sequence[FinishedTrial], files: TrialFiles, rule: UnitRule, table: HeadlineTable
) -> ProbabilityCurves:
    """The curves of all `trials` together, in the strata and at the steps of the headline. Raises ScoresError."""
    stamps_ns = [files.frames(trial).stamps_ns for trial in trials]
    units = rule.units_of(stamps_ns)
    histograms = files.histograms(trials, stamps_ns, units)
    strata = [name for name in HEADLINE_STRATA if name in common_strata([trial.strata for trial in trials])]
    chosen = list(product(sorted({column.step for column in table.columns}), strata))
    cells, positives = summed_histograms(trials, histograms, units, chosen)
    p_sums = np.zeros((len(chosen), CALIBRATION_BINS))
    for trial, own in zip(trials, histograms, strict=True):
        steps, numbers = zip(*((trial.steps[step], own.strata.index(stratum)) for step, stratum in chosen), strict=True)
        p_sums += own.p_sum[steps, numbers]
    found: ProbabilityCurves = {stratum: {} for stratum in strata}
    for n, (step, stratum) in enumerate(chosen):
        if positives[:, n].any():
            found[stratum][str(step)] = _precision_recall(cells[:, n], positives[:, n]) | _calibration(
                cells[:, n].sum(axis=0), positives[:, n].sum(axis=0), p_sums[n]
            )
    return found


def _precision_recall(cells: NDArray[np.int64], positives: NDArray[np.int64]) -> dict[str, list[float]]:
    """Thresholds `p` from the highest down, with the precision and recall of cells at and above each, and the ends of
    the interval of the precision where there are enough units; histograms (U, B) with a positive.

    Of thresholds at which the same cells are called occupied there are the highest and the lowest: F1 is flat between.
    """
    found_of, called_of = (counts[:, ::-1].cumsum(axis=1) for counts in (positives, cells))
    found, called = found_of.sum(axis=0), called_of.sum(axis=0)
    recall, precision = found / found[-1], ratio(found, called)
    wanted = np.searchsorted(recall, np.linspace(0.0, 1.0, MOST_POINTS))
    highest = np.maximum(wanted, np.flatnonzero(called)[0])
    lowest = np.searchsorted(called, called[highest], side="right") - 1
    at = np.union1d(highest, lowest)
    thresholds = PROBABILITY_EDGES[:-1][::-1]
    curve = {"p": _short(thresholds[at]), "recall": _short(recall[at]), "precision": _short(precision[at])}
    low, high = proportion_interval(found_of[:, at].astype(np.float64), called_of[:, at].astype(np.float64))
    ends = {} if np.isnan(low).any() else {"precision_low": _short(low), "precision_high": _short(high)}
    return curve | ends


def _calibration(
    cells: NDArray[np.int64], positives: NDArray[np.int64], p_sum: NDArray[np.float64]
) -> dict[str, list[float]]:
    """Mean probability and share of occupied cells of each bin for calibration with at least LEAST_CELLS."""
    cells_of_bin, positives_of_bin = for_calibration(cells), for_calibration(positives)
    enough = cells_of_bin >= LEAST_CELLS
    return {
        "mean_p": _short(p_sum[enough] / cells_of_bin[enough]),
        "share": _short(positives_of_bin[enough] / cells_of_bin[enough]),
    }


def _short(values: NDArray[np.float64]) -> list[float]:
    return [float(f"{value:.4g}") for value in values]

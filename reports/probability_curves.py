"""Precision against recall at every threshold, and the share of occupied cells against p, from a trial's histograms."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.results.columns import PROBABILITY_EDGES
from gridtrack.evaluation.scoring.counting import Tally, for_calibration
from gridtrack.evaluation.scoring.histograms import read_tally
from gridtrack.evaluation.scoring.metrics import ratio
from gridtrack.evaluation.scoring.score_store import ScoresError
from gridtrack.evaluation.statistics.score_intervals import HEADLINE_STRATA
from gridtrack.reports.run import ReportedRun
from gridtrack.reports.table import HeadlineTable, TableRow

MOST_POINTS = 40
"""Points of a curve, at about equal steps of recall; all of them would be some hundred."""
LEAST_CELLS = 50
"""A bin of fewer cells has no share of occupied cells: it is mostly noise."""
ProbabilityCurves = dict[str, dict[str, Any]]
"""By stratum and step."""


def probability_curves(
    runs: Sequence[ReportedRun], tables: Sequence[HeadlineTable]
) -> tuple[dict[tuple[str, str], ProbabilityCurves], tuple[str, ...]]:
    """The curves of each row with scores, by recording and the name of the row, and notices of unreadable files.

    They are of the strata and steps of the headline. Pooled rows have the sum of the counts of their recordings, where
    these have the same horizons.
    """
    found: dict[tuple[str, str], ProbabilityCurves] = {}
    notices: list[str] = []
    sums: dict[str, list[Tally]] = {}
    for table in (one for one in tables if not one.pooled):
        for row in (row for row in table.rows if row.trial.strata):
            try:
                tally = _tally_of(_run_of(row, runs), row, table)
            except ScoresError as error:
                notices.append(f"{row.name}: no curves of its probabilities: {error}")
                continue
            found[table.recording, row.name] = _curves_of(tally, _steps_of(table))
            sums.setdefault(row.name, []).append(tally)
    for table in (one for one in tables if one.pooled):
        if all(other.horizons_s == table.horizons_s for other in tables):
            whole = [row for row in table.rows if len(sums.get(row.name, ())) == len(row.entry.recordings) - 1]
            found |= {(table.recording, row.name): _curves_of(_sum(sums[row.name]), _steps_of(table)) for row in whole}
    return found, tuple(notices)


def _run_of(row: TableRow, runs: Sequence[ReportedRun]) -> ReportedRun:
    return next((run for run in runs if run.name == row.run), runs[0])


def _steps_of(table: HeadlineTable) -> list[int]:
    return sorted({column.step for column in table.columns})


def _tally_of(run: ReportedRun, row: TableRow, table: HeadlineTable) -> Tally:
    """The counts of a trial at the steps and strata that are shown."""
    steps = len(run.summary.recordings[table.recording].horizons_s) - 1
    return read_tally(run.trial_folder(row.label, table.recording), steps, HEADLINE_STRATA).at(_steps_of(table))


def _sum(tallies: Sequence[Tally]) -> Tally:
    total = Tally.empty(len(tallies[0].cells) - 1, tallies[0].strata)
    for tally in tallies:
        total.add(tally)
    return total


def _curves_of(tally: Tally, steps: Sequence[int]) -> ProbabilityCurves:
    return {
        stratum: {
            str(step): _precision_recall(tally.cells[i, k], tally.positives[i, k])
            | _calibration(tally.cells[i, k], tally.positives[i, k], tally.p_sum[i, k])
            for i, step in enumerate(steps)
            if tally.positives[i, k].any()
        }
        for k, stratum in enumerate(tally.strata)
    }


def _precision_recall(cells: NDArray[np.int64], positives: NDArray[np.int64]) -> dict[str, list[float]]:
    """Thresholds `p` from the highest down, with the precision and recall of cells at and above each; histograms (B,)
    with a positive."""
    found, called = positives[::-1].cumsum(), cells[::-1].cumsum()
    recall, precision = found / found[-1], ratio(found, called)
    wanted = np.searchsorted(recall, np.linspace(0.0, 1.0, MOST_POINTS))
    at = np.unique(np.maximum(wanted, np.flatnonzero(called)[0]))
    thresholds = PROBABILITY_EDGES[:-1][::-1]
    return {"p": _short(thresholds[at]), "recall": _short(recall[at]), "precision": _short(precision[at])}


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

"""Histograms of several trials by statistical unit, and PR-AUC of the units together and without each of them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.results.columns import PROBABILITY_BINS
from gridtrack.evaluation.scoring.histograms import UnitHistograms
from gridtrack.evaluation.scoring.metrics import area_under_precision_recall
from gridtrack.evaluation.statistics.finished_trial import FinishedTrial
from gridtrack.evaluation.statistics.jackknife import JackknifedScore
from gridtrack.evaluation.statistics.units import number_of_units

SUMMED_BYTES = 256 << 20
"""Of the histograms of all units: a run of a thousand recordings has gigabytes."""


def pr_auc_of_units(
    trials: Sequence[FinishedTrial],
    histograms: Iterable[UnitHistograms],
    units: Sequence[NDArray[np.int64]],
    chosen: Sequence[tuple[int, str]],
) -> JackknifedScore:
    """PR-AUC (N,) at the `chosen` places among the steps of each trial, and strata, over frames of `trials`.

    The other arguments are those of `summed_histograms`. As many of `chosen` are summed at a time as SUMMED_BYTES hold.
    """
    at_a_time = max(1, SUMMED_BYTES // (2 * 8 * PROBABILITY_BINS * number_of_units(units)))
    parts = [
        pr_auc_without_each(*summed_histograms(trials, histograms, units, chosen[first : first + at_a_time]))
        for first in range(0, len(chosen), at_a_time)
    ]
    return JackknifedScore(
        np.concatenate([part.value for part in parts]),
        np.concatenate([part.without for part in parts], axis=1),
        np.concatenate([part.sizes for part in parts], axis=1),
    )


def summed_histograms(
    trials: Sequence[FinishedTrial],
    histograms: Iterable[UnitHistograms],
    units: Sequence[NDArray[np.int64]],
    chosen: Sequence[tuple[int, str]],
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Cells and those of them occupied (U, N, B) of the units, at the `chosen` places and strata, over all `trials`.

    `units` (F,) hold the unit of each frame of a trial that counts. Of each trial `histograms` has the units from its
    first one to its last.
    """
    cells, positives = np.zeros((2, number_of_units(units), len(chosen), PROBABILITY_BINS), np.int64)
    for trial, own, unit in zip(trials, histograms, units, strict=True):
        if len(unit):
            steps = [trial.steps[place] for place, _ in chosen]
            strata = [own.strata.index(stratum) for _, stratum in chosen]
            of_trial = slice(int(unit.min()), int(unit.max()) + 1)
            cells[of_trial] += own.cells[:, steps, strata]
            positives[of_trial] += own.positives[:, steps, strata]
    return cells, positives


def pr_auc_without_each(cells: NDArray[np.integer], positives: NDArray[np.integer]) -> JackknifedScore:
    """PR-AUC (...) of histograms (U, ..., B) of units. A unit counts by its occupied cells."""
    all_cells, all_positives = cells.sum(axis=0), positives.sum(axis=0)
    without = [
        area_under_precision_recall(all_cells - own_cells, all_positives - own_positives)
        for own_cells, own_positives in zip(cells, positives, strict=True)
    ]
    value = area_under_precision_recall(all_cells, all_positives)
    return JackknifedScore(value, np.stack(without), positives.sum(axis=-1).astype(np.float64))

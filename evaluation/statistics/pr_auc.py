"""PR-AUC of statistical units together and without each of them, from the histograms of several trials."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.results.columns import PROBABILITY_BINS
from gridtrack.evaluation.scoring.metrics import area_under_precision_recall
from gridtrack.evaluation.scoring.score_store import add_histograms
from gridtrack.evaluation.statistics.jackknife import JackknifedScore


def pr_auc_of_units(
    folders: Sequence[Path],
    stamps_ns: Sequence[NDArray[np.int64]],
    units: Sequence[NDArray[np.int64]],
    chosen: Sequence[tuple[int, str]],
) -> JackknifedScore:
    """PR-AUC (N,) at the `chosen` steps and strata, over the frames of the trials in `folders`.

    `stamps_ns` and `units` (F,) hold the stamp and the unit of each frame of a trial that counts. Raises ScoresError.
    """
    number = 1 + max(int(one.max()) for one in units if len(one))
    cells, positives = np.zeros((2, number, len(chosen), PROBABILITY_BINS), np.int64)
    for folder, stamps, unit in zip(folders, stamps_ns, units, strict=True):
        add_histograms(folder, chosen, dict(zip(stamps.tolist(), unit.tolist(), strict=True)), cells, positives)
    return pr_auc_without_each(cells, positives)


def pr_auc_without_each(cells: NDArray[np.integer], positives: NDArray[np.integer]) -> JackknifedScore:
    """PR-AUC (...) of histograms (U, ..., B) of units. A unit counts by its occupied cells."""
    all_cells, all_positives = cells.sum(axis=0), positives.sum(axis=0)
    without = [
        area_under_precision_recall(all_cells - own_cells, all_positives - own_positives)
        for own_cells, own_positives in zip(cells, positives, strict=True)
    ]
    value = area_under_precision_recall(all_cells, all_positives)
    return JackknifedScore(value, np.stack(without), positives.sum(axis=-1).astype(np.float64))

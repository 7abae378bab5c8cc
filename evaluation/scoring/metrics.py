"""Scores of pooled counts, per step and stratum; NaN where a score is undefined."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.results.columns import CALIBRATION_EDGES
from gridtrack.evaluation.scoring.counting import Tally, for_calibration

Scores = NDArray[np.float64]
THOUGHT_OCCUPIED = 10 / 1024
"""Cells with at least this probability, about 1 %, are those that a tracker considers possibly occupied."""


def f1_score(confusion: NDArray[np.int64] | NDArray[np.float64]) -> Scores:
    """F1 (...) of TP, FP, FN, TN (..., 4): 2 TP / (2 TP + FP + FN); undefined where no cell was occupied."""
    tp, fp, fn = (confusion[..., i] for i in range(3))
    return ratio(2 * tp, 2 * tp + fp + fn, defined=tp + fn > 0)


def precision(confusion: NDArray[np.int64]) -> Scores:
    """TP / (TP + FP) (...) of TP, FP, FN, TN (..., 4); undefined where nothing was called occupied."""
    return ratio(confusion[..., 0], confusion[..., 0] + confusion[..., 1])


def recall(confusion: NDArray[np.int64]) -> Scores:
    """TP / (TP + FN) (...) of TP, FP, FN, TN (..., 4); undefined where no cell was occupied."""
    return ratio(confusion[..., 0], confusion[..., 0] + confusion[..., 2])


def balanced_accuracy(confusion: NDArray[np.int64]) -> Scores:
    """Mean recall of the classes that occur (...), of confusion counts (..., K, K+1)."""
    correct = np.diagonal(confusion, axis1=-2, axis2=-1)
    recalls = ratio(correct, confusion.sum(axis=-1))
    occur = ~np.isnan(recalls)
    return ratio(np.where(occur, recalls, 0.0).sum(axis=-1), occur.sum(axis=-1))


def average_precision(tally: Tally) -> Scores:
    """PR-AUC (S, K) of the histograms of a tally: `area_under_precision_recall`."""
    return area_under_precision_recall(tally.cells, tally.positives)


def area_under_precision_recall(cells: NDArray[np.integer], positives: NDArray[np.integer]) -> Scores:
    """Area (...) under the precision-recall curve of histograms (..., B): precision weighted by the gain in recall."""
    true_positive = positives[..., ::-1].cumsum(axis=-1)
    called = cells[..., ::-1].cumsum(axis=-1)
    gain = ratio(positives[..., ::-1], true_positive[..., -1:])
    area: Scores = (gain * np.nan_to_num(ratio(true_positive, called))).sum(axis=-1)
    return area


def brier_score(tally: Tally) -> Scores:
    """Mean squared error of the probability (S, K)."""
    return ratio(tally.squared_error, tally.cells.sum(axis=-1))


@dataclass(frozen=True, slots=True)
class BrierDecomposition:
    """Murphy's decomposition of the Brier score (S, K): `reliability` - `resolution` + `uncertainty` is the score."""

    reliability: Scores
    resolution: Scores
    uncertainty: Scores


def brier_decomposition(tally: Tally) -> BrierDecomposition:
    """Reliability, resolution and uncertainty over the bins for calibration.

    Murphy's decomposition (1973) assumes one probability per bin. The variance of the probability within bins and its
    covariance with the occupancy are added to the resolution, so that the sum is exact (Stephenson, Coelho and
    Jolliffe, 2008, "Two extra components in the Brier score decomposition").
    """
    cells_of_bin, positives_of_bin = for_calibration(tally.cells), for_calibration(tally.positives)
    cells, positives = cells_of_bin.sum(axis=-1), positives_of_bin.sum(axis=-1)
    rate, rate_of_bin = ratio(positives, cells), np.nan_to_num(ratio(positives_of_bin, cells_of_bin))
    p_of_bin = np.nan_to_num(ratio(tally.p_sum, cells_of_bin))
    reliability = ratio((cells_of_bin * (p_of_bin - rate_of_bin) ** 2).sum(axis=-1), cells)
    uncertainty = rate * (1.0 - rate)
    return BrierDecomposition(reliability, reliability + uncertainty - brier_score(tally), uncertainty)


def log_loss(tally: Tally) -> Scores:
    """Mean negative log likelihood of a cell (S, K), nats."""
    return ratio(tally.log_loss, tally.cells.sum(axis=-1))


def calibration_error(tally: Tally, from_p: float = 0.0) -> Scores:
    """Expected calibration error (S, K): |mean probability - share occupied| of each bin for calibration, weighted by
    its cells.

    Over the cells with at least the probability `from_p`, one of CALIBRATION_EDGES.
    """
    first = int(np.searchsorted(CALIBRATION_EDGES, from_p))
    apart = np.abs(tally.p_sum - for_calibration(tally.positives))[..., first:]
    return ratio(apart.sum(axis=-1), for_calibration(tally.cells)[..., first:].sum(axis=-1))


def ratio(part: NDArray[Any], whole: NDArray[Any], defined: NDArray[np.bool_] | None = None) -> Scores:
    """part / whole, broadcast; NaN where `whole` is 0 or the ratio is not `defined`."""
    divisible = whole > 0 if defined is None else defined & (whole > 0)
    ratio = np.full(np.broadcast_shapes(part.shape, whole.shape), np.nan)
    np.divide(part, whole, out=ratio, where=divisible)
    return ratio

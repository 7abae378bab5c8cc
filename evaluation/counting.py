"""Counting one forecast against the frames that came: histograms of probability, squared error and log loss.

Everything else (F1 at any threshold, precision-recall curve, calibration) follows from these counts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import GridFrame
from gridtrack.evaluation.strata import STRATA, SUMS_OF_REGIONS

BINS = 50
HALF = BINS // 2
EDGES = (np.sin(0.5 * np.pi * np.arange(BINS + 1) / BINS) ** 2).astype(np.float32)
"""Bin b holds `EDGES[b] <= p < EDGES[b + 1]`, the last one p = 1 too; a threshold is a bin's lower edge.

Edges lie at sin^2: bins are a thousandth wide next to 0 and 1, and 0.03 in the middle, where one edge is 0.5. A
forecast of a distant step is spread thin, and in bins of equal width nearly all of it would fall into the first.
"""
_SLOTS = 4096
_FIRST_BIN = (np.searchsorted(EDGES, np.arange(_SLOTS + 1, dtype=np.float32) / _SLOTS, side="right") - 1).clip(
    0, BINS - 1
)
"""The bin of the smallest probability of each of 4096 equal slots; none of them holds more than one edge."""
CLIP = 1e-3
"""Probabilities are clipped to [CLIP, 1 - CLIP] for the log loss."""


@dataclass(slots=True)
class Tally:
    """Counts over cells, per step S = steps+1, stratum K and probability bin B; tallies add up.

    `cells`, `positives` (S, K, B) int64: cells scored and those of them occupied; `p_sum` (S, K, B) float64: sum of the
    forecast probability; `squared_error`, `log_loss` (S, K) float64: sums over cells, log loss in nats.
    """

    cells: NDArray[np.int64]
    positives: NDArray[np.int64]
    p_sum: NDArray[np.float64]
    squared_error: NDArray[np.float64]
    log_loss: NDArray[np.float64]

    @classmethod
    def empty(cls, steps: int, groups: int = len(STRATA)) -> Tally:
        """Nothing counted yet, for steps 0..steps."""
        bins, plain = (steps + 1, groups, BINS), (steps + 1, groups)
        return cls(np.zeros(bins, np.int64), np.zeros(bins, np.int64), np.zeros(bins), np.zeros(plain), np.zeros(plain))

    def add(self, other: Tally) -> None:
        """Take in what `other` counted."""
        self.cells += other.cells
        self.positives += other.positives
        self.p_sum += other.p_sum
        self.squared_error += other.squared_error
        self.log_loss += other.log_loss

    def confusion(self, threshold_bins: NDArray[np.int64]) -> NDArray[np.int64]:
        """TP, FP, FN, TN (S, K, 4) when cells of bin `threshold_bins` (S, K) and above are called occupied."""
        called = np.arange(BINS) >= threshold_bins[..., None]
        true_positive = (self.positives * called).sum(axis=-1)
        called_cells = (self.cells * called).sum(axis=-1)
        positives, cells = self.positives.sum(axis=-1), self.cells.sum(axis=-1)
        false_positive = called_cells - true_positive
        false_negative = positives - true_positive
        true_negative = cells - positives - false_positive
        return np.stack([true_positive, false_positive, false_negative, true_negative], axis=-1)


def count_forecast(occupancy: NDArray[np.float32], frames: Sequence[GridFrame], regions: NDArray[np.uint8]) -> Tally:
    """Score a forecast made at frame t: step n against frame t+n, on the cells visible there.

    `occupancy` (steps+1, M, M) float32 in [0, 1]; `frames` t..t+steps; `regions` (M, M) as of `strata.regions_of`.
    """
    region_tally = Tally.empty(len(frames) - 1, SUMS_OF_REGIONS.shape[1])
    for step, frame in enumerate(frames):
        _count_step(
            occupancy[step].reshape(-1),
            frame.visible.reshape(-1),
            frame.occupied.reshape(-1),
            regions.reshape(-1),
            region_tally.cells[step],
            region_tally.positives[step],
            region_tally.p_sum[step],
            region_tally.squared_error[step],
            region_tally.log_loss[step],
        )
    return Tally(
        SUMS_OF_REGIONS @ region_tally.cells,
        SUMS_OF_REGIONS @ region_tally.positives,
        SUMS_OF_REGIONS @ region_tally.p_sum,
        region_tally.squared_error @ SUMS_OF_REGIONS.T,
        region_tally.log_loss @ SUMS_OF_REGIONS.T,
    )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _count_step(probability, scored, positive, regions, cells, positives, p_sum, squared_error, log_loss):  # type: ignore[no-untyped-def]
    """Add one step's scored cells (M*M,) to its region's counts: histograms (R, B) and sums (R,).

    The log loss is kept as a product of likelihoods, of which a logarithm is taken only before it could underflow:
    one logarithm for a hundred cells instead of one for each.
    """
    likelihood = np.ones(log_loss.size)
    for i in range(probability.size):
        if not scored[i]:
            continue
        p = probability[i]
        region = regions[i]
        bin_ = _FIRST_BIN[int(p * np.float32(_SLOTS))]
        if p >= EDGES[bin_ + 1] and bin_ < BINS - 1:
            bin_ += 1
        cells[region, bin_] += 1
        p_sum[region, bin_] += p
        clipped = min(max(float(p), CLIP), 1.0 - CLIP)
        if positive[i]:
            positives[region, bin_] += 1
            squared_error[region] += (1.0 - p) ** 2
            likelihood[region] *= clipped
        else:
            squared_error[region] += float(p) ** 2
            likelihood[region] *= 1.0 - clipped
        if likelihood[region] < 1e-290:
            log_loss[region] -= math.log(likelihood[region])
            likelihood[region] = 1.0
    for region in range(log_loss.size):
        log_loss[region] -= math.log(likelihood[region])

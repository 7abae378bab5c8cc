"""Counts of one forecast against the observed frames: histograms of probability, squared error and log loss.

F1 at any threshold, precision-recall curves and calibration are computed from these counts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.results.columns import PROBABILITY_BINS
from gridtrack.evaluation.scoring.strata import RANGES, REGIONS, STRATA, STRATA_WITH_TRUTH, SUMS_OF_REGIONS, RegionMaps
from gridtrack.evaluation.scoring.target import NOT_SCORED, SEEN_OCCUPIED, Target

HALF = PROBABILITY_BINS // 2
_SLOTS = 4096
EDGES = (
    np.round(_SLOTS * np.sin(0.5 * np.pi * np.arange(PROBABILITY_BINS + 1) / PROBABILITY_BINS) ** 2) / _SLOTS
).astype(np.float32)
"""Bin b covers `EDGES[b] <= p < EDGES[b + 1]`, the last bin also p = 1; a threshold is a bin's lower edge.

Edges are at sin^2: bins are 0.001 wide next to 0 and 1, and 0.03 in the middle, where one edge is 0.5. Probabilities
of distant steps are small, and in bins of equal width nearly all would fall into the first. Edges are multiples of
1/4096, so that a table of 4096 slots maps a probability to its bin.
"""
_BIN_OF_SLOT = (np.searchsorted(EDGES, np.arange(_SLOTS + 1) / _SLOTS, side="right") - 1).clip(0, PROBABILITY_BINS - 1)
CLIP = 1e-3
"""Probabilities are clipped to [CLIP, 1 - CLIP] for the log loss."""


@dataclass(slots=True)
class Tally:
    """Counts over cells, per step S = steps+1, stratum K and probability bin B; tallies add up.

    `cells`, `positives` (S, K, B) int64: cells scored and those of them occupied; `p_sum` (S, K, B) float64: sum of the
    forecast probability; `squared_error`, `log_loss` (S, K) float64: sums over cells, log loss in nats. `strata` names
    the K strata.
    """

    cells: NDArray[np.int64]
    positives: NDArray[np.int64]
    p_sum: NDArray[np.float64]
    squared_error: NDArray[np.float64]
    log_loss: NDArray[np.float64]
    strata: tuple[str, ...] = STRATA

    @classmethod
    def empty(cls, steps: int, strata: tuple[str, ...] = STRATA) -> Tally:
        """Counts of zero for steps 0..steps."""
        bins, plain = (steps + 1, len(strata), PROBABILITY_BINS), (steps + 1, len(strata))
        cells, positives, p_sum = np.zeros(bins, np.int64), np.zeros(bins, np.int64), np.zeros(bins)
        return cls(cells, positives, p_sum, np.zeros(plain), np.zeros(plain), strata)

    def add(self, other: Tally) -> None:
        """Add the counts of `other`."""
        self.cells += other.cells
        self.positives += other.positives
        self.p_sum += other.p_sum
        self.squared_error += other.squared_error
        self.log_loss += other.log_loss

    def of(self, strata: tuple[str, ...]) -> Tally:
        """The counts of these strata only."""
        k = [self.strata.index(name) for name in strata]
        return Tally(
            self.cells[:, k],
            self.positives[:, k],
            self.p_sum[:, k],
            self.squared_error[:, k],
            self.log_loss[:, k],
            strata,
        )

    def confusion(self, threshold_bins: NDArray[np.int64]) -> NDArray[np.int64]:
        """TP, FP, FN, TN (S, K, 4) when cells of bin `threshold_bins` (S, K) and above are called occupied."""
        called = np.arange(PROBABILITY_BINS) >= threshold_bins[..., None]
        true_positive = (self.positives * called).sum(axis=-1)
        called_cells = (self.cells * called).sum(axis=-1)
        positives, cells = self.positives.sum(axis=-1), self.cells.sum(axis=-1)
        false_positive = called_cells - true_positive
        false_negative = positives - true_positive
        true_negative = cells - positives - false_positive
        return np.stack([true_positive, false_positive, false_negative, true_negative], axis=-1)


def count_forecast(
    occupancy: NDArray[np.float32],
    targets: Sequence[Target],
    region_maps: RegionMaps,
    ages: NDArray[np.uint8] | None = None,
) -> Tally:
    """Count a forecast made at frame t: step n against frame t+n, on the cells that are scored in that frame.

    `occupancy` (steps+1, M, M) float32 in [0, 1]; `targets` t..t+steps; `ages` (M, M) uint8: the age band of
    each cell at t, for hidden cells; None: all in the first band.
    """
    steps, seen = len(targets) - 1, region_maps.visible.reshape(-1)
    hidden = (region_maps.hidden if ages is None else region_maps.hidden + ages).reshape(-1)
    cells, positives = np.zeros((2, steps + 1, REGIONS, PROBABILITY_BINS), np.int64)
    p_sum = np.zeros((steps + 1, REGIONS, PROBABILITY_BINS))
    squared_error, log_loss = np.zeros((2, steps + 1, REGIONS))
    for n, target in enumerate(targets):
        p, state, motion = occupancy[n].reshape(-1), target.state.reshape(-1), target.motion.reshape(-1)
        _count_step(p, state, motion, seen, hidden, cells[n], positives[n], p_sum[n], squared_error[n], log_loss[n])
    sums = SUMS_OF_REGIONS[[STRATA_WITH_TRUTH.index(name) for name in region_maps.strata]].astype(np.float64)
    return Tally(
        (sums @ cells.astype(np.float64)).astype(np.int64),
        (sums @ positives.astype(np.float64)).astype(np.int64),
        sums @ p_sum,
        squared_error @ sums.T,
        log_loss @ sums.T,
        region_maps.strata,
    )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _count_step(probability, state, motion, seen, hidden, cells, positives, p_sum, squared_error, log_loss):  # type: ignore[no-untyped-def]
    """Add one step's scored cells (M*M,) to their regions' counts: histograms (R, B) and sums (R,).

    The log loss is accumulated as a product of likelihoods, with a logarithm only before it could underflow: about one
    logarithm per hundred cells instead of one per cell.
    """
    likelihood = np.ones(log_loss.size)
    for i in range(probability.size):
        if state[i] == NOT_SCORED:
            continue
        region = seen[i] + RANGES * motion[i] if state[i] <= SEEN_OCCUPIED else hidden[i]
        bin_ = _BIN_OF_SLOT[int(probability[i] * np.float32(_SLOTS))]
        p = float(probability[i])
        cells[region, bin_] += 1
        p_sum[region, bin_] += p
        clipped = min(max(p, CLIP), 1.0 - CLIP)
        if state[i] & 1:
            positives[region, bin_] += 1
            squared_error[region] += (1.0 - p) ** 2
            likelihood[region] *= clipped
        else:
            squared_error[region] += p**2
            likelihood[region] *= 1.0 - clipped
        if likelihood[region] < 1e-290:
            log_loss[region] -= math.log(likelihood[region])
            likelihood[region] = 1.0
    for region in range(log_loss.size):
        log_loss[region] -= math.log(likelihood[region])

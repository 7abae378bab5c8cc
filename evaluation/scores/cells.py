"""Counts of the cells of one forecast: histograms of probability, squared error and log loss, in one pass.

F1 at any threshold, precision-recall curves, calibration, Brier score and log loss follow from these counts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.referee.referee import ScoredForecast
from gridtrack.evaluation.referee.strata import RANGES, REGIONS, STRATA, STRATA_WITH_TRUTH, SUMS_OF_REGIONS, RegionMaps
from gridtrack.evaluation.referee.targets import NOT_SCORED, SEEN_OCCUPIED, Target

_LOWEST_OCTAVE = 12
_COARSENING, _LOWEST_OCTAVE_NEXT_TO_1 = 8, 7
"""Of the bins for calibration."""
MASSES = (0.0, 0.5, 1.0)
"""Probabilities that many cells may have: each is a bin of its own, without neighbouring values."""


def _edges(coarsening: int = 1, lowest_next_to_1: int = _LOWEST_OCTAVE) -> NDArray[np.float64]:
    """Edges towards 0 by octaves of p, and towards 1 by octaves of 1 - p."""
    near_0 = np.concatenate([_octave(k, coarsening) for k in range(_LOWEST_OCTAVE, 0, -1)])
    near_1 = np.concatenate([_octave(k, coarsening) for k in range(lowest_next_to_1, 0, -1)])
    return np.concatenate([[0.0], near_0, [0.5], 1.0 - near_1[::-1], [1.0]])


def _octave(k: int, coarsening: int) -> NDArray[np.float64]:
    """Lower edges of equal bins from 2^-(k+1) to 2^-k: 64 in the three octaves next to 0.5, 32 in three, then 16."""
    bins = (64 if k <= 3 else 32 if k <= 6 else 16) // coarsening
    return 2.0 ** -(k + 1) * (1.0 + np.arange(bins) / bins)


PROBABILITY_EDGES = np.union1d(_edges(), np.nextafter(np.array(MASSES, np.float32), np.float32(2.0)).astype(np.float64))
"""Edges (B+1,) of the bins of a histogram of probabilities, float32: multiples of 2^-17, and the number after each of
MASSES.

Bin b covers `PROBABILITY_EDGES[b] <= p < PROBABILITY_EDGES[b + 1]`. The edges are nearly log-spaced towards 0 and 1,
down to 2^-13: the order of small probabilities decides the PR-AUC of rare objects, the order of large ones the PR-AUC
of walls.
"""
PROBABILITY_BINS = len(PROBABILITY_EDGES) - 1
CALIBRATION_EDGES = _edges(_COARSENING, _LOWEST_OCTAVE_NEXT_TO_1)
"""Edges (C+1,) of the coarser bins for calibration, some of PROBABILITY_EDGES; p = 1 is in the last bin. In finer bins
the share of occupied cells is mostly noise, which adds to every calibration error."""
CALIBRATION_BINS = len(CALIBRATION_EDGES) - 1
HALF = int(np.searchsorted(PROBABILITY_EDGES, 0.5))
"""The bin with the lower edge 0.5."""
FIRST_OF_CALIBRATION_BIN = np.searchsorted(PROBABILITY_EDGES, CALIBRATION_EDGES[:-1])
"""The first bin (C,) of each bin for calibration."""
CALIBRATION_BIN = np.searchsorted(FIRST_OF_CALIBRATION_BIN, np.arange(PROBABILITY_BINS), side="right") - 1
"""The bin for calibration of each bin (B,)."""
_SLOTS = 1 << 17
"""A table maps a probability to its bin: every edge is a multiple of 1 / _SLOTS, but for the ends of the MASSES."""
_BIN_OF_SLOT = np.searchsorted(PROBABILITY_EDGES[1:-1], (np.arange(_SLOTS + 1) + 0.5) / _SLOTS, side="right").astype(
    np.int16
)
CLIP = 1e-3
"""Probabilities are clipped to [CLIP, 1 - CLIP] for the log loss."""


@dataclass(slots=True)
class Tally:
    """Counts over cells, per step S = steps+1, stratum K and probability bin; tallies add up.

    `cells`, `positives` (S, K, B) int64: scored cells and the occupied ones; `p_sum` (S, K, C) float64: sum of the
    forecast probability in each bin for calibration; `squared_error`, `log_loss` (S, K) float64: sums over cells, log
    loss in nats. `strata` names the K strata.
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
        plain = steps + 1, len(strata)
        cells, positives = np.zeros((2, *plain, PROBABILITY_BINS), np.int64)
        return cls(cells, positives, np.zeros((*plain, CALIBRATION_BINS)), np.zeros(plain), np.zeros(plain), strata)

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

    def at(self, steps: list[int]) -> Tally:
        """The counts of these steps only, in their order."""
        return Tally(
            self.cells[steps],
            self.positives[steps],
            self.p_sum[steps],
            self.squared_error[steps],
            self.log_loss[steps],
            self.strata,
        )

    def confusion(self, threshold_bins: NDArray[np.int64]) -> NDArray[np.int64]:
        """TP, FP, FN, TN (..., S, K, 4) when the bins `threshold_bins` (..., S, K) and above are called occupied."""
        bins = threshold_bins.reshape(-1, *threshold_bins.shape[-2:])
        found: NDArray[np.int64] = _confusion(self.cells, self.positives, bins)
        return found.reshape(*threshold_bins.shape, 4)


def for_calibration(counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Counts (..., B) of the bins summed over the bins for calibration (..., C)."""
    summed: NDArray[np.int64] = np.add.reduceat(counts, FIRST_OF_CALIBRATION_BIN, axis=-1)
    return summed


def cells_of(forecast: ScoredForecast) -> Tally:
    """The counts of a forecast, in its strata."""
    return count_cells(forecast.occupancy, forecast.targets, forecast.region_maps, forecast.ages)


def count_cells(
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
    tally = Tally.empty(steps, region_maps.strata)
    sums = SUMS_OF_REGIONS[[STRATA_WITH_TRUTH.index(name) for name in region_maps.strata]]
    for n, target in enumerate(targets):
        p, state, motion = occupancy[n].reshape(-1), target.state.reshape(-1), target.motion.reshape(-1)
        cells, positives = np.zeros((2, REGIONS, PROBABILITY_BINS), np.int32)
        p_sum, losses = np.zeros((REGIONS, CALIBRATION_BINS)), np.zeros((2, REGIONS))
        _count_step(p, state, motion, seen, hidden, cells, positives, p_sum, losses[0], losses[1])
        _add_regions(sums, cells, positives, tally.cells[n], tally.positives[n])
        tally.p_sum[n] = sums @ p_sum
        tally.squared_error[n], tally.log_loss[n] = losses @ sums.T
    return tally


@numba.njit(cache=True, nogil=True, error_model="numpy")
def bin_of(p):  # type: ignore[no-untyped-def]
    """The bin of a probability, float32; between two such numbers the bin may be a neighbour in its calibration bin."""
    return _BIN_OF_SLOT[int(p * _SLOTS)] - (p in (0.0, 0.5))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _count_step(probability, state, motion, seen, hidden, cells, positives, p_sum, squared_error, log_loss):  # type: ignore[no-untyped-def]
    """Add one step's scored cells (M*M,) to their regions' counts: histograms (R, B), (R, C) and sums (R,).

    The log loss is accumulated as a product of likelihoods, with a logarithm only before it could underflow: about one
    logarithm per hundred cells instead of one per cell.
    """
    likelihood = np.ones(log_loss.size)
    for i in range(probability.size):
        if state[i] == NOT_SCORED:
            continue
        region = seen[i] + RANGES * motion[i] if state[i] <= SEEN_OCCUPIED else hidden[i]
        p = float(probability[i])
        bin_ = bin_of(p)
        cells[region, bin_] += 1
        p_sum[region, CALIBRATION_BIN[bin_]] += p
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


@numba.njit(cache=True, nogil=True)
def _add_regions(sums, cells, positives, cells_of_stratum, positives_of_stratum):  # type: ignore[no-untyped-def]
    """Add the counts (R, B) of regions to the counts (K, B) of the strata; `sums` (K, R) marks the regions of each."""
    for k in range(sums.shape[0]):
        for region in range(sums.shape[1]):
            if sums[k, region]:
                for b in range(PROBABILITY_BINS):
                    cells_of_stratum[k, b] += cells[region, b]
                    positives_of_stratum[k, b] += positives[region, b]


@numba.njit(cache=True, nogil=True)
def _confusion(cells, positives, threshold_bins):  # type: ignore[no-untyped-def]
    """TP, FP, FN, TN (T, S, K, 4) of histograms (S, K, B) at the bins (T, S, K)."""
    found = np.zeros((*threshold_bins.shape, 4), np.int64)
    # of each bin the cells and positives from it on
    called, called_positives = np.zeros((2, cells.shape[2] + 1), np.int64)
    for s in range(cells.shape[0]):
        for k in range(cells.shape[1]):
            for b in range(cells.shape[2] - 1, -1, -1):
                called[b] = called[b + 1] + cells[s, k, b]
                called_positives[b] = called_positives[b + 1] + positives[s, k, b]
            for t in range(threshold_bins.shape[0]):
                b = threshold_bins[t, s, k]
                true, missed = called_positives[b], called_positives[0] - called_positives[b]
                found[t, s, k, 0] = true
                found[t, s, k, 1] = called[b] - true
                found[t, s, k, 2] = missed
                found[t, s, k, 3] = called[0] - called[b] - missed
    return found

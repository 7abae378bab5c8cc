"""Thresholds by step and stratum: a cell with at least this probability is called occupied."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.referee.strata import STRATA, THRESHOLD_OF
from gridtrack.evaluation.scores.cells import (
    CALIBRATION_BINS,
    CALIBRATION_EDGES,
    FIRST_OF_CALIBRATION_BIN,
    HALF,
    PROBABILITY_BINS,
    PROBABILITY_EDGES,
    Tally,
    for_calibration,
)

NEAREST_TO_HALF = 1 + np.abs(PROBABILITY_EDGES[1:PROBABILITY_BINS] - 0.5).argsort(kind="stable")
"""The bins that may be thresholds, the nearest to 0.5 first."""
_CALIBRATION_NEAREST_TO_HALF = 1 + np.abs(CALIBRATION_EDGES[1:CALIBRATION_BINS] - 0.5).argsort(kind="stable")
"""The bins for calibration with lower edges that may be thresholds, the nearest to 0.5 first."""
LABEL_FREE = "its earlier forecasts, without labels"
"""Thresholds chosen on this are those of `LabelFreeThresholds`; the stored ones stand for them in pictures."""


@dataclass(frozen=True, slots=True)
class Thresholds:
    """Thresholds as histogram bins (S, K) by step and stratum, and the stretch on which they were chosen.

    `strata` names the K strata. `chosen_on` is empty without a validation stretch; all thresholds are then 0.5.
    """

    bins: NDArray[np.int64]
    chosen_on: str = ""
    strata: tuple[str, ...] = STRATA

    @property
    def values(self) -> NDArray[np.float64]:
        """Thresholds (S, K) as probabilities."""
        return PROBABILITY_EDGES[self.bins]

    @property
    def by_stratum(self) -> dict[str, tuple[float, ...]]:
        """The threshold of each step as a probability, by stratum."""
        return dict(zip(self.strata, map(tuple, self.values.T.tolist()), strict=True))

    @classmethod
    def of(cls, by_stratum: Mapping[str, tuple[float, ...]], chosen_on: str) -> Thresholds:
        """Thresholds from their probabilities by stratum."""
        return cls(bins_of(np.array(list(by_stratum.values())).T), chosen_on, tuple(by_stratum))


def half(steps: int, strata: tuple[str, ...] = STRATA) -> Thresholds:
    """Thresholds of 0.5 at steps 0..steps, in every stratum."""
    return Thresholds(np.full((steps + 1, len(strata)), HALF), strata=strata)


def bins_of(values: NDArray[np.float64]) -> NDArray[np.int64]:
    """The bins (...) with these thresholds (...) as lower edges."""
    return PROBABILITY_EDGES.searchsorted(values)


def best_thresholds(tally: Tally, chosen_on: str) -> Thresholds:
    """The thresholds that maximise F1 at each step in each stratum of `tally`.

    Candidates are the edges of the bins; of equal ones the nearest to 0.5 is chosen, so a binary forecast gets 0.5, and
    so does a step without occupied cells. Each stratum has its own threshold, because the best threshold for F1 is half
    the attainable F1 (Lipton et al., 2014): where most visible cells are walls, one threshold for all cells is higher
    than any calibrated probability of a moving object. Bands of range and of age use the threshold of the stratum that
    contains them.
    """
    f1 = _f1_from_each_bin(tally.cells, tally.positives)[..., NEAREST_TO_HALF]
    best = NEAREST_TO_HALF[np.nan_to_num(f1).argmax(axis=-1)]
    whole = [tally.strata.index(THRESHOLD_OF[name]) for name in tally.strata]
    return Thresholds(best[:, whole], chosen_on, tally.strata)


class LabelFreeThresholds:
    """The threshold of each step and stratum, from the earlier forecasts of a trial, without their labels.

    The probabilities of the cells of a stratum are known once their frame is observed, and so is where the stratum is;
    the occupancy of the cells is not used. If the probabilities are right, the expected F1 at a threshold is about
    2 E[TP] / (called + E[occupied]), with E[TP] the sum of the probabilities of the called cells and E[occupied] that
    of all cells. Candidates are the edges of the bins for calibration.
    """

    def __init__(self, steps: int, strata: tuple[str, ...]) -> None:
        self._cells, self._p_sum = np.zeros((2, steps + 1, len(strata), CALIBRATION_BINS))
        self.half = half(steps, strata).bins
        """The bins (S, K) of a threshold of 0.5."""
        self._whole = [strata.index(THRESHOLD_OF[name]) for name in strata]
        self._waiting: deque[tuple[int, NDArray[np.int64], NDArray[np.float64]]] = deque()

    def bins(self, stamp_ns: int) -> NDArray[np.int64]:
        """Thresholds (S, K), as bins of the histogram, of a forecast made at `stamp_ns`; 0.5 for the first forecast.

        They follow from the forecasts with all frames observed by then. Stamps must not decrease.
        """
        while self._waiting and self._waiting[0][0] <= stamp_ns:
            _, cells, p_sum = self._waiting.popleft()
            self._cells += cells
            self._p_sum += p_sum
        expected = _f1_from_each_bin(self._cells, self._p_sum)[..., _CALIBRATION_NEAREST_TO_HALF]
        nearest = _CALIBRATION_NEAREST_TO_HALF[np.nan_to_num(expected).argmax(axis=-1)]
        known = self._p_sum[..., ::-1].cumsum(axis=-1)[..., -1] > 0
        chosen: NDArray[np.int64] = np.where(known, FIRST_OF_CALIBRATION_BIN[nearest], self.half)[:, self._whole]
        return chosen

    def add(self, observed_ns: int, tally: Tally) -> None:
        """Add the counts of a forecast with its last frame observed at `observed_ns`."""
        self._waiting.append((observed_ns, for_calibration(tally.cells), tally.p_sum))


def _f1_from_each_bin(cells: NDArray[np.number], positives: NDArray[np.number]) -> NDArray[np.float64]:
    """F1 (..., B) where the cells of a bin and above are called occupied, of histograms (..., B); NaN without cells."""
    called, found = (counts[..., ::-1].cumsum(axis=-1)[..., ::-1] for counts in (cells, positives))
    whole = called + found[..., :1]
    f1 = np.full(whole.shape, np.nan)
    np.divide(2 * found, whole, out=f1, where=whole > 0)
    return f1

"""Thresholds that need no labels: the maximum of the F1 that a tracker's own probabilities lead one to expect."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.results.columns import CALIBRATION_BINS, CALIBRATION_EDGES
from gridtrack.evaluation.scoring.counting import FIRST_OF_CALIBRATION_BIN, Tally, for_calibration
from gridtrack.evaluation.scoring.metrics import ratio
from gridtrack.evaluation.scoring.strata import THRESHOLD_OF
from gridtrack.evaluation.scoring.thresholds import half

_NEAREST_TO_HALF = 1 + np.abs(CALIBRATION_EDGES[1:CALIBRATION_BINS] - 0.5).argsort(kind="stable")
"""The bins for calibration whose lower edges may be thresholds, the nearest to 0.5 first."""


class LabelFreeThresholds:
    """The threshold of each step and stratum, from the forecasts of a trial so far.

    The probabilities of the cells of a stratum are known once their frame is observed, and so is where the stratum is;
    what was observed in the cells is not used. If the probabilities are right, the expected F1 at a threshold is about
    2 E[TP] / (called + E[occupied]), with E[TP] the sum of the probabilities of the called cells and E[occupied] that
    of all cells. Candidates are the edges of the bins for calibration.
    """

    def __init__(self, steps: int, strata: tuple[str, ...]) -> None:
        self._cells, self._p_sum = np.zeros((2, steps + 1, len(strata), CALIBRATION_BINS))
        self._half = half(steps, strata).bins
        self._whole = [strata.index(THRESHOLD_OF[name]) for name in strata]
        self._waiting: deque[tuple[int, NDArray[np.int64], NDArray[np.float64]]] = deque()

    def bins(self, stamp_ns: int) -> NDArray[np.int64]:
        """Thresholds (S, K), as bins of the histogram, of a forecast made at `stamp_ns`: 0.5 before there is any other.

        From the forecasts of which every frame was observed by then. Stamps must not decrease.
        """
        while self._waiting and self._waiting[0][0] <= stamp_ns:
            _, cells, p_sum = self._waiting.popleft()
            self._cells += cells
            self._p_sum += p_sum
        called, found = (sums[..., ::-1].cumsum(axis=-1)[..., ::-1] for sums in (self._cells, self._p_sum))
        expected = ratio(2 * found, called + found[..., :1])[..., _NEAREST_TO_HALF]
        best = FIRST_OF_CALIBRATION_BIN[_NEAREST_TO_HALF[np.nan_to_num(expected).argmax(axis=-1)]]
        known = found[..., 0] > 0
        chosen: NDArray[np.int64] = np.where(known, best, self._half)[:, self._whole]
        return chosen

    def add(self, observed_ns: int, tally: Tally) -> None:
        """Add the counts of a forecast whose last frame is observed at `observed_ns`."""
        self._waiting.append((observed_ns, for_calibration(tally.cells), tally.p_sum))

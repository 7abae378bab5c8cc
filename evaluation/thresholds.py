"""The threshold of each step: from which probability on a cell of a forecast is called occupied."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.counting import BINS, HALF, Tally
from gridtrack.evaluation.metrics import f1_score
from gridtrack.evaluation.strata import STRATA


@dataclass(frozen=True, slots=True)
class Thresholds:
    """One threshold per step, for every stratum: histogram bins (S,), and the stretch that they were chosen on.

    `chosen_on` is empty where there was no validation stretch; the thresholds are then 0.5.
    """

    bins: NDArray[np.int64]
    chosen_on: str = ""

    @property
    def values(self) -> NDArray[np.float64]:
        """Thresholds (S,) as probabilities: multiples of 0.02."""
        return self.bins / BINS


def half(steps: int) -> Thresholds:
    """0.5 at steps 0..steps."""
    return Thresholds(np.full(steps + 1, HALF))


def best_thresholds(tally: Tally, chosen_on: str) -> Thresholds:
    """The thresholds that maximise visible F1 of each step on the stretch that `tally` counts.

    Candidates are 0.02, 0.04 .. 0.98. Among equals the one nearest to 0.5, so a forecast of zeros and ones gets 0.5,
    and so does a step at which nothing was occupied.
    """
    candidates = np.array(sorted(range(1, BINS), key=lambda b: abs(b - HALF)))
    visible = STRATA.index("visible")
    f1 = np.stack([f1_score(tally.confusion(np.full(len(tally.cells), b))[:, visible]) for b in candidates])
    return Thresholds(candidates[np.nan_to_num(f1).argmax(axis=0)], chosen_on)

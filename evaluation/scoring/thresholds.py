"""The threshold of each step and stratum: from which probability on a cell of a forecast is called occupied."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.scoring.counting import EDGES, HALF, PROBABILITY_BINS, Tally
from gridtrack.evaluation.scoring.metrics import f1_score
from gridtrack.evaluation.scoring.strata import STRATA, THRESHOLD_OF


@dataclass(frozen=True, slots=True)
class Thresholds:
    """Histogram bins (S, K), a threshold for each step and stratum, and the stretch that they were chosen on.

    `strata` names the K of them.
    `chosen_on` is empty where there was no validation stretch; the thresholds are then 0.5.
    """

    bins: NDArray[np.int64]
    chosen_on: str = ""
    strata: tuple[str, ...] = STRATA

    @property
    def values(self) -> NDArray[np.float64]:
        """Thresholds (S, K) as probabilities."""
        return EDGES.astype(np.float64)[self.bins]


def half(steps: int, strata: tuple[str, ...] = STRATA) -> Thresholds:
    """0.5 at steps 0..steps, in every stratum."""
    return Thresholds(np.full((steps + 1, len(strata)), HALF), strata=strata)


def best_thresholds(tally: Tally, chosen_on: str) -> Thresholds:
    """The thresholds that maximise each step's F1 in each stratum on the stretch that `tally` counts.

    Candidates are the bins' edges. Among equals the one nearest to 0.5, so a forecast of zeros and ones gets 0.5,
    and so does a step at which nothing was occupied. Each stratum has its own because the best threshold for F1 is
    half the F1 that can be had (Lipton et al., 2014): where walls are nearly all that is seen, a threshold chosen on
    everything lies above any honest probability of a person's next place, and calls nothing there occupied. Bands of
    range and of age share the threshold of the whole that they are parts of.
    """
    candidates = np.array(sorted(range(1, PROBABILITY_BINS), key=lambda b: abs(b - HALF)))
    f1 = np.stack([f1_score(tally.confusion(np.full(tally.squared_error.shape, b))) for b in candidates])
    best = candidates[np.nan_to_num(f1).argmax(axis=0)]
    whole = [tally.strata.index(THRESHOLD_OF[name]) for name in tally.strata]
    return Thresholds(best[:, whole], chosen_on, tally.strata)

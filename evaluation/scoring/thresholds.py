"""Thresholds by step and stratum: a cell with at least this probability is called occupied."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.results.columns import PROBABILITY_BINS
from gridtrack.evaluation.results.trial_record import ThresholdsUsed
from gridtrack.evaluation.scoring.counting import EDGES, HALF, Tally
from gridtrack.evaluation.scoring.metrics import f1_score
from gridtrack.evaluation.scoring.strata import STRATA, THRESHOLD_OF


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
        return EDGES.astype(np.float64)[self.bins]

    def used(self) -> ThresholdsUsed:
        """As a trial's record holds them."""
        columns = self.values.T.tolist()
        return ThresholdsUsed(values=dict(zip(self.strata, map(tuple, columns), strict=True)), chosen_on=self.chosen_on)


def half(steps: int, strata: tuple[str, ...] = STRATA) -> Thresholds:
    """Thresholds of 0.5 at steps 0..steps, in every stratum."""
    return Thresholds(np.full((steps + 1, len(strata)), HALF), strata=strata)


def best_thresholds(tally: Tally, chosen_on: str) -> Thresholds:
    """The thresholds that maximise F1 at each step in each stratum of `tally`.

    Candidates are the edges of the bins; of equal ones the nearest to 0.5 is chosen, so a binary forecast gets 0.5, and
    so does a step without occupied cells. Each stratum has its own threshold, because the best threshold for F1 is half
    the attainable F1 (Lipton et al., 2014): where most visible cells are walls, one threshold for all cells is higher
    than any calibrated probability of a moving object. Bands of range and of age use the threshold of the stratum that
    they are parts of.
    """
    candidates = np.array(sorted(range(1, PROBABILITY_BINS), key=lambda b: abs(b - HALF)))
    f1 = np.stack([f1_score(tally.confusion(np.full(tally.squared_error.shape, b))) for b in candidates])
    best = candidates[np.nan_to_num(f1).argmax(axis=0)]
    whole = [tally.strata.index(THRESHOLD_OF[name]) for name in tally.strata]
    return Thresholds(best[:, whole], chosen_on, tally.strata)

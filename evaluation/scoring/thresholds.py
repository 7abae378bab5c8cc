"""Thresholds by step and stratum: a cell with at least this probability is called occupied."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.results.columns import PROBABILITY_BINS, PROBABILITY_EDGES
from gridtrack.evaluation.results.trial_record import ThresholdsUsed
from gridtrack.evaluation.scoring.counting import HALF, Tally
from gridtrack.evaluation.scoring.metrics import ratio
from gridtrack.evaluation.scoring.strata import STRATA, THRESHOLD_OF

NEAREST_TO_HALF = 1 + np.abs(PROBABILITY_EDGES[1:PROBABILITY_BINS] - 0.5).argsort(kind="stable")
"""The bins that may be thresholds, the nearest to 0.5 first."""


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

    def used(self) -> ThresholdsUsed:
        """As a trial's record holds them."""
        columns = self.values.T.tolist()
        return ThresholdsUsed(values=dict(zip(self.strata, map(tuple, columns), strict=True)), chosen_on=self.chosen_on)


def half(steps: int, strata: tuple[str, ...] = STRATA) -> Thresholds:
    """Thresholds of 0.5 at steps 0..steps, in every stratum."""
    return Thresholds(np.full((steps + 1, len(strata)), HALF), strata=strata)


def thresholds_of(used: ThresholdsUsed) -> Thresholds:
    """The thresholds that a trial's record holds."""
    values = np.array(list(used.values.values())).T
    return Thresholds(bins_of(values), used.chosen_on, tuple(used.values))


def bins_of(values: NDArray[np.float64]) -> NDArray[np.int64]:
    """The bins (...) whose lower edges are these thresholds (...)."""
    return PROBABILITY_EDGES.searchsorted(values)


def best_thresholds(tally: Tally, chosen_on: str) -> Thresholds:
    """The thresholds that maximise F1 at each step in each stratum of `tally`.

    Candidates are the edges of the bins; of equal ones the nearest to 0.5 is chosen, so a binary forecast gets 0.5, and
    so does a step without occupied cells. Each stratum has its own threshold, because the best threshold for F1 is half
    the attainable F1 (Lipton et al., 2014): where most visible cells are walls, one threshold for all cells is higher
    than any calibrated probability of a moving object. Bands of range and of age use the threshold of the stratum that
    they are parts of.
    """
    called, found = (counts[..., ::-1].cumsum(axis=-1)[..., ::-1] for counts in (tally.cells, tally.positives))
    f1 = ratio(2 * found, called + found[..., :1])[..., NEAREST_TO_HALF]
    best = NEAREST_TO_HALF[np.nan_to_num(f1).argmax(axis=-1)]
    whole = [tally.strata.index(THRESHOLD_OF[name]) for name in tally.strata]
    return Thresholds(best[:, whole], chosen_on, tally.strata)

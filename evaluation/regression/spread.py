"""Which falls in F1 are more than what separates trainings: a run against several trainings of the same tracker.

Were the run one more training, the mean F1 of K trainings less its own would have (1 + 1/K) times the variance s² from
training to training. Of few trainings s² is badly known. But in a row in which trainings differ alike in every unit and
in one in which they do not, s² is of the order of w, the variance that this disagreement of units alone would give one
training's F1. So s² is drawn towards w times the mean of s²/w over the tracker's rows, and that mean counts for
PRIOR_FREEDOM degrees of freedom: a moderated t (Smyth, Statistical Applications in Genetics and Molecular Biology 3,
2004). docs/regress.md says how it was chosen and how often it errs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr

from gridtrack.evaluation.scoring.metrics import f1_score

Floats = NDArray[np.float64]
PRIOR_FREEDOM = 1.5
"""Degrees of freedom that the mean ratio of a tracker's rows counts for, beside the K - 1 of the row itself."""


@dataclass(frozen=True, slots=True)
class Spread:
    """`deviation` (R,): the standard deviation of F1 from training to training, of so many `trainings`, moderated;
    `freedom`: the degrees of freedom of its square."""

    deviation: Floats
    trainings: int
    freedom: float


def spread_between(trainings: Floats, prior_freedom: float = PRIOR_FREEDOM) -> Spread:
    """What separates K >= 2 trainings of one tracker: TP, FP, FN, TN (K, U, R, 4) in U units and R rows.

    A row in which all of them are equal in every unit, or have nothing to find, has a deviation of 0.
    """
    own = np.nan_to_num(f1_score(trainings.sum(axis=1)).var(axis=0, ddof=1))
    by_units = _variance_by_units(trainings)
    moved = by_units > 0
    ratio = own[moved] / by_units[moved]
    prior = ratio.mean() if moved.any() else 0.0
    freedom = len(trainings) - 1 + prior_freedom
    moderated = np.zeros_like(own)
    moderated[moved] = by_units[moved] * (ratio + prior_freedom / freedom * (prior - ratio))
    return Spread(np.sqrt(moderated), len(trainings), freedom)


def beyond_spread(fall: Floats, spread: Spread, family: int) -> Floats:
    """P (R,) that a fall (R,) of F1 below the mean of the trainings, as large as each, comes by one more training in
    any of `family` rows: Student's t with Bonferroni's correction. Where nothing separates trainings any fall has 0.
    """
    error = spread.deviation * np.sqrt(1 + 1 / spread.trainings)
    t = np.where(fall > 0, np.inf, 0.0)
    np.divide(fall, error, out=t, where=error > 0)
    corrected: Floats = np.minimum(family * stdtr(spread.freedom, -t), 1.0)
    return corrected


def _variance_by_units(trainings: Floats) -> Floats:
    """The variance (R,) that pooled F1 of one training has for how unlike trainings differ in the units alone.

    Each unit adds its linearised share to F1, and the shares' differences from their mean over trainings are what the
    units do not agree on.
    """
    count, units = trainings.shape[:2]
    hits = 2 * trainings[..., 0]
    sizes = hits + trainings[..., 1] + trainings[..., 2]
    whole = sizes.sum(axis=1, keepdims=True)
    f1 = np.nan_to_num(f1_score(trainings.sum(axis=1)))[:, None]
    shares = np.divide(hits - f1 * sizes, whole, out=np.zeros_like(hits), where=whole > 0)
    apart = shares - shares.mean(axis=0)
    variance: Floats = (apart**2).sum(axis=(0, 1)) / (count - 1) * units / (units - 1)
    return variance

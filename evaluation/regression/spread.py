"""Significance of a fall in F1 against the spread between trainings of the same tracker.

If the run were one more training, the mean F1 of K trainings less its own would have the variance (1 + 1/K) s², where
s² is the variance between trainings. Few trainings estimate s² badly. It is of the order of w, the variance of one
training's F1 that follows from the disagreement between units alone. So the estimate of s² is shrunk towards w times
the mean of s²/w over the tracker's rows, and this mean counts for PRIOR_FREEDOM degrees of freedom: a moderated t-test
(Smyth, Statistical Applications in Genetics and Molecular Biology 3, 2004). docs/regress.md: the choice of the prior
and the measured error rates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import stdtr

from gridtrack.evaluation.scoring.metrics import f1_score
from gridtrack.evaluation.statistics.jackknife import Floats

PRIOR_FREEDOM = 1.5
"""Degrees of freedom of the mean ratio over a tracker's rows, added to the K - 1 of the row itself."""


@dataclass(frozen=True, slots=True)
class Spread:
    """The spread between `trainings`: the moderated standard deviation (R,) of F1, and the degrees of freedom of its
    square."""

    deviation: Floats
    trainings: int
    freedom: float


def spread_between(trainings: Floats, prior_freedom: float = PRIOR_FREEDOM) -> Spread:
    """The spread between K >= 2 trainings of one tracker: TP, FP, FN, TN (K, U, R, 4) in U units and R rows.

    A row in which all trainings are equal in every unit, or have no occupied cell, has a deviation of 0.
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
    """P-values (R,) of falls (R,) in F1 below the mean of the trainings: Student's t with Bonferroni's correction for
    `family` rows. Where the deviation is 0, any fall has p = 0.
    """
    error = spread.deviation * np.sqrt(1 + 1 / spread.trainings)
    t = np.where(fall > 0, np.inf, 0.0)
    np.divide(fall, error, out=t, where=error > 0)
    corrected: Floats = np.minimum(family * stdtr(spread.freedom, -t), 1.0)
    return corrected


def _variance_by_units(trainings: Floats) -> Floats:
    """The variance (R,) of the pooled F1 of one training that follows from the disagreement between units alone.

    Each unit contributes its linearised share to F1; the disagreement is the shares less their mean over trainings.
    """
    count, units = trainings.shape[:2]
    hits = 2 * trainings[..., 0]
    sizes = hits + trainings[..., 1] + trainings[..., 2]
    whole = sizes.sum(axis=1, keepdims=True)
    f1 = np.nan_to_num(f1_score(trainings.sum(axis=1)))[:, None]
    shares = np.divide(hits - f1 * sizes, whole, out=np.zeros_like(hits), where=whole > 0)
    deviations = shares - shares.mean(axis=0)
    variance: Floats = (deviations**2).sum(axis=(0, 1)) / (count - 1) * units / (units - 1)
    return variance

"""Significance of a fall in a score against the spread between trainings of the baseline: a moderated t-test."""

from __future__ import annotations

import numpy as np
from scipy.special import stdtr, stdtrit

from gridtrack.evaluation.statistics.jackknife import Floats
from gridtrack.evaluation.statistics.training_spread import Spread


def beyond_spread(fall: Floats, spread: Spread, family: int) -> Floats:
    """P-values (R,) of falls (R,) in the score below the mean of the trainings: Student's t with Bonferroni's
    correction for `family` rows. Where the deviation is 0, any fall has p = 0.
    """
    t = np.where(fall > 0, np.inf, 0.0)
    np.divide(fall, spread.error, out=t, where=spread.error > 0)
    corrected: Floats = np.minimum(family * stdtr(spread.freedom, -t), 1.0)
    return corrected


def least_beyond(spread: Spread, family: int, level: float) -> Floats:
    """The smallest falls (R,) with a p-value of at most `level` in `beyond_spread`."""
    least: Floats = stdtrit(spread.freedom, 1 - level / family) * spread.error
    return least

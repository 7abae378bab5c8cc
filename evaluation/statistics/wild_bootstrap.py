"""Many differences over the same units, together: a wild bootstrap keeps how far they agree.

The influence of each unit on every difference gets a random sign, the same in all differences: they are 0 on average
and agree as far as they do in the run (Liu, Annals of Statistics 16, 1988). Two uses: the p-values of one family, less
careful than Holm's where its rows agree, and how often at least one of many families shows a difference.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import scipy  # loads scipy.special at its first use
from numpy.typing import NDArray

from gridtrack.evaluation.scores.definition import Floats
from gridtrack.evaluation.statistics.jackknife import ALPHA, WITHIN_ROUNDING, Replicates, degrees_of_freedom
from gridtrack.evaluation.statistics.trainings import total_variance

BOOTSTRAP_RUNS = 1000


@dataclass(frozen=True, slots=True)
class Variation:
    """The chance variation of N differences over U units.

    `influence` (U, N): of each unit on each difference, above 0 where it is in favour. `freedom` (N,): degrees of
    freedom of the units. `training_error` (N,): standard error over trainings, 0 without; `training_freedom`: its
    degrees of freedom.
    """

    influence: Floats
    freedom: Floats
    training_error: Floats
    training_freedom: float = 1.0

    def least_p(self, rows: NDArray[np.intp]) -> Floats:
        """The smallest one-sided p-value (D, N) of a fall among the first n + 1 of `rows` (N,), in D draws."""
        rng = np.random.default_rng(0)
        mean, error = _signed(self.influence[:, rows], random_signs(len(self.influence), rng))
        training, freedom = self.training_error[rows], self.freedom[rows]
        variance, together = total_variance((error**2, freedom), (training**2, self.training_freedom))
        mean += training * rng.standard_normal(mean.shape)
        variance += training**2 * (rng.chisquare(self.training_freedom, mean.shape) / self.training_freedom - 1)
        with np.errstate(divide="ignore", invalid="ignore"):
            p = np.where(variance > WITHIN_ROUNDING**2, scipy.special.stdtr(together, mean / np.sqrt(variance)), 1.0)
        least: Floats = np.minimum.accumulate(p, axis=1)
        return least


def random_signs(units: int, rng: np.random.Generator) -> Floats:
    """Random signs (D, U) of D = BOOTSTRAP_RUNS draws."""
    signs: Floats = rng.choice([-1.0, 1.0], (BOOTSTRAP_RUNS, units))
    return signs


def influence_on_difference(one: Replicates, other: Replicates) -> Floats:
    """Influence (U, ...) of each unit on the value less the other's, of mean 0."""
    without = np.nan_to_num(one.without - other.without)
    influence: Floats = (len(without) - 1) * (without.mean(axis=0) - without)
    return influence


def family_p(p: Floats, variation: Variation) -> tuple[Floats, float]:
    """The p-values (N,) of falls, one-sided, corrected for the family of them all; and the p-value of a single fall
    that the correction leaves at ALPHA.

    Step-down by the smallest p-value of the rows that are left (Westfall and Young, Resampling-Based Multiple Testing,
    1993, algorithm 2.8). NaN is a comparison without a result: it stays NaN and is not part of the family.
    """
    made = np.flatnonzero(~np.isnan(p))
    adjusted = np.full_like(p, np.nan)
    if not len(made):
        return adjusted, ALPHA
    order = made[np.argsort(-p[made], kind="stable")]
    least = variation.least_p(order)
    reached = (1 + (least <= p[order]).sum(axis=0)) / (1 + len(least))
    adjusted[order] = np.maximum.accumulate(reached[::-1])[::-1]
    return adjusted, min(float(np.quantile(least[:, -1], ALPHA)), ALPHA)


def false_difference_rate(families: Sequence[Mapping[str, Replicates]]) -> float:
    """Share of runs with equal trackers in which at least one of the families has a significant difference.

    A family: the rows of one score, stratum and horizon, each with its replicates (U, ...), of the same units in all
    families. Holm's correction holds within one family, and a reader may look at each.
    """
    signs = random_signs(next(iter(families[0].values())).units, np.random.default_rng(0))
    shown = np.zeros(BOOTSTRAP_RUNS, np.bool_)
    for rows in families:
        shown |= _any_significant(rows, signs)
    return float(shown.mean())


def _any_significant(rows: Mapping[str, Replicates], signs: Floats) -> NDArray[np.bool_]:
    """Marks (D,) of the draws of `signs` (D, U) with a significant difference between two rows, after Holm."""
    pairs = [(rows[one], rows[other]) for one, other in combinations(rows, 2)]
    influence = np.stack([influence_on_difference(one, other) for one, other in pairs], axis=1)
    freedom = np.array([degrees_of_freedom(one.size, other.size) for one, other in pairs])
    varied = np.square(influence).sum(axis=0) > WITHIN_ROUNDING**2
    if not varied.any():
        return np.zeros(len(signs), np.bool_)
    mean, error = _signed(influence[:, varied], signs)
    p = 2 * scipy.special.stdtr(freedom[varied], -np.abs(mean) / error)
    significant: NDArray[np.bool_] = p.min(axis=1) < ALPHA / len(pairs)
    return significant


def _signed(influence: Floats, signs: Floats) -> tuple[Floats, Floats]:
    """Mean and standard error (D, N) of the influence (U, N) under `signs` (D, U)."""
    units = len(influence)
    mean: Floats = signs @ influence / units
    rest = np.maximum(np.square(influence).sum(axis=0) / units - mean**2, 0.0)
    error: Floats = np.sqrt(rest / (units - 1))
    return mean, error

"""Many families of tests: how often at least one of them shows a difference between equal trackers.

Holm's correction holds within one family: all pairs of rows in one score, stratum and horizon. A reader who may look at
each of many families finds a difference by chance more often. How much more depends on how far the families agree,
which the units of the run itself show.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
import scipy  # loads scipy.special at its first use

from gridtrack.evaluation.scores.definition import Floats
from gridtrack.evaluation.statistics.jackknife import ALPHA, WITHIN_ROUNDING, Replicates, degrees_of_freedom

BOOTSTRAP_RUNS = 1000


def false_difference_rate(families: Sequence[Mapping[str, Replicates]]) -> float:
    """Share of runs with equal trackers in which at least one of the families has a significant difference.

    A family: the rows of one score, stratum and horizon, each with its replicates (U, ...), of the same units in all
    families. By a wild bootstrap: the influence of each unit on every difference gets a random sign, the same in all
    families, so that all differences are 0 on average and families agree as far as they do in the run (Liu, Annals of
    Statistics 16, 1988).
    """
    units = next(iter(families[0].values())).units
    signs = np.random.default_rng(0).choice([-1.0, 1.0], (BOOTSTRAP_RUNS, units))
    shown = np.zeros(BOOTSTRAP_RUNS, np.bool_)
    for rows in families:
        shown |= _any_significant(rows, signs)
    return float(shown.mean())


def _any_significant(rows: Mapping[str, Replicates], signs: Floats) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Marks (D,) of the draws of `signs` (D, U) with a significant difference between two rows, after Holm."""
    pairs = [(rows[one], rows[other]) for one, other in combinations(rows, 2)]
    influence = np.stack([_influence(one, other) for one, other in pairs], axis=1)
    freedom = np.array([degrees_of_freedom(one.size, other.size) for one, other in pairs])
    varied = np.square(influence).sum(axis=0) > WITHIN_ROUNDING**2
    if not varied.any():
        return np.zeros(len(signs), np.bool_)
    influence, freedom, units = influence[:, varied], freedom[varied], len(influence)
    mean = signs @ influence / units
    error = np.sqrt((np.square(influence).sum(axis=0) / units - mean**2) / (units - 1))
    p = 2 * scipy.special.stdtr(freedom, -np.abs(mean) / error)
    significant: np.ndarray[tuple[int], np.dtype[np.bool_]] = p.min(axis=1) < ALPHA / len(pairs)
    return significant


def _influence(one: Replicates, other: Replicates) -> Floats:
    """Influence (U,) of each unit on a difference, of mean 0."""
    without = np.nan_to_num(one.without - other.without)
    influence: Floats = (len(without) - 1) * (without.mean(axis=0) - without)
    return influence

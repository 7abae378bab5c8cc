"""Significance of falls in a score: a paired permutation test over units, corrected for the family of comparisons.

Under the null hypothesis the two runs are exchangeable in each unit. Swapping them at random, in whole units, gives the
distribution of falls by chance. Each fall is compared with the largest of the family in every permutation (single-step
max-T, Westfall and Young, 1993), which controls the family-wise error rate under any dependence of strata and steps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gridtrack.evaluation.statistics.jackknife import Floats
from gridtrack.evaluation.statistics.training_spread import value_of

SWAPS = 9999
FAMILY_LEVEL = 0.05
"""Family-wise error rate: how often at most a run that is no worse is called worse in any row."""


@dataclass(frozen=True, slots=True)
class SwapTest:
    """P-values (R,) of falls, corrected over the R rows, and the `critical` standardised fall that they follow from."""

    p: Floats
    critical: float


def swap_test(baseline: Floats, run: Floats, signs: Floats) -> SwapTest:
    """Test the falls in pooled scores, in standard errors.

    `baseline`, `run`: numerators and denominators (U, R, 2) of the same cells in U units and R rows; `signs` (R,) as
    `PairedRow.sign`. A row that is equal in every unit, or without a score, gets p = 1. The same counts give the same
    p: the swaps are drawn from a fixed seed.
    """
    units = baseline.shape[0]
    swapped = np.random.default_rng(0).integers(0, 2, (SWAPS, units)).astype(np.float64)
    stay = np.vstack([np.zeros(units), swapped])
    difference = (stay @ (run - baseline).reshape(units, -1)).reshape(len(stay), *baseline.shape[1:])
    falls = signs * (value_of(baseline.sum(axis=0) + difference) - value_of(run.sum(axis=0) - difference))
    spread = falls.std(axis=0)
    standardised = np.zeros_like(falls)
    np.divide(falls, spread, out=standardised, where=spread > 1e-12)
    largest = np.sort(standardised.max(axis=1, initial=-np.inf))
    # rounding must not decide whether a swap ties with the observed fall
    at_least = len(largest) - np.searchsorted(largest, standardised[0] - 1e-9)
    critical = largest[len(largest) - int(FAMILY_LEVEL * len(largest)) - 1]
    return SwapTest(np.where(spread > 1e-12, at_least / len(largest), 1.0), float(critical))

"""Significance of falls in F1: a paired permutation test over units, corrected for the whole family of comparisons.

Under the null hypothesis the two runs are exchangeable in each unit. Swapping them at random, in whole units, gives the
distribution of falls by chance. Each fall is compared with the largest of the family in every permutation (single-step
max-T, Westfall and Young, 1993), which controls the family-wise error rate under any dependence of strata and steps.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.scoring.metrics import f1_score

SWAPS = 9999
FAMILY_LEVEL = 0.05
"""Family-wise error rate: how often at most a run that is no worse is called worse in any row."""


def fall_p_values(baseline: NDArray[np.float64], run: NDArray[np.float64]) -> NDArray[np.float64]:
    """P-values (R,) of the falls in pooled F1, in standard errors, corrected over the R rows.

    `baseline`, `run`: TP, FP, FN, TN (U, R, 4) of the same cells in U units and R rows. A row that is equal in every
    unit, or has no occupied cell, gets 1. The same counts give the same p: the swaps are drawn from a fixed seed.
    """
    units = baseline.shape[0]
    swapped = np.random.default_rng(0).integers(0, 2, (SWAPS, units)).astype(np.float64)
    stay = np.vstack([np.zeros(units), swapped])
    difference = (stay @ (run - baseline).reshape(units, -1)).reshape(len(stay), *baseline.shape[1:])
    falls = f1_score(baseline.sum(axis=0) + difference) - f1_score(run.sum(axis=0) - difference)
    spread = falls.std(axis=0)
    standardised = np.zeros_like(falls)
    np.divide(falls, spread, out=standardised, where=spread > 1e-12)
    largest = np.sort(standardised.max(axis=1, initial=-np.inf))
    # rounding must not decide whether a swap ties with the observed fall
    at_least = len(largest) - np.searchsorted(largest, standardised[0] - 1e-9)
    p = at_least / len(largest)
    return np.where(spread > 1e-12, p, 1.0)

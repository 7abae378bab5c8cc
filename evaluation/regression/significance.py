"""Which falls in F1 are no chance: paired swaps of two runs over units, corrected for the whole family of comparisons.

Where two runs are alike, it is chance which of them was called the baseline in a unit. Swapping them at random, in
whole units, shows what falls come by chance alone; the largest of them over the family is what each fall is held
against (single-step max-T of Westfall and Young, 1993), so a run that is no worse is called worse anywhere in at most
the stated share of comparisons, however its strata and steps depend on each other.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.scoring.metrics import f1_score

SWAPS = 9999
FAMILY_LEVEL = 0.05
"""How often at most a run that is no worse is called worse in any row."""


def fall_p_values(baseline: NDArray[np.float64], run: NDArray[np.float64]) -> NDArray[np.float64]:
    """P (R,) that a fall in pooled F1 as large as each row's, in its standard errors, comes by chance anywhere.

    `baseline`, `run`: TP, FP, FN, TN (U, R, 4) of the same cells in U units and R rows. A row that is equal in every
    unit, or has nothing to find, gets 1. The same counts give the same p: the swaps are drawn from a fixed seed.
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
    # a last bit must not decide whether a swap ties with what was found
    beaten_by = len(largest) - np.searchsorted(largest, standardised[0] - 1e-9)
    p = beaten_by / len(largest)
    return np.where(spread > 1e-12, p, 1.0)

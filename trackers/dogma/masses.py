"""Dempster-Shafer masses of cells: what a frame says, what was expected, both combined, and what of it is newborn.

Equations of Nuss et al., "A random finite set approach for dynamic occupancy grid maps with real-time application"
(IJRR 2018, arXiv 1605.02406), section V. Masses are (M, M) float32; what neither holds is unknown, 1 - m_O - m_F.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import Mask

Mass = NDArray[np.float32]


class Masses(NamedTuple):
    """Evidence of a grid: `occupied` and `free` (M, M) float32, each at least 0 and together at most 1."""

    occupied: Mass
    free: Mass


def measured(visible: Mask, occupied: Mask, when_hit: float, when_crossed: float) -> Masses:
    """What a frame says: an occupied cell is so with mass `when_hit`, one only crossed is free with `when_crossed`."""
    hit = np.where(occupied, np.float32(when_hit), np.float32(0.0))
    return Masses(hit, np.where(visible & ~occupied, np.float32(when_crossed), np.float32(0.0)))


def predicted_free(free: Mass, keep: float, occupied: Mass) -> Mass:
    """Free mass after a while in which the share `keep` of it stays, less what `occupied` mass has moved in."""
    return np.asarray(np.minimum(free * np.float32(keep), 1 - occupied))


def combined(prior: Masses, evidence: Masses) -> Masses:
    """Dempster's rule: both, less what they contradict each other in, which must not be everything."""
    unknown, silent = 1 - prior.occupied - prior.free, 1 - evidence.occupied - evidence.free
    conflict = prior.occupied * evidence.free + prior.free * evidence.occupied
    occupied = prior.occupied * (evidence.occupied + silent) + unknown * evidence.occupied
    free = prior.free * (evidence.free + silent) + unknown * evidence.free
    return Masses(occupied / (1 - conflict), free / (1 - conflict))


def newborn(occupied: Mass, predicted: Mass, birth_probability: float) -> Mass:
    """The share of the updated mass `occupied` that has just appeared, where `predicted` was expected.

    rho_b = m_O p_B (1 - m_O+) / (m_O+ + p_B (1 - m_O+)); the rest has persisted.
    """
    born = np.float32(birth_probability) * (1 - predicted)
    return np.asarray(occupied * born / (predicted + born), np.float32)

"""Dempster-Shafer masses of cells: measurement, prediction, combination, and newborn mass.

Equations of Nuss et al., "A random finite set approach for dynamic occupancy grid maps with real-time application"
(IJRR 2018, arXiv 1605.02406), section V. Masses are (M, M) float32; the remaining mass 1 - m_O - m_F is unknown.
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


def measured_masses(visible: Mask, occupied: Mask, occupied_mass: float, free_mass: float) -> Masses:
    """Masses of a frame: `occupied_mass` in cells with a return, `free_mass` in cells that beams only crossed."""
    hit = np.where(occupied, np.float32(occupied_mass), np.float32(0.0))
    return Masses(hit, np.where(visible & ~occupied, np.float32(free_mass), np.float32(0.0)))


def predicted_free(free: Mass, keep: float, occupied: Mass) -> Mass:
    """Predicted free mass: the share `keep` of `free`, bounded by 1 less the predicted `occupied` mass."""
    return np.asarray(np.minimum(free * np.float32(keep), 1 - occupied))


def combined(prior: Masses, evidence: Masses) -> Masses:
    """Dempster's rule of combination; the conflict must be below 1."""
    unknown, ignorance = 1 - prior.occupied - prior.free, 1 - evidence.occupied - evidence.free
    conflict = prior.occupied * evidence.free + prior.free * evidence.occupied
    occupied = prior.occupied * (evidence.occupied + ignorance) + unknown * evidence.occupied
    free = prior.free * (evidence.free + ignorance) + unknown * evidence.free
    return Masses(occupied / (1 - conflict), free / (1 - conflict))


def newborn_mass(occupied: Mass, predicted: Mass, birth_probability: float) -> Mass:
    """Newborn part of the updated mass `occupied`, given the `predicted` occupied mass; the rest is persistent.

    rho_b = m_O p_B (1 - m_O+) / (m_O+ + p_B (1 - m_O+))
    """
    born = np.float32(birth_probability) * (1 - predicted)
    return np.asarray(occupied * born / (predicted + born), np.float32)

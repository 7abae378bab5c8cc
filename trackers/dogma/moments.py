"""The velocity of each cell: mean and covariance over the particles that have persisted, and whether it is at rest."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import Mask
from gridtrack.trackers.dogma.filter import ParticleGrid

FEWEST = 3
"""Particles that a cell must hold for their moments to say something."""
LIKELY = 0.5
"""Occupied mass that a cell must hold to be called dynamic."""
STILL_MPS = 0.1
"""Standard deviation that every velocity has beside its particles': what drifts slower than this stands."""
CHI_SQUARE = 5.99
"""Squared Mahalanobis distance of rest from a cell's velocity at which it moves: 95 %, two degrees of freedom."""


class Velocities(NamedTuple):
    """`mean` (2, M, M) float32, m/s, x and y; `covariance` (3, M, M) of xx, xy, yy; 0 where nothing has persisted."""

    mean: NDArray[np.float32]
    covariance: NDArray[np.float32]


def velocities(state: ParticleGrid) -> Velocities:
    """First two moments of the velocity of each cell."""
    size, to_mps = state.grid.size, state.grid.cell_m / state.period_s
    moments = np.zeros((5, size * size), np.float32)
    fill(state.particles, state.persisted, FEWEST, moments)
    mean, covariance = moments[:2].reshape(2, size, size), moments[2:].reshape(3, size, size)
    return Velocities(mean * np.float32(to_mps), covariance * np.float32(to_mps**2))


def dynamic_cells(state: ParticleGrid, found: Velocities) -> Mask:
    """The cells (M, M) that are occupied by what moves: rest lies outside the 95 % ellipse of their velocity."""
    (vx, vy), (xx, xy, yy) = found.mean, found.covariance
    xx, yy = xx + STILL_MPS**2, yy + STILL_MPS**2
    squared = (vx * vx * yy - 2.0 * vx * vy * xy + vy * vy * xx) / (xx * yy - xy * xy)
    moving: Mask = (squared > CHI_SQUARE) & (state.masses.occupied >= LIKELY)
    return moving


@numba.njit(cache=True, nogil=True, error_model="numpy")
def fill(particles, persisted, fewest, moments):  # type: ignore[no-untyped-def]
    """Into `moments` (5, M * M) mean x, mean y, xx, xy, yy of the velocities of each cell with `fewest` or more."""
    for cell in range(persisted.shape[0]):
        first, last = persisted[cell]
        count = np.float32(last - first)
        if last - first < fewest:
            continue
        x = y = np.float32(0.0)
        for i in range(first, last):
            x += particles.vx[i]
            y += particles.vy[i]
        x, y = x / count, y / count
        xx = xy = yy = np.float32(0.0)
        for i in range(first, last):
            dx, dy = particles.vx[i] - x, particles.vy[i] - y
            xx += dx * dx
            xy += dx * dy
            yy += dy * dy
        moments[0, cell], moments[1, cell] = x, y
        moments[2, cell], moments[3, cell], moments[4, cell] = xx / count, xy / count, yy / count

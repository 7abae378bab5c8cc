"""The velocity of each cell: mean and covariance of its persistent particles, and a test for motion."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import Mask
from gridtrack.trackers.dogma.filter import ParticleGrid

MIN_PARTICLES = 3
"""Smallest number of particles of a cell with moments."""
MIN_OCCUPIED_MASS = 0.5
"""Smallest occupied mass of a dynamic cell."""
VELOCITY_NOISE_MPS = 0.1
"""Standard deviation added to that of the particles: slower drift is not motion."""
MOTION_TEST = 5.99
"""Squared Mahalanobis distance of zero velocity from which a cell is dynamic: 95 %, two degrees of freedom."""


class Velocities(NamedTuple):
    """`mean` (2, M, M) float32, m/s, x and y; `covariance` (3, M, M), xx, xy, yy; 0 where they are not `known` (M, M).

    A cell with too few persistent particles has none.
    """

    mean: NDArray[np.float32]
    covariance: NDArray[np.float32]
    known: Mask


def velocities(state: ParticleGrid) -> Velocities:
    """Mean and covariance of the velocity of each cell."""
    size, to_mps = state.grid.size, state.grid.cell_m / state.period_s
    moments = np.zeros((5, size * size), np.float32)
    compute_moments(state.particles, state.persisted, MIN_PARTICLES, moments)
    mean, covariance = moments[:2].reshape(2, size, size), moments[2:].reshape(3, size, size)
    known = (state.persisted[:, 1] - state.persisted[:, 0] >= MIN_PARTICLES).reshape(size, size)
    return Velocities(mean * np.float32(to_mps), covariance * np.float32(to_mps**2), known)


def dynamic_cells(state: ParticleGrid, found: Velocities) -> Mask:
    """The dynamic cells (M, M): occupied, and zero velocity is outside the 95 % ellipse of their velocity."""
    (vx, vy), (xx, xy, yy) = found.mean, found.covariance
    xx, yy = xx + VELOCITY_NOISE_MPS**2, yy + VELOCITY_NOISE_MPS**2
    squared = (vx * vx * yy - 2.0 * vx * vy * xy + vy * vy * xx) / (xx * yy - xy * xy)
    moving: Mask = (squared > MOTION_TEST) & (state.masses.occupied >= MIN_OCCUPIED_MASS)
    return moving


@numba.njit(cache=True, nogil=True, error_model="numpy")
def compute_moments(particles, persisted, min_particles, moments):  # type: ignore[no-untyped-def]
    """Write mean x, mean y, xx, xy, yy of the velocities of cells with `min_particles` to `moments` (5, M * M)."""
    for cell in range(persisted.shape[0]):
        first, last = persisted[cell]
        count = np.float32(last - first)
        if last - first < min_particles:
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

"""The forecast: predicted particles; free and unknown mass approach the occupancy rate of the cell."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from gridtrack.trackers.dogma.filter import MAX_PREDICTED_MASS, ParticleGrid
from gridtrack.trackers.dogma.masses import Mass, predicted_free
from gridtrack.trackers.dogma.particles import predict_particle
from gridtrack.trackers.dogma.random_numbers import next_counter, random_stream


def forecast(state: ParticleGrid, occupancy_rate: Mass, steps: int) -> NDArray[np.float32]:
    """P(occupied) (steps+1, M, M) float32 at steps 0..steps; visible cells of step 0 are as observed.

    `occupancy_rate` (M, M) is P(occupied | visible), counted at the site. A cell's unknown mass counts as occupied with
    that probability; free mass decays to unknown mass; occupied mass moves with the particles. `state` does not change:
    the noise is drawn from a random random_stream of the forecast.
    """
    counts = np.zeros((steps + 1, *state.grid.shape), np.float32)
    count_particles(state.particles, state.count, state.motion(1.0), random_stream(~state.seed, state.draws), counts)
    occupancy = np.empty_like(counts)
    for step in range(steps + 1):
        weight = np.float32(state.weight * state.survival(step))
        occupied = np.minimum(counts[step] * weight, MAX_PREDICTED_MASS)
        free = predicted_free(state.masses.free, state.free_retention(step), occupied)
        occupancy[step] = occupied + (1 - occupied - free) * occupancy_rate
    if state.frame is not None:
        occupancy[0] = np.where(state.frame.visible, state.frame.occupied, occupancy[0])
    return occupancy


@numba.njit(cache=True, nogil=True, error_model="numpy")
def count_particles(particles, count, motion, counter, counts):  # type: ignore[no-untyped-def]
    """Add the number of the first `count` particles in each cell at each step to `counts` (n+1, M, M) float32.

    Particles that leave the grid are removed.
    """
    size = counts.shape[1]
    for i in range(count):
        x, y, vx, vy = particles.x[i], particles.y[i], particles.vx[i], particles.vy[i]
        for step in range(counts.shape[0]):
            if not (0.0 <= x < size and 0.0 <= y < size):
                break
            counts[step, np.uint32(y), np.uint32(x)] += np.float32(1.0)
            counter = next_counter(counter)
            x, y, vx, vy = predict_particle(x, y, vx, vy, motion, counter)

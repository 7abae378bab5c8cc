"""The forecast: predicted particles and their velocities; free and unknown mass approach the rate of the cell."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from gridtrack.trackers.dogma.filter import MAX_PREDICTED_MASS, ParticleGrid
from gridtrack.trackers.dogma.masses import Mass, predicted_free
from gridtrack.trackers.dogma.particles import predict_particle
from gridtrack.trackers.dogma.random_numbers import next_counter, random_stream

MIN_PARTICLES = 3
"""Fewest persistent particles of a cell with a velocity."""


def forecast(state: ParticleGrid, occupancy_rate: Mass, steps: int) -> NDArray[np.float32]:
    """P(occupied) (steps+1, M, M) float32 at steps 0..steps; visible cells of step 0 are as observed.

    `occupancy_rate` (M, M) is P(occupied | visible), counted at the site. Unknown mass counts as occupied with this
    probability, free mass decays to unknown mass, and occupied mass moves with the particles. `state` does not change:
    the forecast has its own random stream.
    """
    no_sums = np.zeros((0, *state.grid.shape, 3), np.float32)
    return _occupancy(state, occupancy_rate, _counts(state, steps, no_sums))


def forecast_with_flow(
    state: ParticleGrid, occupancy_rate: Mass, steps: int
) -> tuple[NDArray[np.float32], NDArray[np.float16]]:
    """`forecast`, and the mean velocity (steps+1, 2, M, M), m/s, of the persistent particles in each cell.

    NaN in cells with fewer than MIN_PARTICLES persistent particles.
    """
    sums = np.zeros((steps + 1, *state.grid.shape, 3), np.float32)
    occupancy = _occupancy(state, occupancy_rate, _counts(state, steps, sums))
    flow = np.full((steps + 1, 2, *state.grid.shape), np.nan, np.float32)
    mean_velocities(sums, MIN_PARTICLES, np.float32(state.grid.cell_m / state.period_s), flow)
    flow[0] = flow_now(state)
    return occupancy, flow.astype(np.float16)


def flow_now(state: ParticleGrid) -> NDArray[np.float32]:
    """The mean velocity (2, M, M), m/s, of each cell at step 0; NaN in cells with too few persistent particles."""
    size, to_mps = state.grid.size, np.float32(state.grid.cell_m / state.period_s)
    mean = np.full((2, size * size), np.nan, np.float32)
    mean_velocities_now(state.particles, state.persisted, MIN_PARTICLES, to_mps, mean)
    return mean.reshape(2, size, size)


def _counts(state: ParticleGrid, steps: int, sums: NDArray[np.float32]) -> NDArray[np.float32]:
    """The number of particles (steps+1, M, M) in each cell; `sums` as in `count_particles`."""
    counts = np.zeros((steps + 1, *state.grid.shape), np.float32)
    counter = random_stream(~state.seed, state.draws)
    count_particles(state.particles, state.count, state.persisted, state.motion(1.0), counter, counts, sums)
    return counts


def _occupancy(state: ParticleGrid, occupancy_rate: Mass, counts: NDArray[np.float32]) -> NDArray[np.float32]:
    occupancy = np.empty_like(counts)
    for step in range(len(counts)):
        weight = np.float32(state.weight * state.survival(step))
        occupied = np.minimum(counts[step] * weight, MAX_PREDICTED_MASS)
        free = predicted_free(state.masses.free, state.free_retention(step), occupied)
        occupancy[step] = occupied + (1 - occupied - free) * occupancy_rate
    if state.frame is not None:
        occupancy[0] = np.where(state.frame.visible, state.frame.occupied, occupancy[0])
    return occupancy


@numba.njit(cache=True, nogil=True, error_model="numpy")
def count_particles(particles, count, persisted, motion, counter, counts, sums):  # type: ignore[no-untyped-def]
    """Add the number of the first `count` particles in each cell at each step to `counts` (n+1, M, M) float32.

    Also add vx, vy and 1 of each persistent particle at the first S steps to `sums` (S, M, M, 3) float32. Particles
    that leave the grid are removed.
    """
    size = counts.shape[1]
    persistent = np.zeros(count, np.bool_)
    if sums.shape[0]:
        for cell in range(persisted.shape[0]):
            persistent[persisted[cell, 0] : persisted[cell, 1]] = True
    for i in range(count):
        x, y, vx, vy = particles.x[i], particles.y[i], particles.vx[i], particles.vy[i]
        summed = sums.shape[0] if persistent[i] else 0
        for step in range(counts.shape[0]):
            if not (0.0 <= x < size and 0.0 <= y < size):
                break
            row, column = np.uint32(y), np.uint32(x)
            counts[step, row, column] += np.float32(1.0)
            if step < summed:
                sums[step, row, column, 0] += vx
                sums[step, row, column, 1] += vy
                sums[step, row, column, 2] += np.float32(1.0)
            counter = next_counter(counter)
            x, y, vx, vy = predict_particle(x, y, vx, vy, motion, counter)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def mean_velocities(sums, min_particles, to_mps, mean):  # type: ignore[no-untyped-def]
    """Write the means of the `sums` of `count_particles` to `mean` (S, 2, M, M) if there are `min_particles`."""
    for step in range(sums.shape[0]):
        for row in range(sums.shape[1]):
            for column in range(sums.shape[2]):
                if sums[step, row, column, 2] >= min_particles:
                    scale = to_mps / sums[step, row, column, 2]
                    mean[step, 0, row, column] = sums[step, row, column, 0] * scale
                    mean[step, 1, row, column] = sums[step, row, column, 1] * scale


@numba.njit(cache=True, nogil=True, error_model="numpy")
def mean_velocities_now(particles, persisted, min_particles, to_mps, mean):  # type: ignore[no-untyped-def]
    """Write the mean velocity of the persistent particles of each cell to `mean` (2, M * M), if it has enough."""
    for cell in range(persisted.shape[0]):
        first, last = persisted[cell]
        if last - first < min_particles:
            continue
        x = y = np.float32(0.0)
        for i in range(first, last):
            x += particles.vx[i]
            y += particles.vy[i]
        count = np.float32(last - first)
        mean[0, cell], mean[1, cell] = x / count * to_mps, y / count * to_mps

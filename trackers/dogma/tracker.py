"""The `dogma` tracker: the particle grid behind the plugin contract, and its training."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numba
import numpy as np
from numpy.typing import NDArray

from gridtrack.common.config import Settings
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.trackers.contract import FitTask, Forecast, FrameSource, StreamSpec
from gridtrack.trackers.dogma.filter import MAX_PREDICTED_MASS, DogmaSettings, Mass, ParticleGrid, predicted_free
from gridtrack.trackers.dogma.particles import next_counter, predict_particle, random_stream
from gridtrack.trackers.site_map import NO_MAP, SiteMap, count_anywhere, count_frames, mean_of_cells, posterior_rate
from gridtrack.trackers.training.calibration import CalibratedTracker
from gridtrack.trackers.training.searched_fit import SettingsSearch, fit_searched
from gridtrack.trackers.training.weights import cell_probabilities

PARTICLE_DIVISOR = 4
"""Divisor of the number of particles during the search, for speed; the calibration and the result use all."""
DOGMA_RANGES = {
    "occupied_mass": (0.8, 0.98),
    "free_mass": (0.7, 0.98),
    "birth_probability": (1e-4, 0.1),
    "free_decay_s": (0.5, 20.0),
    "birth_speed": (0.5, 15.0),
    "acceleration": (0.05, 3.0),
    "position_noise_m": (0.002, 0.1),
    "start_stop_speed": (0.1, 3.0),
    "time_to_start_s": (2.0, 200.0),
    "time_to_stop_s": (0.3, 30.0),
}
"""Ranges of the tuned settings, searched log-uniformly."""
DOGMA_OF_PLACE = frozenset({"free_decay_s"})
"""The setting that weighs the map of the place against the stream: unknown mass counts with the rate of the map."""


class DogmaTracker(CalibratedTracker):
    """Dempster-Shafer masses of the cells, with particles that carry the occupied mass and have velocities."""

    Options: ClassVar[type[Settings]] = DogmaSettings

    def __init__(self, stream: StreamSpec, options: DogmaSettings) -> None:
        """Raises WeightsError without weights for the stream's site, grid and period."""
        super().__init__(stream, options)
        self._occupancy_rate = cell_probabilities(self._weights, "occupancy_rate", stream.grid)
        compile_filter(stream.period_s)
        self.reset(seed=0)

    def reset(self, seed: int) -> None:
        """Start with unknown masses and no particles; the random numbers follow from `seed`."""
        rate, grid = self._occupancy_rate, self.stream.grid
        self._state = ParticleGrid(grid, self.stream.period_s, self._settings, seed)
        self._site = SiteMap(rate, mean_of_cells(rate), grid.cell_m, self._world_T_map)
        self._rate_in_window = rate

    def update(self, frame: GridFrame) -> None:
        """Update the state with frame x_t."""
        self._state.update(frame)
        self._rate_in_window = self._site.at(frame.world_T_grid)

    @property
    def hidden_s(self) -> NDArray[np.float32]:
        """Time since each cell (M, M) was last seen, seconds; infinite if never."""
        return self._state.hidden.seconds

    def predict(self, steps: int) -> Forecast:
        """Forecast steps 0..steps, and the mean velocity of each cell with enough persistent particles.

        Velocities are for every step if they are scored, else only for step 0, which takes less time.
        """
        velocity: NDArray[np.floating]
        if self.stream.velocity_scored:
            occupancy, velocity = forecast_with_flow(self._state, self._rate_in_window, steps)
        else:
            occupancy, velocity = forecast(self._state, self._rate_in_window, steps), flow_now(self._state)
        self._calibration.apply(occupancy, self.hidden_s)
        return Forecast(occupancy, velocity=velocity)

    @classmethod
    def starts_from_general(cls, options: DogmaSettings) -> bool:
        """The search starts from the settings of the general weights."""
        return True

    @classmethod
    def fit(cls, task: FitTask) -> None:
        """Count the occupancy rate and search the settings on `task.train`.

        Raises WeightsError if the recordings differ in grid, period or site.
        """
        if task.general:
            visible, occupied = count_anywhere(task.train, lambda frame: (frame.visible, frame.occupied))
            rate = posterior_rate(occupied, visible)
        else:
            rate, moves = count_occupancy_rate(task.train)
            if moves:
                task.report(NO_MAP)
        search = SettingsSearch(cls, DogmaSettings, DOGMA_RANGES, DOGMA_OF_PLACE, with_fewer_particles)
        fit_searched(search, {"occupancy_rate": rate}, task, task.options.model_dump(exclude_unset=True), {})


def compile_filter(period_s: float) -> None:
    """Compile the kernels of all stages, by running them on a scene of two frames.

    Compilation takes seconds on a machine without a cache; a tracker spends them at its start, not in an update.
    """
    grid = GridSpec(4, 0.2)
    state = ParticleGrid(grid, period_s, DogmaSettings(particles=100), seed=0)
    occupied, visible = np.eye(4, dtype=bool), np.ones(grid.shape, bool)
    points, sensor = grid.cell_centres(occupied), np.zeros((1, 2), np.float32)
    for frame in range(2):
        stamp_ns = round(frame * period_s * 1e9)
        state.update(GridFrame(stamp_ns, visible, occupied, SE2(), sensor, points, np.zeros(len(points), np.uint8)))
    forecast_with_flow(state, np.zeros(grid.shape, np.float32), steps=1)


def with_fewer_particles(settings: DogmaSettings) -> DogmaSettings:
    """The settings of a search, which runs faster with fewer particles."""
    return settings.model_copy(update={"particles": max(100, settings.particles // PARTICLE_DIVISOR)})


def count_occupancy_rate(train: Sequence[FrameSource]) -> tuple[Mass, bool]:
    """P(occupied | visible) of each cell (M, M) float32, and whether a sensor moves (`count_frames`).

    The posterior mean over all frames of `train`.
    """
    (visible, occupied), moves = count_frames(
        train, train[0].grid.cell_m, lambda frame: (frame.visible, frame.occupied)
    )
    return posterior_rate(occupied, visible), moves


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

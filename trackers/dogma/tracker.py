"""The `dogma` tracker: the particle grid behind the plugin contract, and its training."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.config import Settings
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.trackers.contract import FitTask, Forecast, FrameSource, StreamSpec
from gridtrack.trackers.dogma.filter import ParticleGrid
from gridtrack.trackers.dogma.forecast import flow_now, forecast, forecast_with_flow
from gridtrack.trackers.dogma.masses import Mass
from gridtrack.trackers.dogma.settings import DogmaSettings
from gridtrack.trackers.registry import registered_name
from gridtrack.trackers.site_map import NO_MAP, SiteMap, count_anywhere, count_frames, mean_of_cells, posterior_rate
from gridtrack.trackers.training.calibration import CalibratedTracker, Calibration
from gridtrack.trackers.training.searched_fit import SettingsSearch, fit_searched
from gridtrack.trackers.training.weights import array, cell_probabilities, load_weights, tuned_settings

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
    learns: ClassVar[bool] = True
    learns_general: ClassVar[bool] = True
    moving_sensor: ClassVar[bool] = True

    def __init__(self, stream: StreamSpec, options: DogmaSettings) -> None:
        """Raises WeightsError without weights for the stream's site, grid and period."""
        super().__init__(stream, options)
        weights = load_weights(stream, registered_name(type(self)))
        self._settings = tuned_settings(DogmaSettings, weights, options)
        self._occupancy_rate = cell_probabilities(weights, "occupancy_rate", stream.grid)
        self._world_T_map = weights.card.map_pose
        self._calibration = Calibration(array(weights, "calibration", (2, 3)))
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

"""The `dogma` tracker: the particle grid behind the plugin contract."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.config import Settings
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.trackers.calibration import CalibratedTracker, Calibration
from gridtrack.trackers.contract import FitTask, Forecast, StreamSpec
from gridtrack.trackers.dogma.filter import ParticleGrid
from gridtrack.trackers.dogma.forecast import flow_now, forecast, forecast_with_flow
from gridtrack.trackers.dogma.settings import DogmaSettings
from gridtrack.trackers.registry import registered_name
from gridtrack.trackers.site_map import SiteMap, mean_of_cells
from gridtrack.trackers.weights import array, cell_probabilities, load_weights, tuned_settings


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
        """Forecast steps 0..steps, and the mean velocity of each cell that has enough persistent particles.

        Velocities are of every step where they are scored, else of step 0 alone, which takes less time.
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
        """Its settings are those of general weights."""
        return True

    @classmethod
    def fit(cls, task: FitTask) -> None:
        """Count the occupancy rate and tune the settings on `task.train`."""
        from gridtrack.trackers.dogma.tuning import fit_dogma

        fit_dogma(cls, task)


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

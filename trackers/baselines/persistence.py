"""The tracker `persistence`: every cell keeps its last observed state."""

from __future__ import annotations

from typing import Any

import numpy as np

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, rolled, shift_between
from gridtrack.trackers.contract import Forecast, StreamSpec, Tracker


class PersistenceTracker(Tracker):
    """Forecasts the last observed state of each cell; 0 where a cell was never visible since it came into the window.

    Where the window moves, each cell keeps its place in the world.
    """

    moving_sensor = True
    role = "floor"
    reference_for = frozenset({"occupancy"})

    def __init__(self, stream: StreamSpec, options: Any) -> None:
        super().__init__(stream, options)
        self.reset(seed=0)

    def reset(self, seed: int) -> None:
        """No cell has been observed."""
        self.last_observed = np.zeros(self.stream.grid.shape, np.float32)
        self._world_T_grid: SE2 | None = None

    def update(self, frame: GridFrame) -> None:
        """Store the state of the visible cells."""
        shift = shift_between(self._world_T_grid or frame.world_T_grid, frame.world_T_grid, self.stream.grid.cell_m)
        if shift:
            self.last_observed = rolled(self.last_observed, shift, 0.0)
        self._world_T_grid = frame.world_T_grid
        np.copyto(self.last_observed, frame.occupied, where=frame.visible)

    def predict(self, steps: int) -> Forecast:
        """The last observed state (steps+1, M, M), the same for every step."""
        return Forecast(np.tile(self.last_observed, (steps + 1, 1, 1)))

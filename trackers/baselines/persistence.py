"""The tracker `persistence`: every cell keeps its last observed state."""

from __future__ import annotations

from typing import Any

import numpy as np

from gridtrack.common.grid import GridFrame
from gridtrack.trackers.contract import Forecast, StreamSpec, Tracker


class PersistenceTracker(Tracker):
    """Forecasts the last observed state of each cell; 0 where a cell was never visible."""

    role = "floor"
    reference_for = frozenset({"occupancy"})

    def __init__(self, stream: StreamSpec, options: Any) -> None:
        super().__init__(stream, options)
        self.last_observed = np.zeros(stream.grid.shape, np.float32)

    def reset(self, seed: int) -> None:
        """No cell has been observed."""
        self.last_observed[:] = 0.0

    def update(self, frame: GridFrame) -> None:
        """Store the state of the visible cells."""
        np.copyto(self.last_observed, frame.occupied, where=frame.visible)

    def predict(self, steps: int) -> Forecast:
        """The last observed state (steps+1, M, M), the same for every step."""
        return Forecast(np.tile(self.last_observed, (steps + 1, 1, 1)))

"""Persistence: the world stays as it was last seen."""

from __future__ import annotations

from typing import Any

import numpy as np

from gridtrack.common.grid import GridFrame
from gridtrack.trackers.contract import Forecast, StreamSpec, Tracker


class PersistenceTracker(Tracker):
    """Forecasts each cell as it was last visible, and 0 where it never was."""

    role = "floor"
    reference_for = frozenset({"occupancy"})

    def __init__(self, stream: StreamSpec, options: Any) -> None:
        super().__init__(stream, options)
        self.last_seen = np.zeros(stream.grid.shape, np.float32)

    def reset(self, seed: int) -> None:
        """No cell has been seen."""
        self.last_seen[:] = 0.0

    def update(self, frame: GridFrame) -> None:
        """Visible cells are as they are now."""
        np.copyto(self.last_seen, frame.occupied, where=frame.visible)

    def predict(self, steps: int) -> Forecast:
        """The last seen state (steps+1, M, M), the same for every step."""
        return Forecast(np.tile(self.last_seen, (steps + 1, 1, 1)))

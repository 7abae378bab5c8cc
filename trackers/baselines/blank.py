"""The tracker `blank`: every cell is free."""

from __future__ import annotations

import numpy as np

from gridtrack.common.grid import GridFrame
from gridtrack.trackers.contract import Forecast, Tracker


class BlankTracker(Tracker):
    """Forecasts P(occupied) = 0 for every cell and step."""

    moving_sensor = True
    role = "floor"

    def reset(self, seed: int) -> None:
        """The tracker has no state."""

    def update(self, frame: GridFrame) -> None:
        """The tracker has no state."""

    def predict(self, steps: int) -> Forecast:
        """Zero (steps+1, M, M)."""
        return Forecast(np.zeros((steps + 1, *self.stream.grid.shape), np.float32))

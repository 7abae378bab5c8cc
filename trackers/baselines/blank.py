"""Blank: nothing anywhere."""

from __future__ import annotations

import numpy as np

from gridtrack.common.grid import GridFrame
from gridtrack.trackers.contract import Forecast, Tracker


class BlankTracker(Tracker):
    """Forecasts no occupied cell, whatever it sees."""

    role = "floor"

    def reset(self, seed: int) -> None:
        """Nothing to forget."""

    def update(self, frame: GridFrame) -> None:
        """Nothing to learn."""

    def predict(self, steps: int) -> Forecast:
        """Zero (steps+1, M, M)."""
        return Forecast(np.zeros((steps + 1, *self.stream.grid.shape), np.float32))

"""A fading memory: each cell as it was last seen, trusted less the longer ago and the further ahead."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from gridtrack.common.config import Settings
from gridtrack.common.grid import GridFrame
from gridtrack.trackers.contract import Forecast, StreamSpec, Tracker


class FadingOptions(Settings):
    """Options of the fading memory: `--tracker fading:half_life_s=2`."""

    half_life_s: float = Field(1.0, gt=0.0)
    """After this time a cell is trusted half."""
    background: float = Field(0.02, ge=0.0, le=1.0)
    """P(occupied) of a cell that nothing is known of."""


class FadingTracker(Tracker):
    """Forecasts each cell as it was last visible, and lets it fade towards the background with time."""

    Options = FadingOptions

    def __init__(self, stream: StreamSpec, options: FadingOptions) -> None:
        super().__init__(stream, options)
        self.trust_per_frame = 0.5 ** (stream.period_s / options.half_life_s)
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Nothing has been seen: nothing differs from the background."""
        self.excess = np.zeros(self.stream.grid.shape)
        """By how much P(occupied) (M, M) exceeds the background, now."""

    def update(self, frame: GridFrame) -> None:
        """What is visible is known; the rest fades."""
        self.excess *= self.trust_per_frame
        np.copyto(self.excess, frame.occupied - self.options.background, where=frame.visible)

    def predict(self, steps: int) -> Forecast:
        """P(occupied) (steps+1, M, M); it reads the state and leaves it alone."""
        trust = self.trust_per_frame ** np.arange(steps + 1)
        occupancy = self.options.background + trust[:, None, None] * self.excess
        return Forecast(occupancy.astype(np.float32))

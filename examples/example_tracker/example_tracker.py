"""A fading memory: each cell as last visible, with a weight that decays with its age and with the step."""

from __future__ import annotations

import numpy as np

from gridtrack import ConfigurationError, Forecast, GridFrame, Settings, StreamSpec, Tracker

BACKGROUND = 0.02
"""P(occupied) of a cell that was never visible."""


class FadingOptions(Settings):
    """Options of the fading memory: `--tracker fading:half_life_s=2`."""

    half_life_s: float = 1.0
    """Time in which the weight of a cell halves."""


class FadingTracker(Tracker):
    """Forecasts each cell as last visible, nearer to the background with time."""

    Options = FadingOptions

    def __init__(self, stream: StreamSpec, options: FadingOptions) -> None:
        super().__init__(stream, options)
        if options.half_life_s <= 0:
            raise ConfigurationError(f"half_life_s = {options.half_life_s:g}: expected more than 0 s")
        self.half_life_s = options.half_life_s
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Set every cell to the background."""
        self.excess = np.zeros(self.stream.grid.shape)  # P(occupied) (M, M) less the background, at `stamp_ns`
        self.stamp_ns: int | None = None

    def update(self, frame: GridFrame) -> None:
        """Update the visible cells; the others fade by the time since the last frame, which is longer over a gap."""
        since_s = 0.0 if self.stamp_ns is None else (frame.stamp_ns - self.stamp_ns) / 1e9
        self.stamp_ns = frame.stamp_ns
        self.excess *= 0.5 ** (since_s / self.half_life_s)
        np.copyto(self.excess, frame.occupied - BACKGROUND, where=frame.visible)

    def predict(self, steps: int) -> Forecast:
        """P(occupied) (steps+1, M, M); the state is not changed."""
        weight = 0.5 ** (self.stream.period_s / self.half_life_s * np.arange(steps + 1))
        occupancy = BACKGROUND + weight[:, None, None] * self.excess
        return Forecast(occupancy.astype(np.float32))

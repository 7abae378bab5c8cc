"""A tracker that knows how the bodies of `scenes/truth_scene.py` move."""

from typing import Literal

import numpy as np

from gridtrack.common.config import Settings
from gridtrack.trackers.contract import Forecast, TrackedObject, Tracker


class Options(Settings):
    scale: float = 1.0
    """Its velocities are the true ones times this."""
    gives: Literal["all", "cyclist", "now", "late", "nothing", "object"] = "all"
    """Which velocities: all, those near the cyclist, step 0 alone, or none in its first two forecasts; or an object."""


def to_and_fro(time_s, period_s, reach_m):
    share = time_s / period_s % 1.0
    return reach_m * (4 * share - 1 if share < 0.5 else 3 - 4 * share)


class Mover(Tracker):
    """The last frame, with the true velocities along x: of the cyclist for y below 2.5 m, of the pedestrian above."""

    Options = Options

    def reset(self, seed):
        self.forecasts = 0

    def update(self, frame):
        self.last = frame

    def predict(self, steps):
        self.forecasts += 1
        shown = np.repeat(self.last.occupied[None].astype(np.float32), steps + 1, axis=0)
        if self.options.gives == "object":
            box = np.array([1.0, self.last.stamp_ns * 1e-9 % 4, 0.0, 1.0, 1.0], np.float32)
            still = np.zeros(2, np.float32), np.eye(4, dtype=np.float32)
            return Forecast(shown, objects=(TrackedObject(1, box, *still),))
        return Forecast(shown, velocity=self.flow(steps))

    def flow(self, steps):
        grid, gives = self.stream.grid, self.options.gives
        if gives == "nothing" or (gives == "late" and self.forecasts <= 2):
            return None
        y = grid.origin[1] + grid.cell_m * (np.arange(grid.size) + 0.5)
        velocity = np.full((steps + 1, 2, *grid.shape), np.nan, np.float32)
        for step in range(steps + 1):
            time_s = (self.last.stamp_ns - 1_000_000_000_000) * 1e-9 + step / 10
            for rows, period_s, reach_m in ((y < 2.5, 5.0, 2.8), (y >= 2.5, 8.0, 3.4)):
                if gives == "cyclist" and period_s != 5.0:
                    continue
                moved_m = to_and_fro(time_s, period_s, reach_m) - to_and_fro(time_s - 0.1, period_s, reach_m)
                velocity[step, 0, rows] = self.options.scale * moved_m / 0.1
                velocity[step, 1, rows] = 0.0
        return velocity[0] if gives == "now" else velocity


class GuesserOptions(Settings):
    gives: Literal["alike", "mixed", "sometimes"] = "alike"


class Guesser(Tracker):
    """Its futures are the last frame, all alike, or half of them empty (`mixed`); or given every second time."""

    Options = GuesserOptions

    def reset(self, seed):
        self.forecasts = 0

    def update(self, frame):
        self.last = frame.occupied

    def predict(self, steps):
        self.forecasts += 1
        futures = np.repeat(np.repeat(self.last[None, None], steps + 1, axis=1), 4, axis=0)
        if self.options.gives == "mixed":
            futures[:2] = False
        if self.options.gives == "sometimes" and self.forecasts % 2 == 0:
            futures = None
        return Forecast(np.repeat(self.last[None].astype(np.float32), steps + 1, axis=0), futures=futures)

"""Trackers with classes: one that derives the class from the place, and one with classes that a recording lacks."""

import numpy as np

from gridtrack.trackers.contract import Forecast, Tracker


class Classifier(Tracker):
    """Forecasts the last frame; near cells are a cyclist, a band behind them a pedestrian, all others static."""

    classes = ("static", "pedestrian", "cyclist")

    def reset(self, seed):
        self.last = np.zeros(self.stream.grid.shape, np.float32)

    def update(self, frame):
        self.last = frame.occupied.astype(np.float32)

    def predict(self, steps):
        y = self.stream.grid.origin[1] + self.stream.grid.cell_m * (np.arange(self.stream.grid.size) + 0.5)
        band = np.where(y < 2.5, 2, np.where((y > 4.0) & (y < 6.0), 1, 0))
        p = np.full((3, *self.last.shape), 0.1, np.float32)
        for k in range(3):
            p[k, band == k] = 0.8
        return Forecast(np.repeat(self.last[None], steps + 1, axis=0), np.repeat(p[None], steps + 1, axis=0))


class Stranger(Classifier):
    """Has the class pedestrian, and two classes that the recording lacks."""

    classes = ("horse", "pedestrian", "walls")

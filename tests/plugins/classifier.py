"""Trackers that say what things are: one that knows by where they are, and one that has never heard of some of them."""

import numpy as np

from gridtrack.trackers.contract import Forecast, Tracker


class Classifier(Tracker):
    """Forecasts the last frame; calls what is near a cyclist, a band behind it pedestrian, and the rest static."""

    classes = ("static", "pedestrian", "cyclist")

    def reset(self, seed):
        self.last = np.zeros(self.stream.grid.shape, np.float32)

    def update(self, frame):
        self.last = frame.occupied.astype(np.float32)

    def predict(self, steps):
        x = self.stream.grid.origin[0] + self.stream.grid.cell_m * (np.arange(self.stream.grid.size) + 0.5)
        band = np.where(x < 2.5, 2, np.where((x > 4.0) & (x < 6.0), 1, 0))
        p = np.full((3, *self.last.shape), 0.1, np.float32)
        for k in range(3):
            p[k, :, band == k] = 0.8
        return Forecast(np.repeat(self.last[None], steps + 1, axis=0), np.repeat(p[None], steps + 1, axis=0))


class Stranger(Classifier):
    """Knows pedestrians, and tells them from horses."""

    classes = ("horse", "pedestrian", "walls")

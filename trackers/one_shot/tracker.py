"""The tracker `one-shot`: the observed frame as the forecast of every step, with the classes of its cells."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import torch

from gridtrack.common.config import Settings
from gridtrack.common.grid import GridFrame
from gridtrack.trackers.contract import ComparedPart, FitTask, Forecast, StreamSpec, Tracker
from gridtrack.trackers.one_shot.settings import OneShotSettings
from gridtrack.trackers.registry import registered_name
from gridtrack.trackers.scan_classifier import planes_of, scan_classifier
from gridtrack.trackers.trained_network import restore, trained_settings
from gridtrack.trackers.weights import load_weights


class OneShotTracker(Tracker):
    """The observed frame, with classes from this scan alone (Ondruska et al., 2016).

    Without memory: the reference of classes from a latent state. All steps are equal; only step 0 is estimated.
    """

    Options: ClassVar[type[Settings]] = OneShotSettings
    moving_sensor: ClassVar[bool] = True
    learns: ClassVar[bool] = True
    learns_general: ClassVar[bool] = True
    reference_for: ClassVar[frozenset[ComparedPart]] = frozenset({"classes"})

    def __init__(self, stream: StreamSpec, options: OneShotSettings) -> None:
        """Raises WeightsError without weights for the stream's site, grid and period."""
        super().__init__(stream, options)
        weights = load_weights(stream, registered_name(type(self)))
        self.classes = weights.card.classes
        settings = trained_settings(stream, weights, options)
        general = weights.card.general
        self._cell_m = stream.grid.cell_m if general else None
        self._network = scan_classifier(settings.channels, len(self.classes), general=general).eval()
        restore(self._network, stream, weights)
        self.reset(seed=0)

    def reset(self, seed: int) -> None:
        """Set the planes to zero; nothing is random, so the seed is not used."""
        self._planes = torch.zeros((2 if self._cell_m is None else 3, *self.stream.grid.shape))

    def update(self, frame: GridFrame) -> None:
        """Store x_t in place of the frame before it."""
        self._planes = planes_of(frame, self._cell_m).float()

    def predict(self, steps: int) -> Forecast:
        """The occupied plane and the class probabilities of x_t, the same for every step."""
        with torch.inference_mode():
            semantics = torch.softmax(self._network(self._planes[None]), dim=1).numpy()
        occupancy = self._planes[1:2].numpy()
        return Forecast(np.repeat(occupancy, steps + 1, axis=0), np.repeat(semantics, steps + 1, axis=0))

    @classmethod
    def fit(cls, task: FitTask) -> None:
        """Train on labelled scans; settings that the options do not set are chosen on `task.validation`."""
        from gridtrack.trackers.one_shot.training import fit_classifier

        fit_classifier(registered_name(cls), task)

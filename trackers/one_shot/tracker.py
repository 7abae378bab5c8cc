"""The `one-shot` tracker: what is visible now, and the class of each cell as one scan shows it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
import torch

from gridtrack.common.config import Settings
from gridtrack.common.grid import GridFrame
from gridtrack.trackers.cell_classifier import CellClassifier
from gridtrack.trackers.contract import ComparedPart, FitOutput, Forecast, FrameSource, Score, StreamSpec, Tracker
from gridtrack.trackers.one_shot.settings import ONE_SHOT, OneShotSettings
from gridtrack.trackers.restoring import restore, trained_settings
from gridtrack.trackers.weights import load_weights

PLANES = 2
"""Visible and occupied."""


class OneShotTracker(Tracker):
    """What is visible now, and its classes from one scan alone (Ondruska et al., 2016).

    Without memory: what classes from a latent state are compared with. Only step 0 is a claim; later steps repeat it.
    """

    Options: ClassVar[type[Settings]] = OneShotSettings
    learns: ClassVar[bool] = True
    reference_for: ClassVar[frozenset[ComparedPart]] = frozenset({"classes"})

    def __init__(self, stream: StreamSpec, options: OneShotSettings) -> None:
        """Raises WeightsError without weights for the stream's site, grid and period."""
        super().__init__(stream, options)
        weights = load_weights(stream, ONE_SHOT)
        self.classes = weights.card.classes
        settings = trained_settings(stream, weights, options)
        self._network = CellClassifier(PLANES, settings.hidden, len(self.classes)).eval()
        restore(self._network, stream, weights)
        self.reset(seed=0)

    def reset(self, seed: int) -> None:
        """Nothing has been seen; nothing here is random."""
        self._planes = torch.zeros((2, *self.stream.grid.shape))

    def update(self, frame: GridFrame) -> None:
        """Take in x_t, and forget what was before."""
        self._planes = planes_of(frame).float()

    def predict(self, steps: int) -> Forecast:
        """What is seen occupied now, and the classes of one scan, the same for every step."""
        with torch.inference_mode():
            semantics = torch.softmax(self._network(self._planes[None]), dim=1).numpy()
        occupancy = self._planes[1:].numpy()
        return Forecast(np.repeat(occupancy, steps + 1, axis=0), np.repeat(semantics, steps + 1, axis=0))

    @classmethod
    def fit(
        cls,
        train: Sequence[FrameSource],
        validation: Sequence[FrameSource],
        score: Score,
        out: FitOutput,
        options: Any,
    ) -> None:
        """Learn the classes of a few labelled scans; what `options` leave open is chosen on `validation`."""
        from gridtrack.trackers.one_shot.training import fit_classifier

        fit_classifier(train, validation, out, options)


def planes_of(frame: GridFrame) -> torch.Tensor:
    """Visible and occupied as one array (2, M, M) uint8."""
    return torch.from_numpy(np.stack([frame.visible, frame.occupied]).astype(np.uint8))

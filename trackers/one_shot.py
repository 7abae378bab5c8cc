"""The tracker `one-shot`: the observed frame as the forecast of every step, with classes from this scan alone."""

from __future__ import annotations

from itertools import islice
from typing import Any, ClassVar

import numpy as np
import torch

from gridtrack.common.config import Settings
from gridtrack.common.grid import GridFrame
from gridtrack.trackers.contract import ComparedPart, FitTask, Forecast, StreamSpec, Tracker
from gridtrack.trackers.registry import registered_name
from gridtrack.trackers.training.card import card_for
from gridtrack.trackers.training.cell_classifier import CellClassifier, planes_of, scan_classifier
from gridtrack.trackers.training.cell_training import best_classifier, scan_cells
from gridtrack.trackers.training.device import DeviceSettings, device_name, inference_device
from gridtrack.trackers.training.labelled_scans import VALIDATE_ON, ClassifierSettings, LabelSettings, draw_labelled
from gridtrack.trackers.training.networks import restore_network, trained_settings
from gridtrack.trackers.training.weights import load_weights, save_interrupted, save_weights


class OneShotSettings(LabelSettings, ClassifierSettings, DeviceSettings):
    """The width of the classifier, its training and its labelled scans, and the device of inference."""


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
        """Raises WeightsError without weights for the stream's site, grid and period, ConfigurationError without the
        device."""
        super().__init__(stream, options)
        self._device = inference_device(options.device)
        weights = load_weights(stream, registered_name(type(self)))
        self.classes = weights.card.classes
        settings = trained_settings(stream, weights, options, running=DeviceSettings)
        general = weights.card.general
        self._cell_m = stream.grid.cell_m if general else None
        self._network = scan_classifier(settings.channels, len(self.classes), general=general).eval()
        restore_network(self._network, stream, weights)
        self._network.to(self._device)
        self.reset(seed=0)

    @property
    def device(self) -> str:
        """The name of the device of the classifier."""
        return device_name(self._device)

    def reset(self, seed: int) -> None:
        """Set the planes to zero; nothing is random, so the seed is not used."""
        self._planes = torch.zeros((2 if self._cell_m is None else 3, *self.stream.grid.shape))

    def update(self, frame: GridFrame) -> None:
        """Store x_t in place of the frame before it."""
        self._planes = planes_of(frame, self._cell_m).float()

    def predict(self, steps: int) -> Forecast:
        """The occupied plane and the class probabilities of x_t, the same for every step."""
        with torch.inference_mode():
            logits = self._network(self._planes[None].to(self._device))
            semantics = torch.softmax(logits, dim=1).cpu().numpy()
        occupancy = self._planes[1:2].numpy()
        return Forecast(np.repeat(occupancy, steps + 1, axis=0), np.repeat(semantics, steps + 1, axis=0))

    @classmethod
    def fit(cls, task: FitTask) -> None:
        """Train on labelled scans; settings that the options do not set are chosen on `task.validation`.

        Raises ConfigurationError without labels, WeightsError if the stretches differ in grid, period or site.
        """
        options: OneShotSettings = task.options
        labelled = draw_labelled(task.train, options, task.seed)
        classes = labelled.classes
        task.report(f"classes {', '.join(classes)} from {labelled.name}")
        training_cells = scan_cells(labelled.scans(), classes, general=task.general)
        validation_cells = scan_cells(
            [(s, islice(s.labelled(), 0, None, VALIDATE_ON)) for s in task.validation], classes, general=task.general
        )

        def build(settings: ClassifierSettings) -> CellClassifier:
            return scan_classifier(settings.channels, len(classes), general=task.general)

        given = options.model_dump(include=set(ClassifierSettings.model_fields), exclude_unset=True)
        best = best_classifier(build, given, training_cells, [validation_cells], task)
        count = torch.bincount(training_cells.targets, minlength=len(classes)).tolist()
        results: dict[str, Any] = {
            "labelled": labelled.name,
            "cells": dict(zip(classes, count, strict=True)),
            "best_after_updates": best.update,
            "temperature": best.temperature,
            "validation_log_loss": round(best.log_loss, 5),
        }
        settings = options.model_dump(mode="json", exclude=set(DeviceSettings.model_fields)) | best.settings.model_dump(
            mode="json"
        )
        settings["labelled_scans"] = labelled.count
        card = card_for(registered_name(cls), task, settings, results)
        arrays = {name: value.numpy() for name, value in best.classifier.state_dict().items()}
        card = card.model_copy(update={"classes": classes})
        if best.reached:
            save_interrupted(task.out, card, arrays, best.reached)
            raise KeyboardInterrupt
        save_weights(task.out, card, arrays)

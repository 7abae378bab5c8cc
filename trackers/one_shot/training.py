"""Training of the one-shot classifier on the planes of scans around their labelled cells."""

from __future__ import annotations

from itertools import islice
from typing import Any

import torch

from gridtrack.trackers.card import card_for
from gridtrack.trackers.cell_classifier import CellClassifier
from gridtrack.trackers.cell_training import best_classifier
from gridtrack.trackers.contract import FitTask
from gridtrack.trackers.label_settings import ClassifierSettings
from gridtrack.trackers.labelled_scans import VALIDATE_ON, draw_labelled
from gridtrack.trackers.one_shot.settings import OneShotSettings
from gridtrack.trackers.scan_classifier import scan_cells, scan_classifier
from gridtrack.trackers.weights import save_interrupted, save_weights


def fit_classifier(name: str, task: FitTask) -> None:
    """Train classifiers with several settings and write the best on `task.validation` to `task.out`.

    Settings in `task.options` are fixed. `name`: the registered name. Raises ConfigurationError without labels,
    WeightsError if the stretches differ in grid, period or site.
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
    settings = options.model_dump(mode="json") | best.settings.model_dump(mode="json")
    settings["labelled_scans"] = labelled.count
    card = card_for(name, task, settings, results)
    arrays = {name: value.numpy() for name, value in best.classifier.state_dict().items()}
    card = card.model_copy(update={"classes": classes})
    if best.reached:
        save_interrupted(task.out, card, arrays, best.reached)
        raise KeyboardInterrupt
    save_weights(task.out, card, arrays)

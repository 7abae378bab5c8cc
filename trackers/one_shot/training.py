"""Training of the one-shot classifier on the planes of scans around their labelled cells."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice
from typing import Any

import torch

from gridtrack.trackers.card import card_for
from gridtrack.trackers.cell_classifier import CellClassifier
from gridtrack.trackers.cell_training import best_classifier
from gridtrack.trackers.contract import FitOutput, FrameSource
from gridtrack.trackers.label_settings import ClassifierSettings
from gridtrack.trackers.labelled_scans import VALIDATE_ON, draw_labelled
from gridtrack.trackers.one_shot.settings import ONE_SHOT, OneShotSettings
from gridtrack.trackers.scan_classifier import scan_cells, scan_classifier
from gridtrack.trackers.weights import save_interrupted, save_weights


def fit_classifier(
    train: Sequence[FrameSource], validation: Sequence[FrameSource], out: FitOutput, options: OneShotSettings
) -> None:
    """Train classifiers with several settings and write the best on `validation` to `out.path`.

    Settings in `options` are fixed. Raises ConfigurationError without labels, WeightsError where the stretches differ
    in grid, period or site.
    """
    labelled = draw_labelled(train, options, out.seed)
    classes = labelled.classes
    out.report(f"classes {', '.join(classes)} from {labelled.name}")
    training_cells = scan_cells(labelled.scans(), classes, general=out.general)
    validation_cells = scan_cells(
        [(s, islice(s.labelled(), 0, None, VALIDATE_ON)) for s in validation], classes, general=out.general
    )

    def build(settings: ClassifierSettings) -> CellClassifier:
        return scan_classifier(settings.channels, len(classes), general=out.general)

    given = options.model_dump(include=set(ClassifierSettings.model_fields), exclude_unset=True)
    best = best_classifier(build, given, training_cells, [validation_cells], out)
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
    card = card_for(ONE_SHOT, out, train, validation, settings, results)
    arrays = {name: value.numpy() for name, value in best.classifier.state_dict().items()}
    card = card.model_copy(update={"classes": classes})
    if best.reached:
        save_interrupted(out.path, card, arrays, best.reached)
        raise KeyboardInterrupt
    save_weights(out.path, card, arrays)

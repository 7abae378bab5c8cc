"""Inductive transfer, stage 2 of Ondruska et al. (2016): a class decoder on the latent state of a trained network.

The network's weights are not changed. The decoder is a classifier of cells whose planes are the channels of the latent
state, of the current frame and of forecast frames. It is trained and tuned like the one-shot classifier.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import torch
from torch import Tensor

from gridtrack.common.config import validated
from gridtrack.common.errors import WeightsError
from gridtrack.common.grid import LabelledFrame
from gridtrack.trackers.cell_classifier import CellClassifier
from gridtrack.trackers.cell_training import CellCollector, LabelledCells, TrainedClassifier, best_classifier
from gridtrack.trackers.contract import FitOutput, FrameSource, stream_of
from gridtrack.trackers.label_settings import ClassifierSettings
from gridtrack.trackers.labelled_stretch import VALIDATE_ON, LabelledStretch, draw_labelled, learned_classes
from gridtrack.trackers.recurrent.network import LatentState
from gridtrack.trackers.recurrent.recurrent_tracker import RecurrentTracker
from gridtrack.trackers.recurrent.settings import TransferSettings
from gridtrack.trackers.weights import load_weights, save_interrupted, save_weights, with_classes

FORECAST_STEPS = 20
"""Number of steps of the forecasts that classes are learned from: c_t .. c_{t+20}."""
FORECAST_EVERY = 20
"""Frames from one forecast in the training data to the next: neighbouring forecasts are nearly equal."""
DECODER = "decode_semantics."


def fit_class_decoder(
    kind: type[RecurrentTracker],
    train: Sequence[FrameSource],
    validation: Sequence[FrameSource],
    out: FitOutput,
    options: Any,
) -> None:
    """Train a class decoder for the weights at `out.path` and add it to them; the other arrays stay equal bit by bit.

    Raises WeightsError where there are no weights or `options` contradict them, ConfigurationError without labels.
    """
    tracker = _tracker_with_weights(kind, train[0], out, options)
    labelled = draw_labelled(train, options.labelled_scans, out.seed)
    names = labelled.source.classes
    classes = learned_classes(names, (item.labels for item in labelled.frames))
    out.report(f"classes {', '.join(classes)} from {labelled.name}")

    training_cells = latent_cells(tracker, [(names, labelled.frames)], classes, every=1)
    validation_cells = latent_cells(
        tracker, ((s.classes, list(s.labelled())) for s in validation), classes, every=VALIDATE_ON
    )

    def build(settings: ClassifierSettings) -> CellClassifier:
        chosen = options.model_copy(update={"class_channels": settings.channels})
        return CellClassifier(tracker.network.channels, chosen.class_hidden, len(classes))

    given = {"channels": options.class_channels} if "class_channels" in options.model_fields_set else {}
    best = best_classifier(build, given, training_cells, validation_cells, out)
    weights = load_weights(tracker.stream, kind.name)
    settings = {
        "labelled_scans": options.labelled_scans,
        "class_layers": options.class_layers,
        "class_channels": best.settings.channels,
    }
    results = _card_results(labelled, classes, training_cells, best, out)
    card = with_classes(weights.card, classes, train, validation, settings, results)
    network = {name: array for name, array in weights.arrays.items() if not name.startswith(DECODER)}
    decoder = {DECODER + name: value.numpy() for name, value in best.classifier.state_dict().items()}
    if best.reached:
        save_interrupted(out.path, card, network | decoder, best.reached)
        raise KeyboardInterrupt
    save_weights(out.path, card, network | decoder)


def _tracker_with_weights(
    kind: type[RecurrentTracker], source: FrameSource, out: FitOutput, options: Any
) -> RecurrentTracker:
    """The tracker with the occupancy weights at `out.path`. Raises WeightsError."""
    if not out.path.exists():
        raise WeightsError(
            f"{out.path}: no weights to add classes to: train with stage=both, or copy weights to this path"
        )
    shape = options.model_dump(exclude_unset=True, exclude=set(TransferSettings.model_fields))
    return kind(stream_of(source, out.path), validated(kind.Options, shape, kind.name))


@torch.no_grad()
def latent_cells(
    tracker: RecurrentTracker,
    labelled: Iterable[tuple[Sequence[str], Sequence[LabelledFrame]]],
    classes: Sequence[str],
    every: int,
) -> LabelledCells:
    """The latent states of every `every`-th frame, and of the forecast of every FORECAST_EVERY-th of these frames.

    `labelled`: pairs of class names and frames, whose labels index the names. States are stored in half precision.
    """
    collector = CellCollector(classes)
    for names, frames in labelled:
        tracker.reset(0)
        for t, current in enumerate(frames):
            tracker.update(current.frame)
            if t % every:
                continue
            steps = 0 if t % (every * FORECAST_EVERY) else FORECAST_STEPS
            forecast = _forecast_features(tracker.network, tracker.state)
            for features, target in zip(forecast, frames[t : t + 1 + steps], strict=False):
                if target.cells.size:
                    collector.add(features[0].half(), target, names)
    return collector.cells()


def _forecast_features(network: Any, state: LatentState) -> Iterator[Tensor]:
    """The input of the decoders (1, C, M, M), now and after each step with empty input, without end."""
    while True:
        yield network.features(state)
        state = network.step(None, state)


def _card_results(
    stretch: LabelledStretch,
    classes: Sequence[str],
    training_cells: LabelledCells,
    best: TrainedClassifier,
    out: FitOutput,
) -> dict[str, Any]:
    """The card's results of this stage, with its command: the network may have been trained by another one."""
    count = torch.bincount(training_cells.targets, minlength=len(classes)).tolist()
    return {
        "command": out.command,
        "seed": out.seed,
        "labelled": stretch.name,
        "cells": dict(zip(classes, count, strict=True)),
        "learning_rate": best.settings.learning_rate,
        "weight_decay": best.settings.weight_decay,
        "best_after_updates": best.update,
        "temperature": best.temperature,
        "validation_log_loss": round(best.log_loss, 5),
    }

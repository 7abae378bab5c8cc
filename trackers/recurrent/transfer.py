"""Inductive transfer, stage 2 of Ondruska et al. (2016): a class decoder on the latent state of a trained network.

The network stays as it is, so the decoder is a classifier of cells whose planes are the channels of its state: what it
sees now, and what it forecasts from empty input for frames to come. It is trained and tuned as the one-shot classifier
is, whose planes are what one scan shows.
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
from gridtrack.trackers.cell_training import CellCollector, LabelledCells, Trained, best_classifier
from gridtrack.trackers.contract import FitOutput, FrameSource, stream_of
from gridtrack.trackers.label_settings import ClassifierSettings
from gridtrack.trackers.labelled_stretch import VALIDATE_ON, LabelledStretch, draw_labelled, learned_classes
from gridtrack.trackers.recurrent.network import LatentState
from gridtrack.trackers.recurrent.recurrent_tracker import RecurrentTracker
from gridtrack.trackers.recurrent.settings import TransferSettings
from gridtrack.trackers.weights import load_weights, save_weights, with_classes

FORECAST_STEPS = 20
"""How far ahead classes are learned: c_t .. c_{t+20}."""
FORECAST_EVERY = 20
"""Frames from one forecast that is learned from to the next: neighbouring ones say nearly the same."""
DECODER = "decode_semantics."


def fit_class_decoder(
    kind: type[RecurrentTracker],
    train: Sequence[FrameSource],
    validation: Sequence[FrameSource],
    out: FitOutput,
    options: Any,
) -> None:
    """Learn a class decoder for the weights at `out.path` and put it beside them; they stay as they are, bit for bit.

    Raises WeightsError where there are none or they are others than `options` say, ConfigurationError without labels.
    """
    tracker = _trained(kind, train[0], out, options)
    stretch = draw_labelled(train, options.labelled_scans, out.seed)
    names = stretch.source.classes
    classes = learned_classes(names, (item.labels for item in stretch.frames))
    out.report(f"classes {', '.join(classes)} from {stretch.name}")

    learned = latent_cells(tracker, [(names, stretch.frames)], classes, every=1)
    held_out = latent_cells(tracker, ((s.classes, list(s.labelled())) for s in validation), classes, every=VALIDATE_ON)

    def build(settings: ClassifierSettings) -> CellClassifier:
        chosen = options.model_copy(update={"class_channels": settings.channels})
        return CellClassifier(tracker.network.channels, chosen.class_hidden, len(classes))

    given = {"channels": options.class_channels} if "class_channels" in options.model_fields_set else {}
    best = best_classifier(build, given, learned, held_out, out.seed, out.report)
    weights = load_weights(tracker.stream, kind.name)
    settings = {
        "labelled_scans": options.labelled_scans,
        "class_layers": options.class_layers,
        "class_channels": best.settings.channels,
    }
    results = _results(stretch, classes, learned, best, out)
    card = with_classes(weights.card, classes, train, validation, settings, results)
    network = {name: array for name, array in weights.arrays.items() if not name.startswith(DECODER)}
    decoder = {DECODER + name: value.numpy() for name, value in best.classifier.state_dict().items()}
    save_weights(out.path, card, network | decoder)


def _trained(kind: type[RecurrentTracker], source: FrameSource, out: FitOutput, options: Any) -> RecurrentTracker:
    """The tracker of the occupancy weights, as it runs on a stream. Raises WeightsError."""
    if not out.path.exists():
        raise WeightsError(f"{out.path}: no weights to add classes to: train with stage=both, or put them there")
    shape = options.model_dump(exclude_unset=True, exclude=set(TransferSettings.model_fields))
    return kind(stream_of(source, out.path), validated(kind.Options, shape, kind.name))


@torch.no_grad()
def latent_cells(
    tracker: RecurrentTracker,
    labelled: Iterable[tuple[Sequence[str], Sequence[LabelledFrame]]],
    classes: Sequence[str],
    every: int,
) -> LabelledCells:
    """The state at one in `every` frames, and of those in one forecast in FORECAST_EVERY that of the frames to come.

    Labels index the names that come with the frames. The state is kept in half precision.
    """
    collector = CellCollector(classes)
    for names, frames in labelled:
        tracker.reset(0)
        for t, now in enumerate(frames):
            tracker.update(now.frame)
            if t % every:
                continue
            to_come = frames[t : t + 1 + (0 if t % (every * FORECAST_EVERY) else FORECAST_STEPS)]
            for features, then in zip(_forecast(tracker.network, tracker.state), to_come, strict=False):
                if then.cells.size:
                    collector.add(features[0].half(), then, names)
    return collector.cells()


def _forecast(network: Any, state: LatentState) -> Iterator[Tensor]:
    """What the decoders read (1, C, M, M), now and after each step with empty input, without end."""
    while True:
        yield network.features(state)
        state = network.step(None, state)


def _results(
    stretch: LabelledStretch, classes: Sequence[str], learned: LabelledCells, best: Trained, out: FitOutput
) -> dict[str, Any]:
    """What the card says of this stage; its command is not the network's where that was trained before."""
    count = torch.bincount(learned.targets, minlength=len(classes)).tolist()
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

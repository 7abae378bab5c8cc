"""Inductive transfer, stage 2 of Ondruska et al. (2016): a class decoder on the latent state of a trained network.

The network's weights are not changed. The decoder is a classifier of cells that reads the channels of the latent state,
of the current frame and of forecast frames: an object that is hidden now has its label when it comes into view. It is
tuned like the one-shot classifier. A classifier of single scans is trained on the same labelled scans (seen_cells.py).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import torch

from gridtrack.common.config import validated
from gridtrack.common.errors import WeightsError
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, LabelledFrame, shift_between
from gridtrack.trackers.contract import FitTask, FrameSource, StreamSpec, stream_of
from gridtrack.trackers.recurrent.network import DecodedLayers, State
from gridtrack.trackers.recurrent.pacing import PacedNetwork
from gridtrack.trackers.recurrent.recurrent_tracker import RecurrentTracker
from gridtrack.trackers.recurrent.seen_cells import PREFIX, SeenCells
from gridtrack.trackers.recurrent.settings import DECODER_SETTINGS, TransferSettings
from gridtrack.trackers.registry import registered_name
from gridtrack.trackers.training.card import with_classes
from gridtrack.trackers.training.cell_classifier import CellClassifier, planes_of, scan_classifier
from gridtrack.trackers.training.cell_training import (
    CellCollector,
    LabelledCells,
    TrainedClassifier,
    best_classifier,
    calibrated,
    logits_of,
    train_classifier,
)
from gridtrack.trackers.training.labelled_scans import (
    VALIDATE_ON,
    ClassifierSettings,
    LabelledScans,
    LabelSettings,
    draw_labelled,
)
from gridtrack.trackers.training.weights import load_weights, save_interrupted, save_weights

LEADS = (4, 12)
"""Steps of the forecasts that classes are learned from, besides the current frame; at most LEAD_IN less a warm-up."""
DECODER = "decode_semantics."
SCAN_SETTINGS = ClassifierSettings(class_weights="none")
"""Settings of the classifier of scans, which are not searched."""


@dataclass(frozen=True, slots=True)
class TransferCells:
    """Labelled cells with the latent state of their frame, with forecast states, and with the planes of their scan."""

    now: CellCollector
    ahead: CellCollector
    scan: CellCollector


def fit_class_decoder(kind: type[RecurrentTracker], task: FitTask) -> None:
    """Train a class decoder for the weights at `task.out` and add it to them; the other arrays stay equal bit by bit.

    Raises WeightsError if there are no weights or the options contradict them, ConfigurationError without labels.
    """
    options = task.options
    tracker_for = _with_weights(kind, task)
    labelled = draw_labelled(task.train, options, task.seed)
    task.report(f"classes {', '.join(labelled.classes)} from {labelled.name}")
    follow = partial(
        latent_cells, tracker_for, classes=labelled.classes, layers=options.decoded_layers, general=task.general
    )
    training = follow(labelled.runs())
    task.report("followed the labelled scans")
    held_out = follow(((source, source.labelled()) for source in task.validation), every=VALIDATE_ON)
    training_cells = training.now.cells(training.ahead)
    best = fit_decoder(options, training_cells, held_out, task)
    weights = load_weights(tracker_for(task.train[0]).stream, registered_name(kind))
    settings = {
        **options.model_dump(include={*LabelSettings.model_fields, "class_layers", "decoded_layers"}),
        **{name: getattr(best.settings, own) for own, name in DECODER_SETTINGS.items()},
        "labelled_scans": labelled.count,
    }
    results = _card_results(labelled, training_cells, best, task)
    card = with_classes(weights.card, labelled.classes, task, settings, results)
    network = {name: array for name, array in weights.arrays.items() if not name.startswith((DECODER, PREFIX))}
    decoder = {DECODER + name: value.numpy() for name, value in best.classifier.state_dict().items()}
    if best.reached:
        save_interrupted(task.out, card, network | decoder, best.reached)
        raise KeyboardInterrupt
    seen, log_loss = fit_seen_cells(best, training, held_out, len(labelled.classes), task)
    card.results["classes"]["seen_cells_log_loss"] = log_loss
    added = {PREFIX + name: value.numpy() for name, value in seen.state_dict().items()}
    save_weights(task.out, card, network | decoder | added)


def _with_weights(kind: type[RecurrentTracker], task: FitTask) -> Callable[[FrameSource], RecurrentTracker]:
    """The tracker with the occupancy weights at `task.out`, for grid and period of a source. Raises WeightsError."""
    if not task.out.exists():
        raise WeightsError(
            f"{task.out}: no weights to add classes to: train with stage=both, or copy weights to this path"
        )
    shape = task.options.model_dump(exclude_unset=True, exclude={*TransferSettings.model_fields, "precision", "device"})

    @lru_cache(maxsize=1)
    def made(stream: StreamSpec) -> RecurrentTracker:
        return kind(stream, validated(kind.Options, shape, registered_name(kind)))

    return lambda source: made(stream_of(source, task.out))


@torch.no_grad()
def latent_cells(
    tracker_for: Callable[[FrameSource], RecurrentTracker],
    labelled: Iterable[tuple[FrameSource, Iterable[LabelledFrame]]],
    classes: Sequence[str],
    layers: DecodedLayers,
    every: int = 1,
    *,
    general: bool = False,
) -> TransferCells:
    """The latent states of every `every`-th frame with labels, and its forecasts from LEADS frames before.

    `labelled`: pairs of a source and its frames. `layers` of the state that are decoded. States are stored in half
    precision. For `general` weights the planes of scans contain the cell size.
    """
    now, ahead, scan = CellCollector(classes), CellCollector(classes), CellCollector(classes)
    for source, frames in labelled:
        tracker, names = tracker_for(source), source.classes
        tracker.reset(0)
        past = PastStates(tracker)
        for number, item in enumerate(frames):
            past.update(item.frame)
            if number % every or not item.cells.size:
                continue
            scan.add(planes_of(item.frame, source.grid.cell_m if general else None), item, names)
            now.add(tracker.network.class_planes(tracker.state, layers)[0].half(), item, names)
            for lead in LEADS:
                if (state := past.before(lead)) is not None:
                    forecast = _forecast(tracker.network, state, lead)
                    ahead.add(tracker.network.class_planes(forecast, layers)[0].half(), item, names)
    return TransferCells(now, ahead, scan)


class PastStates:
    """The latent states of a tracker after its last frames, all in the window of the last one."""

    def __init__(self, tracker: RecurrentTracker) -> None:
        self._tracker, self._updates = tracker, 0
        self._states: deque[State] = deque(maxlen=LEADS[-1] + 1)
        self._world_T_grid: SE2 | None = None

    def update(self, frame: GridFrame) -> None:
        """Update the tracker and add its state."""
        self._move_to(frame.world_T_grid)
        self._tracker.update(frame)
        self._states.append(self._tracker.state)
        self._updates += 1

    def before(self, frames: int) -> State | None:
        """The state `frames` frames before the last one; None if there is none."""
        return self._states[-1 - frames] if frames < len(self._states) else None

    def _move_to(self, world_T_grid: SE2) -> None:
        cell_m, first = self._tracker.stream.grid.cell_m, self._updates - len(self._states) + 1
        shift = shift_between(self._world_T_grid or world_T_grid, world_T_grid, cell_m)
        self._world_T_grid = world_T_grid
        if shift:
            for k, state in enumerate(self._states):
                self._states[k] = self._tracker.network.rolled(state, shift, first + k)


def _forecast(network: PacedNetwork, state: State, steps: int) -> State:
    for _ in range(steps):
        state = network.step(None, state)
    return state


def fit_decoder(options: Any, training: LabelledCells, held_out: TransferCells, task: FitTask) -> TrainedClassifier:
    """The best decoder for cells of the current frame and of forecasts alike, calibrated for forecasts."""
    planes, classes = training.planes.shape[-1], held_out.now.classes

    def build(settings: ClassifierSettings) -> CellClassifier:
        chosen = options.model_copy(update={"class_channels": settings.channels})
        return CellClassifier(planes, chosen.class_hidden, len(classes))

    ahead = held_out.ahead.cells()
    best = best_classifier(build, options.given_of_decoder, training, [held_out.now.cells(), ahead], task)
    return calibrated(best, [ahead])


def fit_seen_cells(
    decoder: TrainedClassifier, training: TransferCells, held_out: TransferCells, classes: int, task: FitTask
) -> tuple[SeenCells, dict[str, float]]:
    """A classifier of scans and the powers, and the log loss of the classes by kind of evidence."""
    torch.manual_seed(task.seed)
    cells = held_out.scan.cells()
    classifier = scan_classifier(SCAN_SETTINGS.channels, classes, general=task.general)
    trained = train_classifier(classifier, SCAN_SETTINGS, training.scan.cells(), [cells])
    seen = SeenCells(trained.classifier)
    found = seen.fit_powers(logits_of(decoder.classifier, held_out.now.cells()), cells)
    task.report(
        f"cells seen now: validation log loss {found['state']:.4f} nats a cell, with the scan {found['scan']:.4f}"
    )
    return seen, {evidence: round(value, 5) for evidence, value in found.items()}


def _card_results(
    labelled: LabelledScans, training_cells: LabelledCells, best: TrainedClassifier, task: FitTask
) -> dict[str, Any]:
    """The card's results of this stage, with its own command: another one may have trained the network."""
    count = torch.bincount(training_cells.targets, minlength=len(labelled.classes)).tolist()
    return {
        "command": task.command,
        "seed": task.seed,
        "labelled": labelled.name,
        "cells": dict(zip(labelled.classes, count, strict=True)),
        "best_after_updates": best.update,
        "temperature": round(best.temperature, 3),
        "validation_log_loss_ahead": round(best.log_loss, 5),
    }

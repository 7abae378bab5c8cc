"""Training the one-shot classifier: a seeded search of its few settings, each tried until validation stops gaining."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from gridtrack.common.grid import LabelledFrame
from gridtrack.trackers.contract import FitOutput, FrameSource
from gridtrack.trackers.labelled import class_indices, draw_labelled, inverse_frequency, learned_classes
from gridtrack.trackers.one_shot.network import OneShotNetwork, patches_around
from gridtrack.trackers.one_shot.settings import NAME, OneShotSettings
from gridtrack.trackers.one_shot.tracker import planes_of
from gridtrack.trackers.weights import card_for, save_weights

TRIALS = 10
CHANNELS = (8, 16, 32)
LEARNING_RATES = (1e-3, 2e-2)
WEIGHT_DECAYS = (1e-4, 1.0)
"""What is searched: the channels uniformly among these, the others log-uniformly from their range."""
VALIDATIONS = 10
"""Times in a trial that the classifier is tried on the validation stretch."""
VALIDATE_ON = 5
"""Every fifth validation scan: neighbouring ones say nearly the same."""


@dataclass(frozen=True, slots=True)
class Cells:
    """Patches (N, 2, 15, 15) uint8 of scans around the cells whose class is known, and their classes (N,) int64."""

    patches: Tensor
    targets: Tensor


@dataclass(frozen=True, slots=True)
class Classifier:
    """A trained classifier where it was best: after `update` updates, at `log_loss` nats a cell of validation."""

    settings: OneShotSettings
    state: dict[str, Tensor]
    update: int
    log_loss: float


def fit_classifier(
    train: Sequence[FrameSource], validation: Sequence[FrameSource], out: FitOutput, options: OneShotSettings
) -> None:
    """Write to `out.path` the classifier that is best on `validation`, out of TRIALS settings.

    A setting given in `options` stays as given. Raises ConfigurationError without labels, WeightsError where the
    stretches differ in grid, period or site.
    """
    stretch = draw_labelled(train, options.labelled_scans, out.seed)
    names = stretch.source.classes
    classes = learned_classes(names, (item.labels for item in stretch.frames))
    out.report(f"classes {', '.join(classes)} from {stretch.name}")
    learned = cells_of([(names, stretch.frames)], classes)
    held_out = cells_of([(s.classes, islice(s.labelled(), 0, None, VALIDATE_ON)) for s in validation], classes)

    best = None
    for settings in trials(options, out.seed):
        tried = train_classifier(settings, learned, held_out, len(classes), out.seed)
        best = tried if best is None or tried.log_loss < best.log_loss else best
        out.report(
            f"{NAME}: channels {settings.channels}, learning rate {settings.learning_rate:g}, weight decay"
            f" {settings.weight_decay:g}: validation log loss {tried.log_loss:.4f} nats a cell"
        )
    assert best is not None
    count = torch.bincount(learned.targets, minlength=len(classes)).tolist()
    results: dict[str, Any] = {
        "labelled": stretch.name,
        "cells": dict(zip(classes, count, strict=True)),
        "best_after_updates": best.update,
        "validation_log_loss": round(best.log_loss, 5),
    }
    card = card_for(NAME, out, train, validation, best.settings.model_dump(mode="json"), results)
    arrays = {name: value.numpy() for name, value in best.state.items()}
    save_weights(out.path, card.model_copy(update={"classes": classes}), arrays)


def cells_of(labelled: Iterable[tuple[Sequence[str], Iterable[LabelledFrame]]], classes: Sequence[str]) -> Cells:
    """The cells of frames whose class is one of `classes`; labels index the names that come with the frames."""
    patches, targets = [], []
    for names, frames in labelled:
        for item in frames:
            target = class_indices(item.labels, names, classes)
            patches.append(patches_around(planes_of(item.frame), item.cells[target >= 0]))
            targets.append(torch.from_numpy(target[target >= 0]))
    return Cells(torch.cat(patches), torch.cat(targets))


def trials(options: OneShotSettings, seed: int) -> Iterator[OneShotSettings]:
    """The defaults, and then draws of what `options` do not give; the same seed, the same trials."""
    draw = np.random.default_rng(seed)
    given = options.model_dump(exclude_unset=True)
    yield options
    for _ in range(TRIALS - 1 if {"channels", "learning_rate", "weight_decay"} - given.keys() else 0):
        drawn = {
            "channels": int(draw.choice(CHANNELS)),
            "learning_rate": _log_uniform(draw, *LEARNING_RATES),
            "weight_decay": _log_uniform(draw, *WEIGHT_DECAYS),
        }
        yield OneShotSettings(**(drawn | given))


def _log_uniform(draw: np.random.Generator, low: float, high: float) -> float:
    """Three significant digits: a card is read by people, and the search must try what the card will say."""
    return float(f"{math.exp(draw.uniform(math.log(low), math.log(high))):.3g}")


def train_classifier(settings: OneShotSettings, learned: Cells, held_out: Cells, classes: int, seed: int) -> Classifier:
    """AdamW on batches of `learned`, classes weighted by inverse frequency; the state that is best for `held_out`."""
    torch.manual_seed(seed)
    network = OneShotNetwork(settings.channels, classes)
    class_weights = torch.from_numpy(inverse_frequency(learned.targets.numpy(), classes))
    optimizer = torch.optim.AdamW(network.parameters(), settings.learning_rate, weight_decay=settings.weight_decay)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, settings.updates)
    every = -(-settings.updates // VALIDATIONS)
    best = None
    for update in range(1, settings.updates + 1):
        batch = torch.randint(len(learned.targets), (settings.batch,))
        logits = network.of_patches(learned.patches[batch].float())
        loss = functional.cross_entropy(logits, learned.targets[batch], class_weights)
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimizer.step()
        schedule.step()
        if update % every == 0 or update == settings.updates:
            log_loss = _log_loss(network, held_out)
            if best is None or log_loss < best.log_loss:
                state = {name: value.clone() for name, value in network.state_dict().items()}
                best = Classifier(settings, state, update, log_loss)
    assert best is not None
    return best


@torch.no_grad()
def _log_loss(network: OneShotNetwork, held_out: Cells) -> float:
    total, at_once = 0.0, 4096
    for start in range(0, len(held_out.targets), at_once):
        logits = network.of_patches(held_out.patches[start : start + at_once].float())
        total += float(functional.cross_entropy(logits, held_out.targets[start : start + at_once], reduction="sum"))
    return total / len(held_out.targets)

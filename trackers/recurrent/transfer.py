"""Inductive transfer, stage 2 of Ondruska et al. (2016): a class decoder on the latent state of a trained network.

The network stays as it is; so the decoder, a 3x3 convolution with a softmax, is multinomial logistic regression on the
3x3 patches of its state around the cells whose class is known: what it sees now, and what it forecasts from empty
input for frames to come.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from gridtrack.common.config import validated
from gridtrack.common.errors import WeightsError
from gridtrack.common.grid import LabelledFrame
from gridtrack.trackers.contract import FitOutput, FrameSource, stream_of
from gridtrack.trackers.labelled import (
    LabelledStretch,
    class_indices,
    draw_labelled,
    inverse_frequency,
    learned_classes,
)
from gridtrack.trackers.recurrent.network import State
from gridtrack.trackers.recurrent.settings import TransferSettings
from gridtrack.trackers.recurrent.tracker import RecurrentTracker
from gridtrack.trackers.weights import Card, TrainingData, load_weights, save_weights

STEPS = 20
"""How far ahead classes are learned: c_t .. c_{t+20}."""
FORECAST_EVERY = 10
"""Frames from one forecast that is learned from to the next: neighbouring ones say nearly the same."""
PENALTIES = (1e-1, 3e-2, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 3e-5, 1e-5)
"""What the validation stretch chooses from: factors of |W|^2 / 2 beside the mean log loss; strong ones first."""
ITERATIONS = 100


@dataclass(frozen=True, slots=True)
class Samples:
    """Latent patches (N, 9 C) float32 and the classes (N,) int64 of the cells in their middle."""

    patches: Tensor
    targets: Tensor


@dataclass(frozen=True, slots=True)
class Decoder:
    """Multinomial logistic regression: `weight` (K, 9 C), `bias` (K,), and how it was chosen."""

    weight: Tensor
    bias: Tensor
    penalty: float
    log_loss: float
    """On the validation stretch, nats a cell."""


def add_classes(
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

    learned = samples(tracker, stretch.frames, names, classes)
    held_out = _together([samples(tracker, list(source.labelled()), source.classes, classes) for source in validation])
    decoder = fit_decoder(learned, held_out, len(classes), out.report)

    weights = load_weights(tracker.stream, kind.name)
    card = _card(weights.card, classes, train, validation, options, _results(stretch, classes, learned, decoder, out))
    save_weights(out.path, card, weights.arrays | _arrays(decoder, tracker.network.channels))


def _trained(kind: type[RecurrentTracker], source: FrameSource, out: FitOutput, options: Any) -> RecurrentTracker:
    """The tracker of the occupancy weights, as it runs on a stream. Raises WeightsError."""
    if not out.path.exists():
        raise WeightsError(f"{out.path}: no weights to add classes to: train with stage=both, or put them there")
    shape = options.model_dump(exclude_unset=True, exclude=set(TransferSettings.model_fields))
    return kind(stream_of(source, out.path), validated(kind.Options, shape, kind.name))


@torch.no_grad()
def samples(
    tracker: RecurrentTracker, frames: Sequence[LabelledFrame], names: Sequence[str], classes: Sequence[str]
) -> Samples:
    """Patches of h_t at the labelled cells of each frame, and of every FORECAST_EVERY-th forecast of those to come.

    Labels index `names`; cells of a class that is none of `classes` are left out.
    """
    patches, targets = [], []
    tracker.reset(0)
    for t, now in enumerate(frames):
        tracker.update(now.frame)
        to_come = frames[t : t + 1 + (STEPS if t % FORECAST_EVERY == 0 else 0)]
        for features, then in zip(_forecast(tracker.network, tracker.state), to_come, strict=False):
            target = class_indices(then.labels, names, classes)
            patches.append(latent_patches(features, then.cells[target >= 0]))
            targets.append(torch.from_numpy(target[target >= 0]))
    return Samples(torch.cat(patches), torch.cat(targets))


def _forecast(network: Any, state: State) -> Iterator[Tensor]:
    """What the decoders read (1, C, M, M), now and after each step with empty input, without end."""
    while True:
        yield network.features(state)
        state = network.step(None, state)


def latent_patches(features: Tensor, cells: NDArray[np.int64]) -> Tensor:
    """Patches (N, 9 C) of `features` (1, C, M, M) around `cells` (N,), in the order of a convolution's weights."""
    size = features.shape[-1]
    row, column = (torch.from_numpy(index)[:, None, None] for index in np.divmod(cells, size))
    around = torch.arange(3)
    padded = functional.pad(features[0], (1, 1, 1, 1))
    return padded[:, row + around[:, None], column + around].transpose(0, 1).flatten(1)


def fit_decoder(learned: Samples, held_out: Samples, classes: int, report: Callable[[str], None]) -> Decoder:
    """The regression on `learned`, classes weighted by inverse frequency, with the penalty best for `held_out`."""
    weight = torch.zeros(classes, learned.patches.shape[1], requires_grad=True)
    bias = torch.zeros(classes, requires_grad=True)
    class_weights = torch.from_numpy(inverse_frequency(learned.targets.numpy(), classes))
    best = None
    for penalty in PENALTIES:
        _minimise(weight, bias, learned, class_weights, penalty)
        log_loss = _log_loss(weight, bias, held_out)
        report(f"class decoder, penalty {penalty:g}: validation log loss {log_loss:.4f} nats a cell")
        if best is None or log_loss < best.log_loss:
            best = Decoder(weight.detach().clone(), bias.detach().clone(), penalty, log_loss)
    assert best is not None
    return best


def _minimise(weight: Tensor, bias: Tensor, learned: Samples, class_weights: Tensor, penalty: float) -> None:
    """Move `weight` and `bias` to the least weighted mean log loss with its penalty, from where they are."""
    optimizer = torch.optim.LBFGS([weight, bias], max_iter=ITERATIONS, line_search_fn="strong_wolfe")

    def loss() -> Tensor:
        optimizer.zero_grad()
        logits = functional.linear(learned.patches, weight, bias)
        value = functional.cross_entropy(logits, learned.targets, class_weights) + 0.5 * penalty * weight.square().sum()
        value.backward()  # type: ignore[no-untyped-call]
        return value

    optimizer.step(loss)  # type: ignore[no-untyped-call]


@torch.no_grad()
def _log_loss(weight: Tensor, bias: Tensor, held_out: Samples) -> float:
    return float(functional.cross_entropy(functional.linear(held_out.patches, weight, bias), held_out.targets))


def _together(parts: Sequence[Samples]) -> Samples:
    return Samples(torch.cat([part.patches for part in parts]), torch.cat([part.targets for part in parts]))


def _arrays(decoder: Decoder, channels: int) -> dict[str, NDArray[Any]]:
    return {
        "decode_semantics.weight": decoder.weight.reshape(-1, channels, 3, 3).numpy(),
        "decode_semantics.bias": decoder.bias.numpy(),
    }


def _results(
    stretch: LabelledStretch, classes: Sequence[str], learned: Samples, decoder: Decoder, out: FitOutput
) -> dict[str, Any]:
    """What the card says of this stage; its command is not the network's where that was trained before."""
    count = torch.bincount(learned.targets, minlength=len(classes)).tolist()
    return {
        "command": out.command,
        "seed": out.seed,
        "labelled": stretch.name,
        "cells": dict(zip(classes, count, strict=True)),
        "penalty": decoder.penalty,
        "validation_log_loss": round(decoder.log_loss, 5),
    }


def _card(
    card: Card,
    classes: tuple[str, ...],
    train: Sequence[FrameSource],
    validation: Sequence[FrameSource],
    options: TransferSettings,
    results: dict[str, Any],
) -> Card:
    """The network's card, and what has been added."""
    used = [[TrainingData(recording=s.name, sha256=s.sha256) for s in sources] for sources in (train, validation)]
    return card.model_copy(
        update={
            "classes": classes,
            "train": tuple(dict.fromkeys([*card.train, *used[0]])),
            "validation": tuple(dict.fromkeys([*card.validation, *used[1]])),
            "settings": card.settings | {"stage": "both", "labelled_scans": options.labelled_scans},
            "results": card.results | {"classes": results},
        }
    )

"""A small convolutional network that learns to forecast the next frames of a grid from the last ones."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from copy import deepcopy
from typing import Any

import numpy as np
import torch
from pydantic import PositiveFloat, PositiveInt
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy_with_logits

from gridtrack import (
    Card,
    ConfigurationError,
    FitTask,
    Forecast,
    GridFrame,
    Settings,
    StreamSpec,
    Tracker,
    card_for,
    load_checkpoint,
    load_weights,
    restore_network,
    save_checkpoint,
    save_interrupted,
    save_weights,
    stream_of,
    trained_settings,
    training_device,
)

NAME = "learned-tracker"
"""As in pyproject.toml."""
PAST = 5
"""Number of frames that the network sees."""


class LearnedOptions(Settings):
    """Options of the training: `gridtrack train learned-tracker:updates=2000 RECORDING`."""

    updates: PositiveInt = 500
    validate_every: PositiveInt = 50
    batch: PositiveInt = 2
    learning_rate: PositiveFloat = 3e-3
    channels: PositiveInt = 16
    horizon_s: PositiveFloat = 1.0
    """The network forecasts up to this time ahead; later steps repeat the last one."""


class LearnedTracker(Tracker):
    """Forecasts all steps at once with a network, which is trained for the site."""

    Options = LearnedOptions
    learns = True

    def __init__(self, stream: StreamSpec, options: LearnedOptions, network: nn.Module | None = None) -> None:
        """`network`: the one in training; None: that of the weights."""
        super().__init__(stream, options)
        if network is None:
            weights = load_weights(stream, NAME)
            trained = trained_settings(stream, weights, options)
            network = build(trained.channels, round(trained.horizon_s / stream.period_s))
            restore_network(network, stream, weights)
        self.network = network
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Set the past to frames in which nothing is visible."""
        self.past = deque([torch.zeros(2, *self.stream.grid.shape)] * PAST, PAST)

    def update(self, frame: GridFrame) -> None:
        """Add the frame; the oldest one is forgotten."""
        self.past.append(planes_of(frame).float())

    def predict(self, steps: int) -> Forecast:
        """P(occupied) (steps+1, M, M); the state is not changed."""
        with torch.inference_mode():
            learned = torch.sigmoid(self.network(torch.stack([*self.past])[None]))[0].numpy()
        return Forecast(learned[np.minimum(np.arange(steps + 1), len(learned) - 1)])

    @classmethod
    def fit(cls, task: FitTask) -> None:
        """Train on random windows; keep the weights with the least log loss on the validation stretches."""
        options, device = task.options, training_device(task.device)
        steps = round(options.horizon_s / task.train[0].period_s)
        stretches = [torch.stack([planes_of(frame) for frame in source]) for source in task.train]
        if min(map(len, stretches)) < PAST + steps:
            raise ConfigurationError(f"{NAME} learns from stretches of {PAST + steps} frames or more: name longer ones")
        torch.manual_seed(task.seed)
        network = build(options.channels, steps).to(device)
        optimizer = torch.optim.Adam(network.parameters(), options.learning_rate)
        best: dict[str, Any] = {"log_loss": math.inf}
        done, saved = 0, load_checkpoint(task)
        if saved:  # a training was interrupted
            network.load_state_dict(saved["network"])
            optimizer.load_state_dict(saved["optimizer"])
            done, best = saved["done"], saved["best"]
        try:
            with task.progress.stage("update", options.updates, done) as stage:
                for update in range(done, options.updates):
                    windows = draw(stretches, PAST + steps, options.batch, seed=(task.seed, update))
                    loss = loss_of(network, windows.to(device))
                    optimizer.zero_grad()
                    loss.backward()  # type: ignore[no-untyped-call]
                    optimizer.step()
                    stage.advance(f"loss {loss:.4f}")
                    if stage.done % options.validate_every and stage.done < options.updates:
                        continue
                    tried = deepcopy(network).cpu()
                    scores = [task.objective(cls(stream_of(s), options, tried), s, steps) for s in task.validation]
                    log_loss = float(np.mean([score.log_loss["visible"] for score in scores]))
                    if log_loss < best["log_loss"]:
                        best = {"log_loss": log_loss, "arrays": tried.state_dict()}
                    done = stage.done
                    state = {"network": network.state_dict(), "optimizer": optimizer.state_dict()}
                    save_checkpoint(task, {**state, "done": done, "best": best})
                    task.report(f"update {done} of {options.updates}: validation log loss {log_loss:.4f}")
        except KeyboardInterrupt:
            if done:
                save_interrupted(task.out, *card_and_arrays(task, best), f"update {done} of {options.updates}")
            raise
        save_weights(task.out, *card_and_arrays(task, best))


def card_and_arrays(task: FitTask, best: dict[str, Any]) -> tuple[Card, dict[str, Any]]:
    """The card and the arrays of the best network."""
    card = card_for(NAME, task, task.options.model_dump(), {"validation_log_loss": best["log_loss"]})
    return card, {name: value.numpy() for name, value in best["arrays"].items()}


def build(channels: int, steps: int) -> nn.Module:
    """A network from frames (B, PAST, 2, M, M) to logits (B, steps+1, M, M); each cell is forecast from 31 x 31."""
    layers: list[nn.Module] = [nn.Flatten(1, 2), nn.Conv2d(2 * PAST, channels, 3, padding=1), nn.ReLU()]
    for reach in (2, 4, 8):
        layers += [nn.Conv2d(channels, channels, 3, padding=reach, dilation=reach), nn.ReLU()]
    return nn.Sequential(*layers, nn.Conv2d(channels, steps + 1, 1))


def planes_of(frame: GridFrame) -> Tensor:
    """The visible and the occupied cells (2, M, M) bool."""
    return torch.from_numpy(np.stack([frame.visible, frame.occupied]))


def draw(stretches: Sequence[Tensor], length: int, batch: int, seed: tuple[int, int]) -> Tensor:
    """Windows (B, length, 2, M, M) of consecutive frames; equal for equal seeds, so that a resumed training is too."""
    random = np.random.default_rng(seed)
    chosen = [stretches[int(random.integers(len(stretches)))] for _ in range(batch)]
    starts = [int(random.integers(len(stretch) - length + 1)) for stretch in chosen]
    return torch.stack([stretch[at : at + length] for stretch, at in zip(chosen, starts, strict=True)]).float()


def loss_of(network: nn.Module, windows: Tensor) -> Tensor:
    """The mean log loss of the visible cells from the last frame of the past on, nats."""
    visible, occupied = windows[:, PAST - 1 :].unbind(2)
    logits = network(windows[:, :PAST])
    return binary_cross_entropy_with_logits(logits, occupied, visible, reduction="sum") / visible.sum().clamp(min=1.0)

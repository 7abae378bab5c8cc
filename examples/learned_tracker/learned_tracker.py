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
    delete_checkpoint,
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
    """Options of the training: `gridtrack train learned-tracker:updates=500 RECORDING`."""

    updates: PositiveInt = 1000
    validate_every: PositiveInt = 100
    batch: PositiveInt = 4
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
            network = build(trained_settings(stream, weights, options), stream.period_s)
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
        options, period_s, device = task.options, task.train[0].period_s, training_device(task.device)
        steps = steps_of(options, period_s)
        stretches = [torch.stack([planes_of(frame) for frame in source]) for source in task.train]
        if min(map(len, stretches)) < PAST + steps:
            raise ConfigurationError(f"{NAME} learns from stretches of {PAST + steps} frames or more: name longer ones")
        torch.manual_seed(task.seed)
        network = build(options, period_s).to(device)
        optimizer = torch.optim.Adam(network.parameters(), options.learning_rate)
        done, best_loss, best = 0, math.inf, {}
        if saved := load_checkpoint(task):  # of a training that was interrupted
            network.load_state_dict(saved["network"])
            optimizer.load_state_dict(saved["optimizer"])
            done, best_loss, best = saved["done"], saved["best_loss"], saved["best"]
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
                    if not best or log_loss < best_loss:
                        best_loss, best = log_loss, tried.state_dict()
                    done, state = stage.done, {"network": network.state_dict(), "optimizer": optimizer.state_dict()}
                    save_checkpoint(task, {**state, "done": done, "best_loss": best_loss, "best": best})
                    task.report(f"update {done} of {options.updates}: validation log loss {log_loss:.4f}")
        except KeyboardInterrupt:
            if best:
                save_interrupted(task.out, *learned(task, best, best_loss), f"update {done} of {options.updates}")
            raise
        save_weights(task.out, *learned(task, best, best_loss))
        delete_checkpoint(task)


def learned(task: FitTask, best: dict[str, Tensor], best_loss: float) -> tuple[Card, dict[str, Any]]:
    """The card and the arrays of the best network."""
    card = card_for(NAME, task, task.options.model_dump(), {"validation_log_loss": best_loss})
    return card, {name: value.numpy() for name, value in best.items()}


def steps_of(options: LearnedOptions, period_s: float) -> int:
    """The number of steps ahead that the network forecasts."""
    return max(1, round(options.horizon_s / period_s))


def build(options: LearnedOptions, period_s: float) -> nn.Module:
    """A network from frames (B, PAST, 2, M, M) to logits (B, steps+1, M, M); each cell is forecast from 31 x 31."""
    layers: list[nn.Module] = [nn.Flatten(1, 2), nn.Conv2d(2 * PAST, options.channels, 3, padding=1), nn.ReLU()]
    for dilation in (2, 4, 8):
        layers += [nn.Conv2d(options.channels, options.channels, 3, padding=dilation, dilation=dilation), nn.ReLU()]
    return nn.Sequential(*layers, nn.Conv2d(options.channels, steps_of(options, period_s) + 1, 1))


def planes_of(frame: GridFrame) -> Tensor:
    """The visible and the occupied cells (2, M, M) bool."""
    return torch.from_numpy(np.stack([frame.visible, frame.occupied]))


def draw(stretches: Sequence[Tensor], length: int, batch: int, seed: tuple[int, int]) -> Tensor:
    """Windows (B, length, 2, M, M) of consecutive frames; equal for equal seeds, so that a resumed training is too."""
    random = np.random.default_rng(seed)
    chosen = [stretches[random.integers(len(stretches))] for _ in range(batch)]
    starts = [int(random.integers(len(stretch) - length + 1)) for stretch in chosen]
    return torch.stack([stretch[at : at + length] for stretch, at in zip(chosen, starts, strict=True)]).float()


def loss_of(network: nn.Module, windows: Tensor) -> Tensor:
    """The mean log loss of the visible cells from the last frame of the past on, nats."""
    visible, occupied = windows[:, PAST - 1 :].unbind(2)
    logits = network(windows[:, :PAST])
    return binary_cross_entropy_with_logits(logits, occupied, visible, reduction="sum") / visible.sum().clamp(min=1.0)

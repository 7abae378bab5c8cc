"""Base of the networks that forecast from the last ten frames alone, and go further by feeding themselves."""

from __future__ import annotations

from abc import abstractmethod
from itertools import groupby
from typing import NamedTuple

import torch
from pydantic import Field
from torch import Tensor
from torch.nn import functional

from gridtrack.trackers.recurrent.network import Network, WindowForecast
from gridtrack.trackers.recurrent.settings import TrainingSettings

PAST_STEPS = 10
"""Number of the network's steps that it reads."""


class PastFramesTraining(TrainingSettings):
    """Training on every series of `blank_frames`, forecast from the ten frames before it."""

    blank_frames: int = Field(10, ge=1)
    """Consecutive frames to forecast, by feeding itself beyond those that the network gives at once."""


class StepsAhead(NamedTuple):
    """Logits (B, N, M, M) of P(occupied) in the next N steps, and a penalty for the loss, nats."""

    logits: Tensor
    penalty: Tensor | float = 0.0


class PastFramesNetwork(Network):
    """Base of the networks; a subclass defines `next_steps` and `decoder`."""

    mixed_resolutions = True

    @abstractmethod
    def next_steps(self, past: Tensor, draw: torch.Generator | None) -> StepsAhead:
        """One or more steps after `past` (B, PAST_STEPS, 2, M, M), visible and occupied, for any M.

        `draw`: the source of random numbers, if the network uses any; None: torch's own.
        """

    def forecast(self, past: Tensor, steps: int, draw: torch.Generator | None = None) -> StepsAhead:
        """`steps` steps after `past`. Forecast steps are fed back: visible everywhere, occupied their probability."""
        logits: list[Tensor] = []
        penalty: Tensor | float = 0.0
        while len(logits) < steps:
            ahead = self.next_steps(past, draw)
            logits += ahead.logits.unbind(dim=1)
            penalty = penalty + ahead.penalty
            occupied = torch.sigmoid(ahead.logits)
            fed = torch.stack([torch.ones_like(occupied), occupied], dim=2)
            past = torch.cat([past, fed], dim=1)[:, -PAST_STEPS:]
        return StepsAhead(torch.stack(logits[:steps], dim=1), penalty)

    def forecast_windows(self, windows: Tensor, settings: TrainingSettings) -> WindowForecast:
        """Every series of blank frames, from the frames before it; those that are not observed have no cell visible."""
        observed = windows.new_tensor([settings.is_observed(t) for t in range(settings.length)])
        shown = functional.pad(windows * observed.view(-1, 1, 1, 1), (0, 0, 0, 0, 0, 0, PAST_STEPS, 0))
        frames: list[int] = []
        logits: list[Tensor] = []
        penalty: Tensor | float = 0.0
        for is_input, numbers in groupby(range(settings.length), settings.is_observed):
            if not is_input:
                blank = list(numbers)
                ahead = self.forecast(shown[:, blank[0] : blank[0] + PAST_STEPS], len(blank))
                frames += blank
                logits.append(ahead.logits.transpose(0, 1).flatten(0, 1))
                penalty = penalty + ahead.penalty
        return WindowForecast(frames, torch.cat(logits), penalty)


def padded(planes: Tensor, multiple: int) -> Tensor:
    """`planes` (..., M, M) with zeros after the last rows and columns, so that M is a `multiple`."""
    missing = -planes.shape[-1] % multiple
    return functional.pad(planes, (0, missing, 0, missing))

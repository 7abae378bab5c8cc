"""Base of the networks that forecast from the last ten frames alone, and go further by feeding themselves, and of their
trackers, which keep these frames in the window of the present."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field
from torch import Tensor
from torch.nn import functional

from gridtrack.common.grid import GridFrame, rolled
from gridtrack.trackers.contract import Forecast
from gridtrack.trackers.recurrent.network import Network, WindowForecast
from gridtrack.trackers.recurrent.network_tracker import NetworkTracker
from gridtrack.trackers.recurrent.pacing import StepPace
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


@dataclass(frozen=True, slots=True)
class StreamForecaster:
    """A trained network at the `pace` of a stream; it forecasts `samples` futures."""

    network: PastFramesNetwork
    pace: StepPace
    samples: int = 1

    @property
    def device(self) -> torch.device:
        """The device of the network."""
        return self.network.output_bias.device

    @property
    def frames(self) -> int:
        """Number of last frames that it reads."""
        return self.pace.frames_of_past(PAST_STEPS)

    @torch.inference_mode()
    def forecast(self, frames: NDArray[np.uint8], steps: int, seed: int) -> NDArray[np.float32]:
        """P(occupied) (F, `steps`, M, M) in the steps of the stream after its last `frames` (N, 2, M, M).

        As in a recurrent network at this pace, there are several series of past steps if the frames are fast, and each
        forecasts the steps that it would take.
        """
        pasts = torch.from_numpy(self.pace.past_of(frames, PAST_STEPS)).to(self.device, torch.float32)
        own_steps = math.ceil(steps * self.pace.substeps / self.pace.phases)
        by_series = []
        for number, past in enumerate(pasts):
            draw = torch.Generator().manual_seed(seed + number)
            logits = self.network.forecast(past.expand(self.samples, *past.shape), own_steps, draw).logits
            by_series.append(torch.sigmoid(logits))
        in_order = torch.stack(by_series, dim=2).flatten(1, 2)[:, self.pace.substeps - 1 :: self.pace.substeps]
        found: NDArray[np.float32] = in_order[:, :steps].cpu().numpy()
        return found


class PastFramesTracker(NetworkTracker):
    """A PastFramesNetwork as a tracker; a subclass has `Options`, and builds the network."""

    network: StreamForecaster

    @classmethod
    def samples_of(cls, options: Any) -> int:
        """The number of futures of a forecast; 1: none."""
        return 1

    @classmethod
    def at_pace(cls, network: Any, pace: StepPace, options: Any) -> StreamForecaster:
        """The `network` at this pace."""
        return StreamForecaster(network, pace, cls.samples_of(options))

    def reset(self, seed: int) -> None:
        """No frame has been seen; the random numbers of a forecast follow from `seed` and the number of updates."""
        super().reset(seed)
        self._seed, self._updates = seed, 0
        self._frames = np.zeros((self.network.frames, 2, *self.stream.grid.shape), np.uint8)

    def update(self, frame: GridFrame) -> None:
        """Keep x_t, with the frames before it in its window. Nothing was visible in a missed frame."""
        for _ in range(self._missed_before(frame.stamp_ns)):
            self._keep(np.zeros_like(self._frames[-1]))
        shift = self._shift(self._world_T_grid or frame.world_T_grid, frame.world_T_grid)
        if shift:
            self._frames = rolled(self._frames, shift, 0)
        self._world_T_grid = frame.world_T_grid
        self._keep(np.stack([frame.visible, frame.occupied]).astype(np.uint8))
        self._updates += 1

    def _keep(self, planes: NDArray[np.uint8]) -> None:
        self._frames = np.concatenate([self._frames[1:], planes[None]])

    def predict(self, steps: int) -> Forecast:
        """The network's forecast. In step 0 visible cells are as observed, and the others as in step 1."""
        seed = int(np.random.default_rng((self._seed, self._updates)).integers(2**62))
        ahead = self.network.forecast(self._frames, max(1, steps), seed)
        visible, occupied = self._frames[-1]
        now = np.where(visible, occupied.astype(np.float32), ahead[:, :1])
        futures = np.concatenate([now, ahead[:, :steps]], axis=1)
        return Forecast(futures.mean(axis=0), futures=futures.astype(np.float16) if len(futures) > 1 else None)

"""Base of the trackers that forecast from the last frames, which they keep in the window of the present."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from gridtrack.common.grid import GridFrame, rolled
from gridtrack.trackers.contract import Forecast, StreamSpec
from gridtrack.trackers.past_frames.network import PAST_STEPS, PastFramesNetwork
from gridtrack.trackers.recurrent.network import channels_last, resolution_of, set_resolution
from gridtrack.trackers.recurrent.network_tracker import NetworkTracker
from gridtrack.trackers.recurrent.pacing import StepPace
from gridtrack.trackers.training.device import device_name, inference_device


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

    @property
    def device(self) -> str:
        """The name of the device of the network."""
        return device_name(self.network.device)

    @classmethod
    def samples_of(cls, options: Any) -> int:
        """The number of futures of a forecast; 1: none."""
        return 1

    @classmethod
    def inference_for(cls, network: Any, stream: StreamSpec, options: Any) -> StreamForecaster:
        """The trained `network`, at the pace of the `stream`."""
        pace = StepPace.of(stream.period_s, options.step_s)
        set_resolution(network, resolution_of(stream.grid.cell_m, pace.step_s(stream.period_s)))
        on_device = channels_last(network.eval().to(inference_device(options.device)))
        return StreamForecaster(on_device, pace, cls.samples_of(options))

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

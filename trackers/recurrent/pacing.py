"""Steps of equal duration at every period of a stream: several steps a frame, or several states that alternate.

A pedestrian moves a third of a cell a frame at 20 scans a second, and four cells at 5. A network for any place has
steps of about one duration instead. If the frames of a stream are slow, some steps have no input. If they are fast,
there are several states: each takes every n-th frame, and the forecast of a frame comes from the state that would take
it.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Self, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from gridtrack.common.grid import Shift
from gridtrack.trackers.recurrent.inference import InferenceNetwork
from gridtrack.trackers.recurrent.network import DecodedLayers, RecurrentNetwork, State


class StepPace(NamedTuple):
    """How the steps of a network follow the frames of a stream: `substeps` steps a frame, or one in `phases` frames.

    One of the two is 1.
    """

    substeps: int = 1
    phases: int = 1

    @classmethod
    def of(cls, period_s: float, step_s: float) -> Self:
        """The pace at which a step lasts `step_s`, by a factor of sqrt(2) at most; 0: a step for each frame."""
        if not step_s:
            return cls()
        ratio = period_s / step_s
        return cls(_nearest_number(ratio), _nearest_number(1.0 / ratio))

    def step_s(self, period_s: float) -> float:
        """Duration of a step in a stream of this period."""
        return period_s * self.phases / self.substeps

    def frames(self, steps: int) -> int:
        """Number of consecutive frames from which `steps` steps of one state are made."""
        return (steps - 1) * self.phases + 1 if self.phases > 1 else steps // self.substeps

    def steps_of(self, planes: NDArray[np.uint8], steps: int) -> NDArray[np.uint8]:
        """The planes (steps, ...) of a series of `frames(steps)` frames: nothing is visible in steps without a frame.

        The last of the substeps of a frame has its planes, as in a stream.
        """
        if self.substeps == 1:
            return planes[:: self.phases]
        spaced = np.zeros((steps, *planes.shape[1:]), np.uint8)
        spaced[self.substeps - 1 :: self.substeps] = planes
        return spaced

    def frames_of_past(self, steps: int) -> int:
        """Number of last frames that the last `steps` steps are made from, in every phase."""
        return steps * self.phases if self.phases > 1 else math.ceil(steps / self.substeps)

    def past_of(self, frames: NDArray[np.uint8], steps: int) -> NDArray[np.uint8]:
        """The last `steps` steps (phases, steps, ...) of each phase, from the last `frames_of_past(steps)` frames.

        The first phase takes the next frame; the last one has taken the last one.
        """
        if self.substeps == 1:
            return np.ascontiguousarray(frames.reshape(steps, self.phases, *frames.shape[1:]).swapaxes(0, 1))
        spaced = np.zeros((1, steps, *frames.shape[1:]), np.uint8)
        spaced[0, (steps - 1) % self.substeps :: self.substeps] = frames
        return spaced

    def frame_of(self, step: int) -> int:
        """The number of the last frame of the series before or at step number `step`; 0 at least."""
        return step * self.phases if self.substeps == 1 else max(0, (step + 1) // self.substeps - 1)


def _nearest_number(ratio: float) -> int:
    """The whole number that is nearest to `ratio`, which is above 0, on a logarithmic scale; 1 at least."""
    below = max(1, math.floor(ratio))
    return below if ratio * ratio <= below * (below + 1) else below + 1


class PacedNetwork:
    """A trained network on one stream, at this `pace`, in a window that may move.

    Its State is a tuple of the states of the phases, each of which takes one frame in `phases`; the last one has taken
    the last frame. The last of the `substeps` of a frame has it as its input. A step without input forecasts the next
    frame from the state that would take it.
    """

    def __init__(self, network: InferenceNetwork, pace: StepPace) -> None:
        self.network, self.pace = network, pace

    @property
    def innermost(self) -> RecurrentNetwork:
        """The network with the parameters."""
        return cast(RecurrentNetwork, self.network.network)

    @property
    def device(self) -> torch.device:
        """The device of the states and the planes."""
        return self.innermost.output_bias.device

    def initial(self) -> State:
        """h_0 in every phase."""
        return (self.network.initial(1),) * self.pace.phases

    def step(self, x: Tensor | None, state: State) -> State:
        """The states after the next frame x (1, 2, M, M), or without it: the oldest one takes it."""
        oldest, *newer = state
        for _ in range(self.pace.substeps - 1):
            oldest = self.network.step(None, oldest)
        return (*newer, self.network.step(x, oldest))

    def occupancy(self, state: State) -> Tensor:
        """Logits of P(occupied) in the last frame, (1, M, M)."""
        return self.network.occupancy(self.network.features(state[-1]))

    def class_planes(self, state: State, layers: DecodedLayers) -> Tensor:
        """The part of the last frame's state that a class decoder reads, (1, C, M, M)."""
        return self.innermost.class_planes(state[-1], layers)

    def semantics(self, state: State) -> Tensor | None:
        """Logits of the K classes in the last frame, (1, K, M, M); None without a class decoder."""
        return self.innermost.semantics(state[-1])

    def unseen(self, frames: int) -> State:
        """The state, in each phase, of a cell that no frame of `frames` has seen: arrays (C,)."""
        return tuple(self.network.unseen(steps) for steps in self._steps_of_phases(frames))

    def rolled(self, state: State, shift: Shift, frames: int) -> State:
        """The `state` after `frames` frames, when the window moved by `shift`; cells that come in are `unseen`."""
        phases = zip(state, self._steps_of_phases(frames), strict=True)
        return tuple(self.network.rolled(phase, shift, steps) for phase, steps in phases)

    def anchor(self, shift: Shift) -> None:
        """Keep the maps at their places in the world: the window lies `shift` from where they begin."""
        self.network.anchor(shift)

    def _steps_of_phases(self, frames: int) -> list[int]:
        """The number of steps that each phase has made after `frames` frames."""
        substeps, phases = self.pace
        return [substeps * ((frames + number) // phases) for number in range(phases)]

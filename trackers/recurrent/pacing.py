"""Networks whose step lasts as long at every period of the stream: several steps a frame, or frames taken in turns.

What walks moves a third of a cell a frame at 20 scans a second, and four cells at 5. A network for any place has steps
of about one duration instead. Where the frames of a stream are slow, some of its steps have no input; where they are
fast, several states share the frames: each takes one of them in its turn, and forecasts are theirs in turn.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from gridtrack.trackers.recurrent.network import Float32Array, InferenceNetwork, LatentState


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
        """Consecutive frames from which `steps` steps of one state are made."""
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

    def frame_of(self, step: int) -> int:
        """The number of the last frame of the series that step number `step` knows; 0 at least."""
        return step * self.phases if self.substeps == 1 else max(0, (step + 1) // self.substeps - 1)


def _nearest_number(ratio: float) -> int:
    """The whole number that is nearest to `ratio`, which is above 0, on a logarithmic scale; 1 at least."""
    below = max(1, math.floor(ratio))
    return below if ratio * ratio <= below * (below + 1) else below + 1


def paced(network: InferenceNetwork, pace: StepPace) -> InferenceNetwork:
    """The `network` as one whose step is a frame of the stream."""
    if pace.substeps > 1:
        return SubstepNetwork(network, pace.substeps)
    return InterleavedNetwork(network, pace.phases) if pace.phases > 1 else network


class SubstepNetwork:
    """An InferenceNetwork that makes `substeps` steps a frame, the last one with the frame as its input."""

    def __init__(self, network: InferenceNetwork, substeps: int) -> None:
        self._network, self._substeps = network, substeps
        self.initial, self.current = network.initial, network.current
        self.features, self.occupancy, self.semantics = network.features, network.occupancy, network.semantics
        self.anchor = network.anchor

    def step(self, x: Tensor | None, state: LatentState) -> LatentState:
        """The state after the next frame x, or without it."""
        for _ in range(self._substeps - 1):
            state = self._network.step(None, state)
        return self._network.step(x, state)

    def unseen(self, frames: int) -> tuple[Float32Array, ...]:
        """The state (C,) in each layer of a cell that no frame of `frames` has seen."""
        return self._network.unseen(frames * self._substeps)


class InterleavedNetwork:
    """An InferenceNetwork with `phases` states, of which each takes one frame in `phases`, in turns.

    Its LatentState is those of all phases, the one of the last frame at the end. A step without input forecasts the
    frame whose turn it is, from the state that is `phases` frames older.
    """

    def __init__(self, network: InferenceNetwork, phases: int) -> None:
        self._network, self._phases = network, phases
        self.occupancy, self.anchor = network.occupancy, network.anchor

    def initial(self, batch: int) -> LatentState:
        """h_0 in every phase."""
        return self._network.initial(batch) * self._phases

    def step(self, x: Tensor | None, state: LatentState) -> LatentState:
        """The states after the next frame x, or without it: the oldest one takes it."""
        layers = len(state) // self._phases
        return (*state[layers:], *self._network.step(x, state[:layers]))

    def current(self, state: LatentState) -> LatentState:
        """The state of the last frame."""
        return self._network.current(state[-(len(state) // self._phases) :])

    def features(self, state: LatentState) -> Tensor:
        """What the occupancy decoder reads."""
        return self._network.features(self.current(state))

    def semantics(self, state: LatentState) -> Tensor | None:
        """Logits of the classes."""
        return self._network.semantics(self.current(state))

    def unseen(self, frames: int) -> tuple[Float32Array, ...]:
        """The state (C,) in each layer, and phase, of a cell that no frame of `frames` has seen."""
        updates = ((frames + number) // self._phases for number in range(self._phases))
        return tuple(h for each in updates for h in self._network.unseen(each))

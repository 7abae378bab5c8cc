"""The interface of a recurrent network that is trained and run as a tracker."""

from __future__ import annotations

import math
from typing import Any, Literal, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from gridtrack.common.grid import Shift

Float32Array = NDArray[np.float32]

LatentState = tuple[Tensor, ...]
"""The latent state: one tensor (B, C, M, M) for each recurrent layer."""


DecodedLayers = Literal["last", "all"]


class RecurrentNetwork(Protocol):
    """A network with a latent state that is updated with each frame and decoded into grids."""

    def initial(self, batch: int) -> LatentState:
        """h_0."""
        ...

    def step(self, x: Tensor | None, state: LatentState) -> LatentState:
        """h_t from x_t (B, 2, M, M), the planes visible and occupied, and h_{t-1}. None is the empty input."""
        ...

    def features(self, state: LatentState) -> Tensor:
        """The part of the latent state that the occupancy decoder reads, (B, C, M, M)."""
        ...

    def occupancy(self, features: Tensor) -> Tensor:
        """Logits of P(occupied), (B, M, M)."""
        ...

    def semantics(self, state: LatentState) -> Tensor | None:
        """Logits of the K classes, (B, K, M, M); None for a network without classes."""
        ...


class InferenceNetwork(RecurrentNetwork, Protocol):
    """A network for one stream, whose window may move."""

    def current(self, state: LatentState) -> LatentState:
        """The part of the state that knows the last frame: one tensor for each recurrent layer."""
        ...

    def unseen(self, frames: int) -> tuple[Float32Array, ...]:
        """The state (C,) in each layer of a cell that no frame of `frames` has seen, far from every cell that was."""
        ...

    def anchor(self, shift: Shift) -> None:
        """Keep the maps of the network at their places in the world: the window lies `shift` from where they begin."""
        ...


def class_planes(state: LatentState, layers: DecodedLayers) -> Tensor:
    """The part of the latent state that the class decoder reads, (B, C, M, M) or (B, layers x C, M, M)."""
    return state[-1] if layers == "last" else torch.cat(state, dim=1)


def channels_last(network: nn.Module) -> Any:
    """The network with its convolutions in channels-last memory, which is fastest on a processor."""
    to: Any = network.to
    return to(memory_format=torch.channels_last)


def as_cells(tensor: Tensor) -> Float32Array:
    """(1, C, M, M) in channels-last memory as (M, M, C), without copying."""
    cells: Float32Array = tensor[0].permute(1, 2, 0).numpy()
    return cells


def as_tensor(cells: Float32Array) -> Tensor:
    """(M, M, C) as (1, C, M, M) in channels-last memory, without copying.

    The batch comes first: torch takes a tensor whose batch of one has another stride for one that is not channels-last,
    and convolutions and `cat` then copy it.
    """
    return torch.from_numpy(cells)[None].permute(0, 3, 1, 2)


def start_from_rate(decoder: nn.Conv2d, rate: float) -> None:
    """Set the output bias so that an untrained network answers the occupied `rate` in (0, 1), not one half.

    About 2 % of the visible cells are occupied; the first updates of training need not learn that number.
    """
    assert decoder.bias is not None
    with torch.no_grad():
        decoder.bias.fill_(math.log(rate / (1.0 - rate)))

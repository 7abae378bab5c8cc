"""The interface of a recurrent network that is trained and run as a tracker."""

from __future__ import annotations

import math
from typing import Any, Literal, Protocol

import torch
from torch import Tensor, nn

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


def class_planes(state: LatentState, layers: DecodedLayers) -> Tensor:
    """The part of the latent state that the class decoder reads, (B, C, M, M) or (B, layers x C, M, M)."""
    return state[-1] if layers == "last" else torch.cat(state, dim=1)


def channels_last(network: nn.Module) -> Any:
    """The network with its convolutions in channels-last memory, which is fastest on a processor."""
    to: Any = network.to
    return to(memory_format=torch.channels_last)


def start_from_rate(decoder: nn.Conv2d, rate: float) -> None:
    """Set the output bias so that an untrained network answers the occupied `rate` in (0, 1), not one half.

    About 2 % of the visible cells are occupied; the first updates of training need not learn that number.
    """
    assert decoder.bias is not None
    with torch.no_grad():
        decoder.bias.fill_(math.log(rate / (1.0 - rate)))

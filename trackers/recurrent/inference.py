"""A trained network on one stream, in a window that may move.

The network is trained in a window that stays. There, a cell that no beam has reached since the first frame has the
state of a network with empty input all the time. A cell that comes into a moving window starts with this state, as if
the window had contained it from the first frame on.
"""

from __future__ import annotations

from copy import deepcopy
from functools import cached_property
from typing import Any, cast

import torch
from torch import Tensor

from gridtrack.common.grid import Shift, rolled
from gridtrack.trackers.recurrent.network import (
    Float32Array,
    Recurrence,
    RecurrentNetwork,
    State,
    as_cells,
    as_tensor,
    map_state,
    tensors_of,
)

CONVERGED_AFTER = 200
"""Number of frames after which the state of an unseen cell counts as final, if it has not converged before."""
CONVERGED = 1e-6
"""Largest change of a converged state in one frame."""


class InferenceNetwork(Recurrence):
    """A trained `network` for batches of one, without gradients, with a step for each frame.

    It computes as it was trained, on any device; the subclasses in `kernels` are faster, on a processor.
    """

    def __init__(self, network: RecurrentNetwork) -> None:
        self.network: Any = network
        self._unseen = states_without_input(network)

    def initial(self, batch: int) -> State:
        """h_0."""
        return self.network.initial(batch)

    def step(self, x: Tensor | None, state: State) -> State:
        """The state after the next frame, x (1, 2, M, M), or without it; the given `state` is not changed."""
        return self.network.step(x, state)

    def features(self, state: State) -> Tensor:
        """The part of the latent state that the occupancy decoder reads, (1, C, M, M)."""
        return cast(Tensor, self.network.features(state))

    def occupancy(self, features: Tensor) -> Tensor:
        """Logits of P(occupied), (1, M, M)."""
        return cast(Tensor, self.network.occupancy(features))

    def unseen(self, frames: int) -> State:
        """The state of a cell that no frame of `frames` has seen, far from every cell that was: arrays (C,)."""
        return self._unseen[min(frames, len(self._unseen) - 1)]

    def rolled(self, state: State, shift: Shift, frames: int) -> State:
        """The `state` after `frames` frames, when the window moved by `shift`; cells that come in are `unseen`."""

        def roll(h: Tensor, fill: Float32Array) -> Tensor:
            return as_tensor(rolled(as_cells(h.cpu()), shift, fill, axes=(0, 1))).to(h.device)

        return map_state(roll, state, self.unseen(frames))

    def anchor(self, shift: Shift) -> None:
        """Keep the maps at their places in the world: the window lies `shift` from where they begin.

        Each cell takes the values of its place; outside a map these are its mean.
        """
        for bias, learned in self._learned_maps:
            mean = learned.mean(dim=(1, 2), keepdim=True)
            bias.copy_(torch.from_numpy(rolled(learned.numpy(), shift, mean.numpy())))

    @cached_property
    def _learned_maps(self) -> list[tuple[Tensor, Tensor]]:
        """Each map of the network, and a copy of its values as they were learned."""
        maps = (bias.detach() for bias in self.network.maps().values())
        return [(bias, bias.cpu().clone()) for bias in maps if is_map(bias)]


def is_map(bias: Tensor) -> bool:
    """Whether a bias (C, M, M) has a value for each cell; (C, 1, 1) has not."""
    return bias.shape[1:].numel() > 1


@torch.no_grad()
def states_without_input(network: RecurrentNetwork) -> list[State]:
    """The states of an unseen cell, far from all others, after 0, 1, 2, ... frames, as arrays (C,).

    The static memory is its mean, for any place.
    """
    one_cell: Any = of_one_cell(network)
    state, states = one_cell.initial(1), []
    for _ in range(CONVERGED_AFTER):
        states.append(map_state(lambda h: h.flatten().cpu().numpy(), state))
        before, state = state, one_cell.step(None, state)
        changes = zip(tensors_of(state), tensors_of(before), strict=True)
        if max(float((h - old).abs().max()) for h, old in changes) < CONVERGED:
            break
    return states


@torch.no_grad()
def of_one_cell(network: RecurrentNetwork) -> RecurrentNetwork:
    """A copy of `network` for a grid of one cell, which is any cell of a plane in which all cells are equal.

    There a convolution is a product with the sum of its taps. Maps have one value, their mean.
    """
    copied = deepcopy(network)
    copied.size = 1
    for parameter in copied.parameters():
        if parameter.ndim == 4:
            centre = parameter.shape[2] // 2
            total = parameter.sum(dim=(2, 3))
            parameter.zero_()[:, :, centre, centre] = total
    for bias in copied.maps().values():
        bias.data = bias.mean(dim=(1, 2), keepdim=True)
    return copied

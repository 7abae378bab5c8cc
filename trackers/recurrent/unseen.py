"""The latent state of a cell that was never seen, which the cells have that come into a window that moves.

The network is trained in a window that stays: a cell that no beam has reached since the first frame has a state there
too, that of a network whose input was empty all the time. A cell that comes into the window begins with the same state,
as if the window had held it from the first frame on.
"""

from __future__ import annotations

from copy import deepcopy
from typing import Any

import torch
from torch import nn

from gridtrack.common.grid import Shift, rolled
from gridtrack.trackers.recurrent.network import Float32Array, LatentState, as_cells, as_tensor

CONVERGED_AFTER = 200
"""Frames after which the state is taken for the final one, where it has not converged before."""
CONVERGED = 1e-6
"""Largest change of a converged state in one frame."""


class UnseenStates:
    """The states of unseen cells far from all others; maps of a place have their mean there, whatever the place is."""

    def __init__(self, network: nn.Module) -> None:
        """`network`: the trained RecurrentNetwork."""
        self._after: list[tuple[Float32Array, ...]] = []
        with torch.no_grad():
            one_cell = of_one_cell(network)
            state: LatentState = one_cell.initial(1)
            for _ in range(CONVERGED_AFTER):
                self._after.append(tuple(h.flatten().numpy() for h in state))
                before, state = state, one_cell.step(None, state)
                if max(float((h - old).abs().max()) for h, old in zip(state, before, strict=True)) < CONVERGED:
                    break

    def __call__(self, frames: int) -> tuple[Float32Array, ...]:
        """The state (C,) in each layer after `frames` frames without input."""
        return self._after[min(frames, len(self._after) - 1)]


@torch.no_grad()
def of_one_cell(network: nn.Module) -> Any:
    """A copy of `network` for a grid of one cell, which is any cell of a plane in which all cells are equal.

    There a convolution is a product with the sum of its taps. Maps have one value, their mean.
    """
    copied: Any = deepcopy(network)
    copied.size = 1
    for parameter in copied.parameters():
        if parameter.ndim == 4:
            centre = parameter.shape[2] // 2
            total = parameter.sum(dim=(2, 3))
            parameter.zero_()[:, :, centre, centre] = total
        elif parameter.ndim == 3:
            parameter.data = parameter.mean(dim=(1, 2), keepdim=True)
    return copied


def rolled_state(
    state: LatentState, shift: Shift, unseen: tuple[Float32Array, ...], buffers: tuple[Float32Array, ...] | None = None
) -> LatentState:
    """The latent state (1, C, M, M) of each layer after the window moved; cells that come in are `unseen` (C,).

    It is written to the `buffers` (M, M, C) where there are some.
    """
    outs = buffers or (None,) * len(state)
    return tuple(
        as_tensor(rolled(as_cells(h), shift, fill, axes=(0, 1), out=out))
        for h, fill, out in zip(state, unseen, outs, strict=True)
    )

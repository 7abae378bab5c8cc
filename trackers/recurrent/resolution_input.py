"""Cell size and period as inputs of a network for any place: they shift the biases of its units.

Two constant planes beside visible and occupied would do the same, but for the cells at the edge of the window, where a
convolution sees the zeros outside; and a network would have to convolve them in frames without input too.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from gridtrack.trackers.training.networks import cell_input, period_input


def resolution_of(cell_m: float, period_s: float) -> Tensor:
    """The inputs (2,) float32: the logarithms of cell size and period."""
    return torch.tensor([cell_input(cell_m), period_input(period_s)], dtype=torch.float32)


class ResolutionShift(nn.Module):
    """What the resolution of the grids adds to the biases (C,) of a layer: weights (C, 2) times `resolution_of`.

    Begins with zeros: the network is then the same at every resolution. `resolution` (2,), or (B, 2) where the items of
    a batch have one each.
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.zeros(channels, 2))
        self.resolution = torch.zeros(2)

    def forward(self, bias: Tensor) -> Tensor:
        """The `bias` (C,) or (C, M, M) at `resolution`; (B, C, M, M) of (C, M, M) at those of a batch."""
        shift = self.resolution.to(self.weight.device) @ self.weight.T
        return bias + shift.view(*shift.shape, *(1,) * (bias.ndim - 1))


def set_resolution(network: nn.Module, resolution: Tensor) -> None:
    """Let `network` be the one for grids of this `resolution_of` (2,), or of these of a batch (B, 2).

    A network that is for one site is the same at all.
    """
    for module in network.modules():
        if isinstance(module, ResolutionShift):
            module.resolution = resolution

"""A three-layer convolutional classifier of what one scan shows: x_t to the class of every cell.

3x3 convolutions with dilation 1, 2 and 4: a cell's class is decided from the 15 x 15 cells around it, what one step of
the dilated ConvGRU sees. Evaluated at single cells the same function is three convolutions with strides 2, 2 and 1 of
their 15 x 15 patches, at a tenth of the cost: that is how it is trained.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

REACH = 7
"""Cells from a cell to the edge of what it is classified from."""


class OneShotNetwork(nn.Module):
    """Planes (B, 2, M, M), visible and occupied, to logits (B, K, M, M); outside the grid nothing is visible."""

    def __init__(self, channels: int, classes: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(2, channels, 3)
        self.second = nn.Conv2d(channels, channels, 3)
        self.third = nn.Conv2d(channels, classes, 3)

    def forward(self, planes: Tensor) -> Tensor:
        """The classes of every cell."""
        return self._through(functional.pad(planes, (REACH,) * 4), strides=(1, 1, 1), dilations=(1, 2, 4))

    def of_patches(self, patches: Tensor) -> Tensor:
        """Logits (N, K) of the cells in the middle of patches (N, 2, 15, 15)."""
        return self._through(patches, strides=(2, 2, 1), dilations=(1, 1, 1)).flatten(1)

    def _through(self, x: Tensor, strides: tuple[int, ...], dilations: tuple[int, ...]) -> Tensor:
        layers = (self.first, self.second, self.third)
        for layer, stride, dilation in zip(layers, strides, dilations, strict=True):
            x = x if layer is self.first else functional.relu(x)
            x = functional.conv2d(x, layer.weight, layer.bias, stride=stride, dilation=dilation)
        return x


def patches_around(planes: Tensor, cells: NDArray[np.int64]) -> Tensor:
    """Patches (N, 2, 15, 15) of `planes` (2, M, M) around `cells` (N,), row * M + column."""
    index = torch.from_numpy(cells)
    row, column = (part[:, None, None] for part in (index // planes.shape[-1], index % planes.shape[-1]))
    around = torch.arange(2 * REACH + 1)
    padded = functional.pad(planes, (REACH,) * 4)
    return padded[:, row + around[:, None], column + around].transpose(0, 1).contiguous()

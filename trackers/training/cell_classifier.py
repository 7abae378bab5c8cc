"""A small convolutional classifier of cells, from the planes of one scan or of a latent state.

n convolutions of 3x3 with dilation 1, 2, 4, ... and ReLU between them: the receptive field is 2^(n+1) - 1 cells a side.
One layer is multinomial logistic regression of 3x3 patches. At single cells the same function is n convolutions
with stride 2 of their patches, at a fraction of the cost; it is trained so.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from gridtrack.common.grid import GridFrame
from gridtrack.trackers.training.networks import cell_input

LAYERS = 3


class CellClassifier(nn.Module):
    """Planes (B, C, M, M) to logits (B, K, M, M); planes are 0 outside the grid."""

    def __init__(self, planes: int, hidden: Sequence[int], classes: int) -> None:
        """`hidden`: the channels of every layer but the last; () is a linear classifier."""
        super().__init__()
        self.layers = nn.ModuleList(nn.Conv2d(a, b, 3) for a, b in pairwise([planes, *hidden, classes]))

    @property
    def reach(self) -> int:
        """Half the width of the receptive field, in cells."""
        return int(2 ** len(self.layers) - 1)

    def forward(self, planes: Tensor) -> Tensor:
        """Logits of every cell."""
        return self._convolved(functional.pad(planes, (self.reach,) * 4), stride=1, dilation_base=2)

    def of_patches(self, patches: Tensor) -> Tensor:
        """Logits (N, K) of the centre cells of patches (N, C, P, P), P = 2 reach + 1."""
        return self._convolved(patches, stride=2, dilation_base=1).flatten(1)

    def _convolved(self, x: Tensor, stride: int, dilation_base: int) -> Tensor:
        """The output of all layers; layer k has dilation `dilation_base`^k."""
        for k, layer in enumerate(self.layers):
            convolution: Any = layer
            x = functional.relu(x) if k else x
            x = functional.conv2d(x, convolution.weight, convolution.bias, stride, dilation=dilation_base**k)
        return x


def scan_classifier(channels: int, classes: int, *, general: bool = False) -> CellClassifier:
    """An untrained classifier of the 15 x 15 cells around a cell, as the baseline of Ondruska et al. (2016).

    Its planes are from `planes_of`, for `general` weights with the cell size.
    """
    return CellClassifier(3 if general else 2, (channels,) * (LAYERS - 1), classes)


def planes_of(frame: GridFrame, cell_m: float | None = None) -> Tensor:
    """Visible and occupied as one array (2, M, M) uint8; with `cell_m` (3, M, M) float16, the last its logarithm."""
    planes = torch.from_numpy(np.stack([frame.visible, frame.occupied]).astype(np.uint8))
    if cell_m is None:
        return planes
    return torch.cat([planes.half(), torch.full((1, *planes.shape[1:]), cell_input(cell_m), dtype=torch.float16)])

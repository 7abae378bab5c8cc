"""A small convolutional classifier of cells, whatever its planes: what one scan shows, or the latent state.

3x3 convolutions with dilation 1, 2, 4 and so on, ReLU between them: n of them decide a cell's class from the
2^(n+1) - 1 cells a side around it. One is multinomial logistic regression of 3x3 patches. Evaluated at single cells
the same function is n convolutions with stride 2 of such patches, at a fraction of the cost: that is how it is trained.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from torch import Tensor, nn
from torch.nn import functional


class CellClassifier(nn.Module):
    """Planes (B, C, M, M) to logits (B, K, M, M); outside the grid all planes are 0."""

    def __init__(self, planes: int, hidden: Sequence[int], classes: int) -> None:
        """`hidden` are the channels of every layer but the last; without any it is linear."""
        super().__init__()
        self.layers = nn.ModuleList(nn.Conv2d(a, b, 3) for a, b in pairwise([planes, *hidden, classes]))

    @property
    def reach(self) -> int:
        """Cells from a cell to the edge of what it is classified from."""
        return int(2 ** len(self.layers) - 1)

    def forward(self, planes: Tensor) -> Tensor:
        """The classes of every cell."""
        return self._through(functional.pad(planes, (self.reach,) * 4), stride=1, widening=2)

    def of_patches(self, patches: Tensor) -> Tensor:
        """Logits (N, K) of the cells in the middle of patches (N, C, P, P), P = 2 reach + 1."""
        return self._through(patches, stride=2, widening=1).flatten(1)

    def _through(self, x: Tensor, stride: int, widening: int) -> Tensor:
        """Layer after layer, each with the dilation of the one before times `widening`."""
        for k, layer in enumerate(self.layers):
            convolution: Any = layer
            x = functional.relu(x) if k else x
            x = functional.conv2d(x, convolution.weight, convolution.bias, stride, dilation=widening**k)
        return x

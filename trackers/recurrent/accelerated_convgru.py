"""The dilated ConvGRU for training on a CUDA device: the same function and gradient, in few kernels.

The gates are one compiled kernel a layer and step, and windows of unlike cell size and period are one batch: what their
resolutions add to the biases is computed once a sequence.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import torch
from torch import Tensor

from gridtrack.trackers.recurrent.dilated_convgru import DilatedConvGRULayer, convgru_gates
from gridtrack.trackers.recurrent.training_convgru import TrainingConvGRU


class AcceleratedConvGRU(TrainingConvGRU):
    """A RecurrentNetwork with gradients on a CUDA device: `network`, whose cells must have gates."""

    def biases_of(self, layer: DilatedConvGRULayer) -> Any:
        """Three biases (C, M, M), (C, 1, 1) or, where the items of a batch have a resolution each, (B, C, 1, 1)."""
        return layer.gate_biases()

    def gates(self, x: Tensor | None, h_conv: Tensor, biases: Any, h: Tensor) -> tuple[Tensor, Tensor | None]:
        """`convgru_gates` in one kernel: h' in float32, and in the precision of the convolutions."""
        new: tuple[Tensor, Tensor] = _compiled_gates()(x, h_conv, biases, h)
        return new


def _gates(x: Tensor | None, h_conv: Tensor, biases: tuple[Tensor, ...], h: Tensor) -> tuple[Tensor, Tensor]:
    new = convgru_gates(x, h_conv, biases, h)
    return new, new.to(h_conv.dtype)


@cache
def _compiled_gates() -> Any:
    """Compiled at the first use: it takes a compiler some seconds."""
    return torch.compile(_gates, dynamic=False)

"""The dilated ConvGRU for training on a CUDA device: the same function and gradient, in few kernels.

The gates are one compiled kernel a layer and step, and windows of unlike cell size and period are one batch: what their
resolutions add to the biases is computed once a sequence.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import conv2d

from gridtrack.trackers.recurrent.dilated_convgru import DilatedConvGRU, DilatedConvGRULayer, convgru_gates


class LayerState(NamedTuple):
    """One layer in one sequence: its parameters, and the state h (B, C, M, M), float32 and in convolution precision."""

    biases: tuple[Tensor, ...]
    input_weight: Tensor
    state_weight: Tensor
    h: Tensor
    rounded: Tensor


AcceleratedState = tuple[LayerState, ...]


class AcceleratedConvGRU:
    """A RecurrentNetwork with gradients on a CUDA device: `network`, whose cells must have gates."""

    def __init__(self, network: DilatedConvGRU) -> None:
        self._network = network
        self._layers: list[Any] = list(network.layers)
        self.occupancy, self.semantics = network.occupancy, network.semantics

    def initial(self, batch: int) -> AcceleratedState:
        """h_0 = 0 in every layer, at the first frame of a sequence."""
        (zero, *_) = self._network.initial(batch)
        kind = zero.device.type
        precision = torch.get_autocast_dtype(kind) if torch.is_autocast_enabled(kind) else torch.float32

        def initial_layer(layer: DilatedConvGRULayer) -> LayerState:
            weights = (layer.input_weight.to(precision), layer.state_weight.to(precision))
            return LayerState(layer.gate_biases(), *weights, zero, zero.to(precision))

        return tuple(initial_layer(layer) for layer in self._layers)

    def step(self, x: Tensor | None, state: AcceleratedState) -> AcceleratedState:
        """h_t of all layers: each layer's new state is the next one's input."""
        new = []
        for layer, previous in zip(self._layers, state, strict=True):
            x_conv = None if x is None else _convolved(x, previous.input_weight, layer.dilation)
            h_conv = _convolved(previous.rounded, previous.state_weight, layer.dilation)
            h, x = _compiled_gates()(x_conv, h_conv, previous.biases, previous.h)
            new.append(previous._replace(h=h, rounded=x))
        return tuple(new)

    def features(self, state: AcceleratedState) -> Tensor:
        """The last layer's state."""
        return state[-1].rounded


def _gates(x: Tensor | None, h_conv: Tensor, biases: tuple[Tensor, ...], h: Tensor) -> tuple[Tensor, Tensor]:
    """`convgru_gates`: h' in float32, and in the precision of `h_conv`."""
    new = convgru_gates(x, h_conv, biases, h)
    return new, new.to(h_conv.dtype)


@cache
def _compiled_gates() -> Any:
    """Compiled at the first use: it takes a compiler some seconds."""
    return torch.compile(_gates, dynamic=False)


def _convolved(x: Tensor, weight: Tensor, dilation: int) -> Tensor:
    return conv2d(x, weight, padding=dilation, dilation=dilation)

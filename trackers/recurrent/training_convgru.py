"""The dilated ConvGRU for training on a processor: the same function and gradient, with less memory traffic.

The state is kept in float32 and in the precision of the convolutions, so that no step converts it; the gates are one
pass over memory (differentiable.py).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import conv2d

from gridtrack.trackers.recurrent.differentiable import StaticMemory, differentiable_gates
from gridtrack.trackers.recurrent.dilated_convgru import DilatedConvGRU, DilatedConvGRULayer


class LayerState(NamedTuple):
    """One layer in one sequence: its parameters, and the state h (B, C, M, M), float32 and in convolution precision."""

    biases: Any
    input_weight: Tensor
    state_weight: Tensor
    h: Tensor
    rounded: Tensor


TrainingState = tuple[LayerState, ...]


class TrainingConvGRU:
    """A RecurrentNetwork with gradients on a processor: `network`, whose cells must have gates."""

    def __init__(self, network: DilatedConvGRU) -> None:
        self._network = network
        self._layers: list[Any] = list(network.layers)
        self.occupancy, self.semantics = network.occupancy, network.semantics

    def initial(self, batch: int) -> TrainingState:
        """h_0 = 0 in every layer, at the first frame of a sequence."""
        (zero, *_) = self._network.initial(batch)
        device = zero.device.type
        precision = torch.get_autocast_dtype(device) if torch.is_autocast_enabled(device) else torch.float32

        def initial_layer(layer: DilatedConvGRULayer) -> LayerState:
            weights = (layer.input_weight.to(precision), layer.state_weight.to(precision))
            return LayerState(self.biases_of(layer), *weights, zero, zero.to(precision))

        return tuple(initial_layer(layer) for layer in self._layers)

    def step(self, x: Tensor | None, state: TrainingState) -> TrainingState:
        """h_t of all layers: each layer's new state is the next one's input."""
        new = []
        for layer, previous in zip(self._layers, state, strict=True):
            x_conv = None if x is None else _convolved(x, previous.input_weight, layer.dilation)
            h_conv = _convolved(previous.rounded, previous.state_weight, layer.dilation)
            h, rounded = self.gates(x_conv, h_conv, previous.biases, previous.h)
            x = h if rounded is None else rounded
            new.append(previous._replace(h=h, rounded=x))
        return tuple(new)

    def biases_of(self, layer: DilatedConvGRULayer) -> Any:
        """The biases of a layer in one sequence, as `gates` takes them."""
        return StaticMemory(layer.gate_biases(), self._network.size)

    def gates(self, x: Tensor | None, h_conv: Tensor, biases: Any, h: Tensor) -> tuple[Tensor, Tensor | None]:
        """`convgru_gates`: h' in float32, and in the precision of the convolutions where that is another."""
        return differentiable_gates(x, h_conv, biases, h)

    def features(self, state: TrainingState) -> Tensor:
        """The last layer's state."""
        return state[-1].rounded


def _convolved(x: Tensor, weight: Tensor, dilation: int) -> Tensor:
    return conv2d(x, weight, padding=dilation, dilation=dilation)

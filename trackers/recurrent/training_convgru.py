"""The dilated ConvGRU as it is trained on a processor: what the network computes, with less traffic to memory.

The state is carried in float32 and once more in the precision of the convolutions, so that nothing is converted; the
gates are one pass over memory (differentiable.py).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import conv2d

from gridtrack.trackers.recurrent.differentiable import StaticMemory, differentiable_gates
from gridtrack.trackers.recurrent.dilated_convgru import DilatedConvGRU, DilatedConvGRULayer


class LayerState(NamedTuple):
    """One layer in one sequence: what stays, and the state h (B, C, M, M), float32 and as the convolutions read it."""

    memory: StaticMemory
    input_weight: Tensor
    state_weight: Tensor
    h: Tensor
    rounded: Tensor


TrainingState = tuple[LayerState, ...]


class TrainingConvGRU:
    """A RecurrentNetwork with gradients, on a processor: `network`, whose cells have gates."""

    def __init__(self, network: DilatedConvGRU) -> None:
        self._network = network
        self._layers: list[Any] = list(network.layers)
        self.occupancy, self.semantics = network.occupancy, network.semantics

    def initial(self, batch: int) -> TrainingState:
        """h_0 = 0 in every layer, at the beginning of a sequence."""
        precision = torch.get_autocast_dtype("cpu") if torch.is_autocast_enabled("cpu") else torch.float32
        (zero, *_) = self._network.initial(batch)

        def begin(layer: DilatedConvGRULayer) -> LayerState:
            memory = StaticMemory(tuple(layer.biases[gate] for gate in layer.gates), self._network.size)
            weights = (layer.input_weight.to(precision), layer.state_weight.to(precision))
            return LayerState(memory, *weights, zero, zero.to(precision))

        return tuple(begin(layer) for layer in self._layers)

    def step(self, x: Tensor | None, state: TrainingState) -> TrainingState:
        """h_t of all layers: each layer's new state is the next one's input."""
        new = []
        for layer, before in zip(self._layers, state, strict=True):
            x_conv = None if x is None else _convolved(x, before.input_weight, layer.dilation)
            h_conv = _convolved(before.rounded, before.state_weight, layer.dilation)
            h, rounded = differentiable_gates(x_conv, h_conv, before.memory, before.h)
            x = h if rounded is None else rounded
            new.append(before._replace(h=h, rounded=x))
        return tuple(new)

    def features(self, state: TrainingState) -> Tensor:
        """The last layer's state."""
        return state[-1].rounded


def _convolved(x: Tensor, weight: Tensor, dilation: int) -> Tensor:
    return conv2d(x, weight, padding=dilation, dilation=dilation)

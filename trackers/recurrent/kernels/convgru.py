"""The dilated ConvGRU for inference on a processor, and for training; its cells must have gates.

Inference: convolutions and gates (gates.py) for one band of rows after the other, so that the sums stay in the cache.
Only the new states are allocated. In bfloat16 the convolutions are the direct ones of oneDNN: they are faster on a
processor with instructions for bfloat16, and Winograd's sums would lose too many digits.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any, ClassVar, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import conv2d

from gridtrack.common.grid import Shift, rolled
from gridtrack.trackers.recurrent.dilated_convgru import (
    DilatedConvGRU,
    DilatedConvGRULayer,
    LayerStates,
    convgru_gates,
)
from gridtrack.trackers.recurrent.inference import InferenceNetwork, is_map
from gridtrack.trackers.recurrent.kernels.convolutions import (
    BFloat16Convolution,
    OneOutputConvolution,
    WinogradConvolution,
)
from gridtrack.trackers.recurrent.kernels.gates import StaticMemory, differentiable_gates, fused_gates
from gridtrack.trackers.recurrent.network import Float32Array, Recurrence, as_cells, as_tensor


class InferenceConvGRU(InferenceNetwork):
    """The network for inference in float32."""

    convolution: ClassVar[type[WinogradConvolution | BFloat16Convolution]] = WinogradConvolution

    def __init__(self, network: DilatedConvGRU) -> None:
        super().__init__(network)
        self._has_map = any(is_map(bias) for bias in network.maps().values())
        self._map_cells = np.zeros((network.size, network.size), np.int32)
        self.anchor(Shift())
        first, *others = network.layers
        self._first, self._first_without_input = self._layer(first), self._layer(first, with_input=False)
        self._others = [self._layer(layer) for layer in others]
        self._decode = OneOutputConvolution(network.decode_occupancy, network.size)

    def _layer(self, layer: Any, *, with_input: bool = True) -> InferenceLayer:
        return InferenceLayer(layer, self._map_cells, self.convolution, with_input=with_input)

    def step(self, x: Tensor | None, state: LayerStates) -> LayerStates:
        """h_t of all layers: each layer's new state is the next one's input. An empty input is not convolved."""
        h, *others = (as_cells(each) for each in state)
        new = [self._first_without_input(h) if x is None else self._first(h, as_cells(x))]
        for layer, h in zip(self._others, others, strict=True):
            new.append(layer(h, new[-1]))
        return tuple(as_tensor(each) for each in new)

    def occupancy(self, features: Tensor) -> Tensor:
        """Logits of P(occupied), (1, M, M)."""
        return self._decode(features)

    def anchor(self, shift: Shift) -> None:
        """Each cell takes the biases of its place; outside the maps these are their means."""
        if self._has_map:
            size = len(self._map_cells)
            cells = np.arange(size**2, dtype=np.int32).reshape(size, size)
            self._map_cells[:] = rolled(cells, shift, size**2)


class BFloat16ConvGRU(InferenceConvGRU):
    """The network for inference with the convolutions of its layers in bfloat16; the rest is float32."""

    convolution = BFloat16Convolution


class InferenceLayer:
    """One recurrent layer: h (M, M, C) and, `with_input`, x (M, M, I) -> h'.

    `map_cells` (M, M) int32: the row of each cell in the biases of the maps.
    """

    def __init__(
        self,
        layer: DilatedConvGRULayer,
        map_cells: NDArray[np.int32],
        convolution: type[WinogradConvolution | BFloat16Convolution],
        *,
        with_input: bool,
    ) -> None:
        channels, inputs = layer.state_weight.shape[1], layer.input_weight.shape[1]
        weight = weight_of_both(layer) if with_input else layer.state_weight.detach()
        images = (channels, inputs) if with_input else (channels,)
        self._convolution = convolution(weight, images, len(map_cells), layer.dilation)
        self._gates = fused_gates(channels, with_input=with_input, bfloat16=convolution is BFloat16Convolution)
        self._map_cells = map_cells
        self._biases = bias_rows([bias.detach() for bias in layer.gate_biases()])

    def __call__(self, h: Float32Array, *x: Float32Array) -> Float32Array:
        """h' (M, M, C)."""
        new = np.empty_like(h)
        for rows, sums in self._convolution.bands((h, *x)):
            self._gates(sums, rows.start, rows.step, self._map_cells, *self._biases, h, new)
        return new


def weight_of_both(layer: DilatedConvGRULayer) -> Tensor:
    """Filters (4C, C + I, 3, 3) of h and x: keep gate, reset gate, candidate from h, candidate from x.

    The candidate has two outputs because the reset gate multiplies only that of h.
    """
    h, x = layer.state_weight.detach(), layer.input_weight.detach()
    channels = h.shape[1]
    h_gates, h_candidate = h[: 2 * channels], h[2 * channels :]
    x_gates, x_candidate = x[: 2 * channels], x[2 * channels :]
    rows = (
        (h_gates, x_gates),
        (h_candidate, torch.zeros_like(x_candidate)),
        (torch.zeros_like(h_candidate), x_candidate),
    )
    return torch.cat([torch.cat(row, dim=1) for row in rows])


def bias_rows(biases: Sequence[Tensor]) -> list[Float32Array]:
    """Biases (C, M, M) or (C, 1, 1) as rows (R, C): one for each cell, then their mean, for cells outside the map.

    Without a map there is one row.
    """
    shape = max((bias.shape for bias in biases), key=lambda each: each.numel())
    rows = [bias.expand(shape).flatten(1).T for bias in biases]
    if len(rows[0]) > 1:
        rows = [torch.cat([each, each.mean(dim=0, keepdim=True)]) for each in rows]
    return [each.contiguous().numpy() for each in rows]


class LayerState(NamedTuple):
    """One layer in one sequence: its parameters, and the state h (B, C, M, M), float32 and in convolution precision."""

    biases: Any
    input_weight: Tensor
    state_weight: Tensor
    h: Tensor
    rounded: Tensor


TrainingState = tuple[LayerState, ...]


class TrainingConvGRU(Recurrence):
    """The network with its gradient, on a processor.

    The state is kept in float32 and in the precision of the convolutions, so that no step converts it.
    """

    def __init__(self, network: DilatedConvGRU) -> None:
        self._network = network

    def initial(self, batch: int) -> TrainingState:
        """h_0 = 0 in every layer, at the first frame of a sequence."""
        (zero, *_) = self._network.initial(batch)
        device = zero.device.type
        precision = torch.get_autocast_dtype(device) if torch.is_autocast_enabled(device) else torch.float32

        def initial_layer(layer: Any) -> LayerState:
            weights = (layer.input_weight.to(precision), layer.state_weight.to(precision))
            return LayerState(self.biases_of(layer), *weights, zero, zero.to(precision))

        return tuple(initial_layer(layer) for layer in self._network.layers)

    def step(self, x: Tensor | None, state: TrainingState) -> TrainingState:
        """h_t of all layers: each layer's new state is the next one's input."""
        new = []
        for layer, previous in zip(self._network.layers, state, strict=True):
            dilation: Any = layer.dilation
            x_conv = None if x is None else _convolved(x, previous.input_weight, dilation)
            h_conv = _convolved(previous.rounded, previous.state_weight, dilation)
            h, rounded = self.gates(x_conv, h_conv, previous.biases, previous.h)
            x = h if rounded is None else rounded
            new.append(previous._replace(h=h, rounded=x))
        return tuple(new)

    def biases_of(self, layer: DilatedConvGRULayer) -> Any:
        """The biases of a layer in one sequence, as `gates` takes them."""
        return StaticMemory(layer.gate_biases(), self._network.size)

    def gates(self, x: Tensor | None, h_conv: Tensor, biases: Any, h: Tensor) -> tuple[Tensor, Tensor | None]:
        """`convgru_gates`: h' in float32, and in the precision of the convolutions if that differs."""
        return differentiable_gates(x, h_conv, biases, h)

    def features(self, state: TrainingState) -> Tensor:
        """The last layer's state."""
        return state[-1].rounded

    def occupancy(self, features: Tensor) -> Tensor:
        """Logits of P(occupied), (B, M, M)."""
        return self._network.occupancy(features)


class CompiledConvGRU(TrainingConvGRU):
    """The network with its gradient, on a CUDA device: the gates are one compiled kernel a layer and step."""

    mixed_resolutions = True

    def biases_of(self, layer: DilatedConvGRULayer) -> Any:
        """Three biases (C, M, M), (C, 1, 1), or (B, C, 1, 1) if the windows of a batch differ in resolution."""
        return layer.gate_biases()

    def gates(self, x: Tensor | None, h_conv: Tensor, biases: Any, h: Tensor) -> tuple[Tensor, Tensor | None]:
        """`convgru_gates` in one kernel: h' in float32, and in the precision of the convolutions."""
        new: tuple[Tensor, Tensor] = compiled_gates()(x, h_conv, biases, h)
        return new


def _convolved(x: Tensor, weight: Tensor, dilation: int) -> Tensor:
    return conv2d(x, weight, padding=dilation, dilation=dilation)


def plain_gates(x: Tensor | None, h_conv: Tensor, biases: tuple[Tensor, ...], h: Tensor) -> tuple[Tensor, Tensor]:
    """h' in float32, and in the precision of the convolutions."""
    new = convgru_gates(x, h_conv, biases, h)
    return new, new.to(h_conv.dtype)


@cache
def compiled_gates() -> Any:
    """`plain_gates`, compiled at the first use: it takes a compiler some seconds."""
    return torch.compile(plain_gates, dynamic=False)


INFERENCE: dict[str, type[InferenceConvGRU]] = {"float32": InferenceConvGRU, "bfloat16": BFloat16ConvGRU}
TRAINING: dict[str, type[TrainingConvGRU]] = {"cpu": TrainingConvGRU, "cuda": CompiledConvGRU}

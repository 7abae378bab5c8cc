"""Fast inference on a processor: the same functions as the trained networks, for one stream.

Dilated ConvGRU: Winograd convolutions (winograd.py) and gates in one pass over memory (fused.py), both for one band of
rows after the other, so that the sums stay in the cache. Only the new states are allocated. In bfloat16 the
convolutions are the direct ones of oneDNN: they are faster where the processor has instructions for bfloat16, and
Winograd's sums would lose too many digits.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn.functional import conv2d

from gridtrack.common.grid import Shift, rolled
from gridtrack.trackers.recurrent.deep_tracking_rnn import DeepTrackingRNN
from gridtrack.trackers.recurrent.dilated_convgru import DilatedConvGRU, DilatedConvGRULayer
from gridtrack.trackers.recurrent.fused import fused_gates, kernel
from gridtrack.trackers.recurrent.network import Float32Array, LatentState, as_cells, as_tensor
from gridtrack.trackers.recurrent.unseen import UnseenStates
from gridtrack.trackers.recurrent.winograd import WinogradConvolution


class InferenceConvGRU:
    """An InferenceNetwork for batches of one, without gradients: the trained `network`, whose cells must have gates.

    With `bfloat16` the convolutions of input and state are bfloat16; states, gates and decoders are float32.
    """

    def __init__(self, network: DilatedConvGRU, *, bfloat16: bool = False) -> None:
        self.size, self.channels = network.size, network.channels
        layers: list[Any] = list(network.layers)
        self._has_map = any(is_map(bias) for layer in layers for bias in layer.biases.values())
        self._map_cells = np.zeros((self.size, self.size), np.int32)
        self.anchor(Shift())
        self.unseen = UnseenStates(network)

        def inference_layer(layer: DilatedConvGRULayer, *, with_input: bool = True) -> InferenceLayer:
            return InferenceLayer(layer, self._map_cells, with_input=with_input, bfloat16=bfloat16)

        first, *others = layers
        self._first, self._first_without_input = inference_layer(first), inference_layer(first, with_input=False)
        self._others = [inference_layer(layer) for layer in others]
        self._decode_occupancy = OccupancyDecoder(network.decode_occupancy, self.size)
        self.semantics = network.semantics

    def initial(self, batch: int) -> LatentState:
        """h_0 = 0 in every layer."""
        assert batch == 1
        zero = np.zeros((self.size, self.size, self.channels), np.float32)
        return (as_tensor(zero),) * (1 + len(self._others))

    def step(self, x: Tensor | None, state: LatentState) -> LatentState:
        """h_t of all layers: each layer's new state is the next one's input. An empty input is not convolved."""
        h, *others = (as_cells(each) for each in state)
        new = [self._first_without_input(h) if x is None else self._first(h, as_cells(x))]
        for layer, h in zip(self._others, others, strict=True):
            new.append(layer(h, new[-1]))
        return tuple(as_tensor(each) for each in new)

    def current(self, state: LatentState) -> LatentState:
        """The state itself."""
        return state

    def features(self, state: LatentState) -> Tensor:
        """The last layer's state."""
        return state[-1]

    def occupancy(self, features: Tensor) -> Tensor:
        """Logits of P(occupied), (1, M, M)."""
        return self._decode_occupancy(features)

    def anchor(self, shift: Shift) -> None:
        """Each cell takes the biases of its place; outside the maps these are their means."""
        if self._has_map:
            cells = np.arange(self.size**2, dtype=np.int32).reshape(self.size, self.size)
            self._map_cells[:] = rolled(cells, shift, cells.size)


class InferencePlainConvGRU:
    """An InferenceNetwork: the trained `network`, whose cells have no gates, with its maps where the window lies."""

    def __init__(self, network: DilatedConvGRU) -> None:
        self.initial, self.step, self.features = network.initial, network.step, network.features
        self.occupancy, self.semantics = network.occupancy, network.semantics
        self.unseen = UnseenStates(network)
        layers: list[Any] = list(network.layers)
        biases = [bias.detach() for layer in layers for bias in layer.biases.values() if is_map(bias)]
        self._maps = [(bias, bias.clone().numpy(), bias.mean(dim=(1, 2), keepdim=True).numpy()) for bias in biases]

    def current(self, state: LatentState) -> LatentState:
        """The state itself."""
        return state

    def anchor(self, shift: Shift) -> None:
        """Each cell takes the bias of its place; outside the map this is its mean."""
        for placed, learned, mean in self._maps:
            placed.copy_(torch.from_numpy(rolled(learned, shift, mean)))


class InferenceRNN:
    """An InferenceNetwork: the trained `network`, whose convolution of the empty input is computed once."""

    def __init__(self, network: DeepTrackingRNN) -> None:
        self._network = network
        self.initial, self.features = network.initial, network.features
        self.occupancy, self.semantics = OccupancyDecoder(network.decode, network.size), network.semantics
        self.unseen = UnseenStates(network)
        with torch.no_grad():
            self._empty, self._state_weight = network.empty_input_sums(), network.state_weight()

    def step(self, x: Tensor | None, state: LatentState) -> LatentState:
        """h_t; an empty input is not convolved."""
        if x is not None:
            return self._network.step(x, state)
        return (torch.sigmoid(self._empty + conv2d(state[0], self._state_weight, padding="same")),)

    def current(self, state: LatentState) -> LatentState:
        """The state itself."""
        return state

    def anchor(self, shift: Shift) -> None:
        """The network has no map."""


class InferenceLayer:
    """One recurrent layer: h (M, M, C) and, `with_input`, x (M, M, I) -> h'.

    `map_cells` (M, M) int32: the row of each cell in the biases of the maps.
    """

    def __init__(
        self, layer: DilatedConvGRULayer, map_cells: NDArray[np.int32], *, with_input: bool, bfloat16: bool
    ) -> None:
        channels, inputs = layer.state_weight.shape[1], layer.input_weight.shape[1]
        weight = weight_of_both(layer) if with_input else layer.state_weight.detach()
        images = (channels, inputs) if with_input else (channels,)
        convolution = BFloat16Convolution if bfloat16 else WinogradConvolution
        self._convolution = convolution(weight, images, len(map_cells), layer.dilation)
        self._gates = fused_gates(channels, with_input=with_input, bfloat16=bfloat16)
        biases = [bias.detach() for bias in layer.gate_biases()]
        self._map_cells, self._biases = map_cells, bias_rows(biases)

    def __call__(self, h: Float32Array, *x: Float32Array) -> Float32Array:
        """h' (M, M, C)."""
        new = np.empty_like(h)
        for rows, sums in self._convolution.bands((h, *x)):
            self._gates(sums, rows.start, rows.step, self._map_cells, *self._biases, h, new)
        return new


class BFloat16Convolution:
    """The sums of WinogradConvolution, as direct convolutions in bfloat16 and one band."""

    def __init__(self, weight: Tensor, channels: Sequence[int], size: int, dilation: int) -> None:
        self._weight = weight.bfloat16().contiguous(memory_format=torch.channels_last)
        self._dilation = dilation
        self._image = torch.zeros(1, size, size, sum(channels), dtype=torch.bfloat16).permute(0, 3, 1, 2)
        self._parts = torch.split(self._image, list(channels), dim=1)

    def bands(self, images: Sequence[Float32Array]) -> Iterator[tuple[range, Float32Array]]:
        """All rows, and their sums (M, M, N) as bits in uint16."""
        for part, image in zip(self._parts, images, strict=True):
            part.copy_(as_tensor(image))
        sums = conv2d(self._image, self._weight, padding=self._dilation, dilation=self._dilation)
        cells = as_cells(sums.view(torch.uint16))
        yield range(len(cells)), cells


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


def is_map(bias: Tensor) -> bool:
    """Whether a bias has a value for each cell."""
    return bias.shape[1:].numel() > 1


def bias_rows(biases: Sequence[Tensor]) -> list[Float32Array]:
    """Biases (C, M, M) or (C, 1, 1) as rows (R, C): a row for each cell and one for the cells outside, their mean.

    One row for all cells where no bias has a value for each cell.
    """
    shape = max((bias.shape for bias in biases), key=lambda each: each.numel())
    rows = [bias.expand(shape).flatten(1).T for bias in biases]
    if len(rows[0]) > 1:
        rows = [torch.cat([each, each.mean(dim=0, keepdim=True)]) for each in rows]
    return [each.contiguous().numpy() for each in rows]


class OccupancyDecoder:
    """A convolution with one output: a matrix product for all its taps, then the sum of their shifted maps."""

    def __init__(self, convolution: nn.Conv2d, size: int) -> None:
        (weight,) = convolution.weight.detach()
        self._taps = weight.flatten(1).T.contiguous()
        self._bias = float(convolution.bias.detach())  # type: ignore[union-attr]
        self._maps = torch.zeros(len(self._taps), size * size)
        self._as_grid = self._maps.view(*weight.shape[1:], size, size).numpy()

    def __call__(self, features: Tensor) -> Tensor:
        """(1, C, M, M) -> (1, M, M)."""
        torch.mm(self._taps, features[0].flatten(1), out=self._maps)
        logits = torch.empty(features.shape[2:])
        add_shifted(self._as_grid, self._bias, logits.numpy())
        return logits[None]


@kernel("void(float32[:,:,:,::1], float32, float32[:,::1])")
def add_shifted(maps, bias, out):  # type: ignore[no-untyped-def]
    """out[r, x] = bias + sum over i, j = 0..2k of maps[i, j, r + i - k, x + j - k], zero outside the grid."""
    size, side = out.shape[0], maps.shape[0]
    reach = side // 2
    for r in range(size):
        out[r] = bias
        for i in range(max(0, reach - r), min(side, size + reach - r)):
            for j in range(side):
                seen = maps[i, j, r + i - reach]
                if j < reach:
                    out[r, reach - j :] += seen[: max(0, size - reach + j)]
                else:
                    out[r, : size - j + reach] += seen[j - reach :]

"""The dilated ConvGRU with static memory and two decoders (Ondruska, Dequaire, Wang, Posner, 2016).

    f = sigmoid(Wxz*x + Whz*h + bz)          keep gate
    r = sigmoid(Wxr*x + Whr*h + br)          reset gate
    c = tanh(Wxh*x + r o (Whh*h) + bh)       candidate
    h' = f o h + (1 - f) o c

`*` is a 3x3 convolution with dilation 2^(k-1) in layer k, `o` is element-wise. The biases bz, br, bh have a value for
each channel *and each cell*: they are the static memory, in which the network learns the static structure of a site.

The reset gate multiplies after the hidden convolution, so the three gates share one convolution of the state and one
of the input. With 4 classes the network has 1,476,149 parameters, 1,440,000 of them static memory; the 1,010,193 in the
paper's text do not follow from its equations.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor, nn
from torch.nn.functional import conv2d

from gridtrack.trackers.recurrent.network import DecodedLayers, RecurrentNetwork, ResolutionShift
from gridtrack.trackers.recurrent.settings import DilatedConvGRUSettings
from gridtrack.trackers.training.cell_classifier import CellClassifier


def convgru_gates(x: Tensor | None, h_conv: Tensor, biases: tuple[Tensor, ...], h: Tensor) -> Tensor:
    """The element-wise half of the cell, in float32.

    `x` and `h_conv` (B, 3C, M, M) are the convolutions of input and state, gates in the order of GATES; `x` is None
    if the input is empty. `biases`: three of (C, M, M) or (C, 1, 1). `h` (B, C, M, M). Returns h'.
    """
    keep, reset, candidate = biases
    if x is not None:
        keep_x, reset_x, candidate_x = x.chunk(3, dim=1)
        keep, reset, candidate = keep + keep_x, reset + reset_x, candidate + candidate_x
    keep_h, reset_h, candidate_h = h_conv.chunk(3, dim=1)
    f = torch.sigmoid(keep + keep_h)
    r = torch.sigmoid(reset + reset_h)
    c = torch.tanh(candidate + r * candidate_h)
    return c + f * (h - c)


def plain_cell(x: Tensor | None, h_conv: Tensor, biases: tuple[Tensor, ...], h: Tensor) -> Tensor:
    """The element-wise half of a cell without gates: `x` and `h_conv` (B, C, M, M), one bias; `h` is not used."""
    (candidate,) = biases
    return torch.tanh(candidate + h_conv if x is None else candidate + h_conv + x)


class DilatedConvGRULayer(nn.Module):
    """One recurrent layer: x (B, I, M, M) or None, h (B, C, M, M) -> h'."""

    def __init__(self, inputs: int, size: int, dilation: int, settings: DilatedConvGRUSettings) -> None:
        super().__init__()
        channels, outputs = settings.channels, len(settings.gates) * settings.channels
        self.gates, self.dilation = settings.gates, dilation
        self.input_weight = nn.Parameter(torch.empty(outputs, inputs, 3, 3))
        self.state_weight = nn.Parameter(torch.empty(outputs, channels, 3, 3))
        self._initialise()
        self.biases = nn.ParameterDict(
            {
                gate: torch.zeros(size, size, channels).permute(2, 0, 1)
                if gate in settings.static_gates
                else torch.zeros(channels, 1, 1)
                for gate in settings.gates
            }
        )
        self.shifts = nn.ModuleDict(
            {gate: ResolutionShift(channels) for gate in settings.gates if settings.resolution_input}
        )
        self.cell: Callable[..., Tensor] = convgru_gates if settings.cell == "gru" else plain_cell

    @torch.no_grad()
    def _initialise(self) -> None:
        """Small noise, and an identity path for the input through every candidate (Zagoruyko and Komodakis, 2017).

        With noise alone the input reaches the decoder only after hundreds of updates. In the first layer the path
        carries the occupied plane, with both signs.
        """
        for weight in (self.input_weight, self.state_weight):
            nn.init.normal_(weight, std=0.3 * (weight.shape[1] * 9) ** -0.5)
        channels, inputs = self.state_weight.shape[1], self.input_weight.shape[1]
        candidate = self.input_weight[-channels:, :, 1, 1]
        if inputs == channels:
            candidate += torch.eye(channels)
        else:
            candidate[:, -1] += 2.0 * (-1.0) ** torch.arange(channels)

    def forward(self, x: Tensor | None, h: Tensor) -> Tensor:
        """h' from x and h."""
        x_conv = None if x is None else self._convolve(x, self.input_weight)
        return self.cell(x_conv, self._convolve(h, self.state_weight), self.gate_biases(), h)

    def gate_biases(self) -> tuple[Tensor, ...]:
        """The bias of each gate, (C, M, M) or (C, 1, 1), at the resolution of the grids."""
        biases = ((gate, self.biases[gate]) for gate in self.gates)
        return tuple(self.shifts[gate](bias) if gate in self.shifts else bias for gate, bias in biases)

    def _convolve(self, x: Tensor, weight: Tensor) -> Tensor:
        return conv2d(x, weight, padding=self.dilation, dilation=self.dilation)


LayerStates = tuple[Tensor, ...]
"""h (B, C, M, M) of each layer."""


class DilatedConvGRU(RecurrentNetwork):
    """The network: layers at full resolution, dilation doubling from layer to layer, no pooling.

    Its receptive field is (2^(K+1) - 1)^2 cells a step for K layers.
    """

    def __init__(
        self,
        size: int,
        settings: DilatedConvGRUSettings,
        classes: int = 0,
        class_hidden: Sequence[int] = (),
        decoded_layers: DecodedLayers = "last",
    ) -> None:
        """`class_hidden`: channels of the class decoder's layers but the last; () is the paper's linear decoder.

        `decoded_layers`: the layers that it reads.
        """
        super().__init__(size)
        self.channels = settings.channels
        self.layers = nn.ModuleList(
            DilatedConvGRULayer(2 if k == 0 else settings.channels, size, 2**k if settings.dilated else 1, settings)
            for k in range(settings.layers)
        )
        self.decode_occupancy = nn.Conv2d(settings.channels, 1, 3, padding=1)
        nn.init.normal_(self.decode_occupancy.weight, std=0.3)
        self.decoded_layers = decoded_layers
        planes = settings.channels * (settings.layers if decoded_layers == "all" else 1)
        if classes:
            self.decode_semantics = CellClassifier(planes, class_hidden, classes)

    def initial(self, batch: int) -> LayerStates:
        """h_0 = 0 in every layer."""
        zero = self.decode_occupancy.weight.new_zeros((batch, self.channels, self.size, self.size))
        return (zero.contiguous(memory_format=torch.channels_last),) * len(self.layers)

    def step(self, x: Tensor | None, state: LayerStates) -> LayerStates:
        """h_t of all layers: each layer's new state is the next one's input."""
        states = []
        for layer, h in zip(self.layers, state, strict=True):
            x = layer(x, h)
            states.append(x)
        return tuple(states)

    def features(self, state: LayerStates) -> Tensor:
        """The last layer's state."""
        return state[-1]

    @property
    def decoder(self) -> nn.Conv2d:
        """The convolution `decode_occupancy`."""
        return self.decode_occupancy

    def class_planes(self, state: LayerStates, layers: DecodedLayers) -> Tensor:
        """The states of the last or of all layers, (B, C, M, M) or (B, layers x C, M, M)."""
        return state[-1] if layers == "last" else torch.cat(state, dim=1)

"""The tracker `conv-lstm`: a convolutional LSTM (Shi et al., NeurIPS 2015), the twin of the dilated ConvGRU.

    i, f, o = sigmoid(Wx*x + Wh*h + b)      input, forget and output gates, each with its own weights
    g = tanh(Wxg*x + Whg*h + bg)            candidate
    c' = f o c + i o g      h' = o o tanh(c')

`*` is a 3x3 convolution, `o` is element-wise. Three layers of 16 channels at full resolution have 47,569 parameters.
The paper's peepholes, weights of c in the gates with a value for each cell, are left out: they would bind the network
to one place and grid.
"""

from __future__ import annotations

from typing import Any, ClassVar, NamedTuple

import torch
from pydantic import Field
from torch import Tensor, nn
from torch.nn.functional import conv2d

from gridtrack.trackers.recurrent.network import RecurrentNetwork, ResolutionShift
from gridtrack.trackers.recurrent.recurrent_tracker import RecurrentTracker
from gridtrack.trackers.recurrent.settings import ResolutionSettings, TrainingSettings

START_OF_GATES = {"input": 0.0, "forget": 1.0, "output": 1.0, "candidate": 0.0}
"""The biases before training, in the order of the channels. An untrained layer keeps and shows 0.73 of its cells."""


class ConvLSTMSettings(ResolutionSettings):
    """The shape of the ConvLSTM."""

    layers: int = Field(3, ge=1, le=8)
    channels: int = Field(16, ge=1, le=256)


class ConvLSTMOptions(ConvLSTMSettings, TrainingSettings):
    """Shape and training of the ConvLSTM."""


class LSTMState(NamedTuple):
    """The hidden state and the cells of a layer, each (B, C, M, M)."""

    h: Tensor
    c: Tensor


def no_state(like: Tensor, batch: int, channels: int, size: int) -> LSTMState:
    """h_0 = c_0 = 0, of the type and on the device of `like`."""
    zero = like.new_zeros((batch, channels, size, size)).contiguous(memory_format=torch.channels_last)
    return LSTMState(zero, zero)


class ConvLSTMLayer(nn.Module):
    """One layer: x (B, I, M, M) or None, and its state -> its new state."""

    def __init__(self, inputs: int, channels: int, *, resolution_input: bool) -> None:
        super().__init__()
        self.inputs, self.channels = inputs, channels
        self.weight = nn.Parameter(torch.empty(len(START_OF_GATES) * channels, inputs + channels, 3, 3))
        self.bias = nn.Parameter(torch.tensor([*START_OF_GATES.values()]).repeat_interleave(channels))
        self.shift = ResolutionShift(len(self.bias)) if resolution_input else nn.Identity()
        self._initialise()

    @torch.no_grad()
    def _initialise(self) -> None:
        """Small noise, and an identity path for the input through the candidate, as in the dilated ConvGRU.

        In a layer with another number of inputs the path carries the last one, the occupied plane, with both signs.
        """
        nn.init.normal_(self.weight, std=0.3 * (self.weight.shape[1] * 9) ** -0.5)
        candidate = self.weight[-self.channels :, : self.inputs, 1, 1]
        if self.inputs == self.channels:
            candidate += torch.eye(self.channels)
        else:
            candidate[:, -1] += 2.0 * (-1.0) ** torch.arange(self.channels)

    def forward(self, x: Tensor | None, state: LSTMState) -> LSTMState:
        """The new state; an empty input is not convolved."""
        if x is None:
            sums = conv2d(state.h, self.weight[:, self.inputs :], padding=1)
        else:
            sums = conv2d(torch.cat([x, state.h], dim=1), self.weight, padding=1)
        bias: Tensor = self.shift(self.bias.view(-1, 1, 1))
        take, keep, show, candidate = (sums + bias).chunk(4, dim=1)
        c = torch.sigmoid(keep) * state.c + torch.sigmoid(take) * torch.tanh(candidate)
        return LSTMState(torch.sigmoid(show) * torch.tanh(c), c)


LSTMStates = tuple[LSTMState, ...]


class ConvLSTM(RecurrentNetwork):
    """The network: each layer's hidden state is the next one's input; a 3x3 convolution decodes the last one."""

    mixed_resolutions = True

    def __init__(self, size: int, settings: ConvLSTMSettings) -> None:
        super().__init__(size)
        self.channels = settings.channels
        self.layers = nn.ModuleList(
            ConvLSTMLayer(
                2 if k == 0 else settings.channels, settings.channels, resolution_input=settings.resolution_input
            )
            for k in range(settings.layers)
        )
        self.decode = nn.Conv2d(settings.channels, 1, 3, padding=1)
        nn.init.normal_(self.decode.weight, std=0.3)

    def initial(self, batch: int) -> LSTMStates:
        """h_0 = c_0 = 0 in every layer."""
        return (no_state(self.decode.weight, batch, self.channels, self.size),) * len(self.layers)

    def step(self, x: Tensor | None, state: LSTMStates) -> LSTMStates:
        """h_t and c_t of all layers."""
        states = []
        for layer, before in zip(self.layers, state, strict=True):
            states.append(layer(x, before))
            x = states[-1].h
        return tuple(states)

    def features(self, state: LSTMStates) -> Tensor:
        """The last layer's hidden state."""
        return state[-1].h

    @property
    def decoder(self) -> nn.Conv2d:
        """The convolution `decode`."""
        return self.decode


class ConvLSTMTracker(RecurrentTracker):
    """The ConvLSTM as a tracker of occupancy."""

    Options: ClassVar[type[ConvLSTMOptions]] = ConvLSTMOptions

    @classmethod
    def build(cls, size: int, options: Any, classes: int) -> ConvLSTM:
        """The untrained network; it has no classes."""
        return ConvLSTM(size, options)

"""The original Deep Tracking RNN (Ondruska and Posner, AAAI 2016).

    e = sigmoid(We*x)       encoder
    h' = sigmoid(Wh*[e, h]) recurrence
    y = sigmoid(Wy*h')      decoder

One recurrent layer, stride 1, "same" padding, h_0 = 0. The published code's version 1.1 has 7x7 convolutions
throughout and 78,449 parameters (the default); the paper's own 1.0 has 11,193 (`variant="paper"`).
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn.functional import conv2d

from gridtrack.trackers.recurrent.network import LatentState
from gridtrack.trackers.recurrent.resolution_input import ResolutionShift
from gridtrack.trackers.recurrent.settings import DeepTrackingRNNSettings

ENCODER = {"code": (16, 7), "paper": (8, 7)}
RECURRENCE = {"code": (32, 7), "paper": (16, 5)}


class DeepTrackingRNN(nn.Module):
    """The network: x_t (B, 2, M, M) and its one state h (B, C, M, M)."""

    def __init__(self, size: int, settings: DeepTrackingRNNSettings) -> None:
        super().__init__()
        (encoded, encoder_kernel), (channels, kernel) = ENCODER[settings.variant], RECURRENCE[settings.variant]
        self.size, self.channels = size, channels
        self.encode = nn.Conv2d(2, encoded, encoder_kernel, padding="same")
        self.recur = nn.Conv2d(encoded + channels, channels, kernel, padding="same")
        self.decode = nn.Conv2d(channels, 1, 7, padding="same")
        self._initialise()
        self.shifts = nn.ModuleDict(
            {
                name: ResolutionShift(units)
                for name, units in (("encode", encoded), ("recur", channels))
                if settings.resolution_input
            }
        )

    @torch.no_grad()
    def _initialise(self) -> None:
        """Xavier's noise, and an identity path for the occupied plane through every sigmoid.

        With noise alone the sigmoids stay near one half, where gradients are small: for thousands of updates the
        network forecasts the occupied rate in every cell.
        """
        for convolution in (self.encode, self.recur, self.decode):
            nn.init.xavier_uniform_(convolution.weight)
            nn.init.constant_(convolution.bias, 0.0)  # type: ignore[arg-type]
        encoded, centre = self.encode.out_channels, self.encode.kernel_size[0] // 2
        self.encode.weight[:, 1, centre, centre] += 6.0 * (-1.0) ** torch.arange(encoded)
        unit, centre = torch.arange(self.channels), self.recur.kernel_size[0] // 2
        self.recur.weight[unit, unit % encoded, centre, centre] += 4.0
        nn.init.constant_(self.recur.bias, -2.0)  # type: ignore[arg-type]

    def initial(self, batch: int) -> LatentState:
        """h_0 = 0."""
        zero = self.decode.weight.new_zeros((batch, self.channels, self.size, self.size))
        return (zero.contiguous(memory_format=torch.channels_last),)

    def step(self, x: Tensor | None, state: LatentState) -> LatentState:
        """h_t from x_t and h_{t-1}."""
        (h,) = state
        inputs = torch.cat([self.encoded(x, h.shape[0]), h], dim=1)
        return (torch.sigmoid(conv2d(inputs, self.recur.weight, self._bias("recur"), padding="same")),)

    def encoded(self, x: Tensor | None, batch: int) -> Tensor:
        """e_t (B, E, M, M). The encoding of an empty input is the sigmoid of the encoder's bias in every cell."""
        if x is not None:
            return torch.sigmoid(conv2d(x, self.encode.weight, self._bias("encode"), padding="same"))
        bias = torch.sigmoid(self._bias("encode"))
        return bias.view(1, -1, 1, 1).expand(batch, -1, self.size, self.size)

    def _bias(self, layer: str) -> Tensor:
        """The biases of the encoder or of the recurrence, at the resolution of the grids."""
        bias: Tensor = getattr(self, layer).bias
        return self.shifts[layer](bias) if layer in self.shifts else bias

    def empty_input_sums(self) -> Tensor:
        """What an empty input and the biases add to every sum of the recurrence, (1, C, M, M)."""
        input_weight = self.recur.weight[:, : -self.channels]
        return conv2d(self.encoded(None, 1), input_weight, self._bias("recur"), padding="same")

    def state_weight(self) -> Tensor:
        """The part of the recurrence's weight for h, (C, C, 7, 7), or 5 x 5 in the paper's variant."""
        return self.recur.weight[:, -self.channels :].contiguous(memory_format=torch.channels_last)

    def features(self, state: LatentState) -> Tensor:
        """The state itself."""
        return state[0]

    def occupancy(self, features: Tensor) -> Tensor:
        """Logits of P(occupied), (B, M, M)."""
        logits: Tensor = self.decode(features)
        return logits.squeeze(1)

    def semantics(self, state: LatentState) -> None:
        """This network has no classes."""

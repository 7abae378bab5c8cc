"""The tracker `deep-tracking-rnn`: the original Deep Tracking RNN (Ondruska and Posner, AAAI 2016).

    e = sigmoid(We*x)       encoder
    h' = sigmoid(Wh*[e, h]) recurrence
    y = sigmoid(Wy*h')      decoder

One recurrent layer, stride 1, "same" padding, h_0 = 0. The published code's version 1.1 has 7x7 convolutions
throughout and 78,449 parameters (the default); the paper's own 1.0 has 11,193 (`variant="paper"`).
"""

from __future__ import annotations

from typing import Any, ClassVar

import torch
from torch import Tensor, nn
from torch.nn.functional import conv2d

from gridtrack.trackers.recurrent.inference import InferenceNetwork
from gridtrack.trackers.recurrent.kernels.rnn import InferenceRNN, TrainingRNN
from gridtrack.trackers.recurrent.network import Recurrence, RecurrentNetwork, ResolutionShift
from gridtrack.trackers.recurrent.recurrent_tracker import RecurrentTracker
from gridtrack.trackers.recurrent.settings import DeepTrackingRNNOptions, DeepTrackingRNNSettings

ENCODER = {"code": (16, 7), "paper": (8, 7)}
RECURRENCE = {"code": (32, 7), "paper": (16, 5)}
STEEPNESS = 8.0
"""Weight of an untrained unit for its input; its values are then 0.02 and 0.98."""
HOLD = 5.0
"""Weight of an untrained latch for its own value. Above 4 it has two stable values, here 0.14 and 0.86; the larger the
weight, the smaller the gradient that passes from step to step."""


OneState = tuple[Tensor]
"""h (B, C, M, M)."""


class DeepTrackingRNN(RecurrentNetwork):
    """The network: x_t (B, 2, M, M) and its one state h (B, C, M, M)."""

    def __init__(self, size: int, settings: DeepTrackingRNNSettings) -> None:
        super().__init__(size)
        (encoded, encoder_kernel), (channels, kernel) = ENCODER[settings.variant], RECURRENCE[settings.variant]
        self.channels = channels
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
        """Xavier's noise, and paths that make the untrained network nearly persistence.

        Half of the encoder's units detect occupied cells, half free ones. Units in the first half of the state are
        latches, which the two kinds set and reset; units in the second half are the cells occupied in this frame. With
        noise alone the sigmoids stay near one half, where gradients are small: for thousands of updates the network
        forecasts the occupied rate in every cell. Without latches it forgets cells that are not visible.
        """
        for convolution, bias in ((self.encode, -STEEPNESS / 2), (self.recur, -STEEPNESS / 2), (self.decode, 0.0)):
            nn.init.xavier_uniform_(convolution.weight)
            nn.init.constant_(convolution.bias, bias)  # type: ignore[arg-type]
        encode, recur, decode = map(_centre, (self.encode, self.recur, self.decode))
        encoded, unit = self.encode.out_channels, torch.arange(self.channels)
        occupied, free = torch.arange(0, encoded, 2), torch.arange(1, encoded, 2)
        encode[occupied, 1] += STEEPNESS
        encode[free, 0] += STEEPNESS
        encode[free, 1] -= STEEPNESS
        partner = unit % len(occupied)
        recur[unit, occupied[partner]] += STEEPNESS
        holds = unit[: self.channels // 2]
        recur[holds, free[partner[holds]]] -= STEEPNESS
        recur[holds, encoded + holds] += HOLD
        assert self.recur.bias is not None
        self.recur.bias[holds] = -HOLD / 2
        decode[0, holds] += 1.5 * STEEPNESS / len(holds)

    def initial(self, batch: int) -> OneState:
        """h_0 = 0."""
        zero = self.decode.weight.new_zeros((batch, self.channels, self.size, self.size))
        return (zero.contiguous(memory_format=torch.channels_last),)

    def step(self, x: Tensor | None, state: OneState) -> OneState:
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
        """The part of the recurrence's sums from an empty input and the biases, (1, C, M, M)."""
        input_weight = self.recur.weight[:, : -self.channels]
        return conv2d(self.encoded(None, 1), input_weight, self._bias("recur"), padding="same")

    def state_weight(self) -> Tensor:
        """The part of the recurrence's weight for h, (C, C, 7, 7), or 5 x 5 in the paper's variant."""
        return self.recur.weight[:, -self.channels :].contiguous(memory_format=torch.channels_last)

    def features(self, state: OneState) -> Tensor:
        """The state itself."""
        return state[0]

    @property
    def decoder(self) -> nn.Conv2d:
        """The convolution `decode`."""
        return self.decode


def _centre(convolution: nn.Conv2d) -> Tensor:
    """The weights (outputs, inputs) of a cell for itself, a view."""
    rows, columns = convolution.kernel_size
    return convolution.weight[:, :, rows // 2, columns // 2]


class DeepTrackingRNNTracker(RecurrentTracker):
    """The Deep Tracking RNN as a tracker of occupancy."""

    Options: ClassVar[type[DeepTrackingRNNOptions]] = DeepTrackingRNNOptions

    @classmethod
    def build(cls, size: int, options: Any, classes: int) -> DeepTrackingRNN:
        """The untrained network; it has no classes."""
        return DeepTrackingRNN(size, options)

    @classmethod
    def prepare_training(cls, network: Any, device: str) -> Recurrence:
        """The variant of `kernels`, the same on all devices."""
        return TrainingRNN(network)

    @classmethod
    def prepare_inference(cls, network: Any, options: Any) -> InferenceNetwork:
        """The variant of `kernels`, on a processor."""
        return InferenceRNN(network) if network.output_bias.device.type == "cpu" else InferenceNetwork(network)

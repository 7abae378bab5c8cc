"""The Deep Tracking RNN with fewer convolutions: the encoding of the empty input is the same in every step.

Its part of the recurrence is convolved once: for inference at the start, in training once a sequence.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor
from torch.nn.functional import conv2d

from gridtrack.trackers.recurrent.inference import InferenceNetwork
from gridtrack.trackers.recurrent.kernels.convolutions import OneOutputConvolution
from gridtrack.trackers.recurrent.network import Recurrence

if TYPE_CHECKING:
    from gridtrack.trackers.recurrent.deep_tracking_rnn import DeepTrackingRNN, OneState


class InferenceRNN(InferenceNetwork):
    """The network for inference on a processor."""

    def __init__(self, network: DeepTrackingRNN) -> None:
        super().__init__(network)
        self._decode = OneOutputConvolution(network.decode, network.size)
        with torch.no_grad():
            self._empty, self._weight = network.empty_input_sums(), network.state_weight()

    def step(self, x: Tensor | None, state: OneState) -> OneState:
        """h_t; an empty input is not convolved."""
        if x is None:
            h: Tensor = torch.sigmoid(self._empty + conv2d(state[0], self._weight, padding="same"))
            return (h,)
        found: OneState = self.network.step(x, state)
        return found

    def occupancy(self, features: Tensor) -> Tensor:
        """Logits of P(occupied), (1, M, M)."""
        return self._decode(features)


class TrainingRNN(Recurrence):
    """The network with its gradient.

    Its state is h (B, C, M, M), and of the sequence the sums of the empty input (1, C, M, M) and the weight for h.
    """

    def __init__(self, network: DeepTrackingRNN) -> None:
        self._network = network

    def initial(self, batch: int) -> tuple[Tensor, ...]:
        """h_0 = 0, at the first frame of a sequence."""
        network = self._network
        return *network.initial(batch), network.empty_input_sums(), network.state_weight()

    def step(self, x: Tensor | None, state: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
        """h_t; an empty input is not convolved."""
        h, empty, weight = state
        if x is None:
            return torch.sigmoid(empty + conv2d(h, weight, padding="same")), empty, weight
        return *self._network.step(x, (h,)), empty, weight

    def features(self, state: tuple[Tensor, ...]) -> Tensor:
        """The state h."""
        return state[0]

    def occupancy(self, features: Tensor) -> Tensor:
        """Logits of P(occupied), (B, M, M)."""
        return self._network.occupancy(features)


INFERENCE = {"float32": InferenceRNN}
TRAINING = {"cpu": TrainingRNN, "cuda": TrainingRNN}

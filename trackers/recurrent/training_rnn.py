"""The Deep Tracking RNN for training on a processor: the same function and gradient, with fewer convolutions.

The encoding of the empty input is the same in every step; its part of the recurrence is convolved once a sequence.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import conv2d

from gridtrack.trackers.recurrent.deep_tracking_rnn import DeepTrackingRNN
from gridtrack.trackers.recurrent.network import LatentState


class TrainingRNN:
    """A RecurrentNetwork with gradients on a processor: `network`.

    Its state is h (B, C, M, M), then the sums of the empty input (1, C, M, M) and the weight for h of the sequence.
    """

    def __init__(self, network: DeepTrackingRNN) -> None:
        self._network = network
        self.occupancy, self.semantics = network.occupancy, network.semantics

    def initial(self, batch: int) -> LatentState:
        """h_0 = 0, at the first frame of a sequence."""
        network = self._network
        return *network.initial(batch), network.empty_input_sums(), network.state_weight()

    def step(self, x: Tensor | None, state: LatentState) -> LatentState:
        """h_t; an empty input is not convolved."""
        h, empty, weight = state
        if x is None:
            return torch.sigmoid(empty + conv2d(h, weight, padding="same")), empty, weight
        return *self._network.step(x, (h,)), empty, weight

    def features(self, state: LatentState) -> Tensor:
        """The state h."""
        return state[0]

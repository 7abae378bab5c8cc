"""A learned tracker of its own package: two layers of a ConvLSTM (Shi et al., 2015) with a nested state."""

from __future__ import annotations

import torch
from torch import nn

from gridtrack.trackers.recurrent.network import RecurrentNetwork
from gridtrack.trackers.recurrent.recurrent_tracker import RecurrentTracker
from gridtrack.trackers.recurrent.settings import ResolutionSettings, TrainingSettings


class ConvLSTM(RecurrentNetwork):
    """State: for each layer, its hidden state h and its cell state c."""

    def __init__(self, size, channels=3):
        super().__init__(size)
        self.channels = channels
        self.layers = nn.ModuleList(
            nn.Conv2d(inputs + channels, 4 * channels, 3, padding=1) for inputs in (2, channels)
        )
        self.decode = nn.Conv2d(channels, 1, 3, padding=1)

    def initial(self, batch):
        zero = self.decode.weight.new_zeros(batch, self.channels, self.size, self.size)
        return tuple({"h": zero, "c": zero} for _ in self.layers)

    def step(self, x, state):
        new = []
        for layer, previous in zip(self.layers, state, strict=True):
            h = previous["h"]
            x = h.new_zeros(len(h), 2, self.size, self.size) if x is None else x
            take, keep, show, candidate = layer(torch.cat([x, h], dim=1)).chunk(4, dim=1)
            c = torch.sigmoid(keep) * previous["c"] + torch.sigmoid(take) * torch.tanh(candidate)
            x = torch.sigmoid(show) * torch.tanh(c)
            new.append({"h": x, "c": c})
        return tuple(new)

    def features(self, state):
        return state[-1]["h"]

    def occupancy(self, features):
        return self.decode(features).squeeze(1)

    @property
    def output_bias(self):
        return self.decode.bias


class ConvLSTMOptions(ResolutionSettings, TrainingSettings):
    """Training of the ConvLSTM."""


class ConvLSTMTracker(RecurrentTracker):
    """The ConvLSTM as a tracker."""

    Options = ConvLSTMOptions

    @classmethod
    def build(cls, size, options, classes):
        return ConvLSTM(size)

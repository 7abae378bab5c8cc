"""The tracker `sogmp`: stochastic occupancy grid map prediction (Xie and Dames, CoRL 2023), with sampled futures.

    h = ConvLSTM(o_1 .. o_10)            the occupied cells of ten frames, in the window of the last one
    mean, variance = encoder(h)          two latent maps at a quarter of the size
    P(occupied at the next step) = decoder(z),  z ~ N(mean, variance)

The loss is the cross-entropy of the cells plus BETA times the divergence of z from N(0, 1). A future is a series of
next steps, each with its own z, that the network reads in turn as frames.
"""

from __future__ import annotations

from typing import Any, ClassVar

import torch
from pydantic import Field
from torch import Tensor, nn

from gridtrack.common.config import Settings
from gridtrack.trackers.contract import MAX_FUTURES
from gridtrack.trackers.past_frames.network import (
    PastFramesNetwork,
    PastFramesTracker,
    PastFramesTraining,
    StepsAhead,
    padded,
)
from gridtrack.trackers.recurrent.conv_lstm import ConvLSTMLayer, no_state
from gridtrack.trackers.recurrent.settings import ResolutionSettings
from gridtrack.trackers.training.device import DeviceSettings

LATENT_MAPS, LATENT_STRIDE = 2, 4
BETA = 0.01


class SOGMPSettings(ResolutionSettings):
    """The shape of the network; the defaults are the published one."""

    channels: int = Field(32, ge=1, le=128)
    """Channels of the ConvLSTM."""
    hidden: int = Field(64, ge=1, le=512)
    """Channels of encoder and decoder at half the size; at a quarter they have twice as many."""


class SampleSettings(DeviceSettings):
    """Settings of inference, which do not depend on training."""

    samples: int = Field(8, ge=2, le=MAX_FUTURES)
    """Sampled futures of a forecast, of which the occupancy is the mean. The time of a forecast is in proportion."""


class SOGMPOptions(SOGMPSettings, PastFramesTraining, SampleSettings):
    """Shape, training and samples of SOGMP."""


class ResidualBlock(nn.Module):
    """x + two convolutions of x, with half of its channels between them."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.convolutions = nn.Sequential(
            nn.ReLU(),
            nn.Conv2d(channels, channels // 2, 3, padding=1),
            nn.ReLU(),
            nn.Conv2d(channels // 2, channels, 1),
        )

    def forward(self, x: Tensor) -> Tensor:
        """The sum."""
        added: Tensor = x + self.convolutions(x)
        return added


class SOGMP(PastFramesNetwork):
    """The network."""

    def __init__(self, size: int, settings: SOGMPSettings) -> None:
        super().__init__(size)
        channels, half, quarter = settings.channels, settings.hidden, 2 * settings.hidden
        self.channels = channels
        self.follow = ConvLSTMLayer(1, channels, resolution_input=settings.resolution_input)
        self.encode = nn.Sequential(
            nn.Conv2d(channels, half, 4, stride=2, padding=1),
            nn.ReLU(),
            nn.Conv2d(half, quarter, 4, stride=2, padding=1),
            ResidualBlock(quarter),
            ResidualBlock(quarter),
            nn.ReLU(),
            nn.Conv2d(quarter, 2 * LATENT_MAPS, 1),
        )
        self.decode = nn.Sequential(
            nn.Conv2d(LATENT_MAPS, quarter, 3, padding=1),
            ResidualBlock(quarter),
            ResidualBlock(quarter),
            nn.ReLU(),
            nn.ConvTranspose2d(quarter, half, 4, stride=2, padding=1),
            nn.ReLU(),
            nn.ConvTranspose2d(half, half, 4, stride=2, padding=1),
            nn.ReLU(),
        )
        self.read = nn.Conv2d(half, 1, 3, padding=1)

    @property
    def decoder(self) -> nn.Conv2d:
        """The convolution `read`."""
        return self.read

    def next_steps(self, past: Tensor, draw: torch.Generator | None) -> StepsAhead:
        """One step, of a z that is drawn for each of the batch; the penalty is that of z."""
        size = past.shape[-1]
        mean, log_variance = self.encode(self._followed(padded(past[:, :, 1:], LATENT_STRIDE))).float().chunk(2, dim=1)
        noise = torch.randn(mean.shape, generator=draw, device=mean.device if draw is None else draw.device)
        z = mean + noise.to(mean.device) * torch.exp(0.5 * log_variance)
        divergence = 0.5 * (mean**2 + log_variance.exp() - 1.0 - log_variance).sum()
        logits = self.read(self.decode(z))[..., :size, :size].float()
        return StepsAhead(logits, BETA * divergence)

    def _followed(self, occupied: Tensor) -> Tensor:
        """The hidden state (B, C, M, M) after `occupied` (B, T, 1, M, M)."""
        state = no_state(occupied, len(occupied), self.channels, occupied.shape[-1])
        for frame in occupied.unbind(dim=1):
            state = self.follow(frame, state)
        return state.h


class SOGMPTracker(PastFramesTracker):
    """SOGMP as a tracker of occupancy."""

    Options: ClassVar[type[SOGMPOptions]] = SOGMPOptions
    running: ClassVar[type[Settings]] = SampleSettings

    @classmethod
    def samples_of(cls, options: Any) -> int:
        """The option `samples`."""
        return int(options.samples)

    @classmethod
    def build(cls, size: int, options: Any, classes: int) -> SOGMP:
        """The untrained network; it has no classes."""
        return SOGMP(size, options)

"""The tracker `simvp`: SimVP (Gao et al., CVPR 2022) with the gSTA translator (Tan et al., 2022).

    z_t = encoder(x_t)                                  for each of ten frames alone, at a quarter of the size
    y = translator(z_1 .. z_10)                         convolutions of all frames' channels together
    P(occupied at step k) = decoder(y_k, skip of x_k)   ten steps at once

A block of the translator multiplies features by gates with a large receptive field: depthwise 5x5, depthwise 7x7 with
dilation 3, and 1x1, which together see 21 x 21 cells; then come two 1x1 convolutions with a depthwise 3x3 between.
"""

from __future__ import annotations

from typing import Any, ClassVar

import torch
from pydantic import Field
from torch import Tensor, nn
from torch.nn.functional import conv2d, gelu

from gridtrack.trackers.past_frames.network import (
    PAST_STEPS,
    PastFramesNetwork,
    PastFramesTracker,
    PastFramesTraining,
    StepsAhead,
    padded,
)
from gridtrack.trackers.recurrent.network import ResolutionShift
from gridtrack.trackers.recurrent.settings import ResolutionSettings

WIDENING = 8
"""Channels between the two 1x1 convolutions of a block, in channels of the block."""
BLOCK_SCALE = 0.01
"""Factor of each branch of an untrained block."""


class SimVPSettings(ResolutionSettings):
    """The shape of SimVP; the defaults are the published one for Moving MNIST, with hid_S 16 and hid_T 128."""

    channels: int = Field(16, ge=2, le=64, multiple_of=2)
    """Channels of encoder and decoder."""
    halvings: int = Field(2, ge=1, le=4)
    """Pairs of convolutions in the encoder, and in the decoder; each halves, or doubles, the size."""
    hidden: int = Field(128, ge=2, le=512, multiple_of=2)
    """Channels of the translator."""
    blocks: int = Field(4, ge=2, le=16)
    """Blocks of the translator."""


class SimVPOptions(SimVPSettings, PastFramesTraining):
    """Shape and training of SimVP."""


def _convolution(inputs: int, outputs: int, *, stride: int = 1, doubles: bool = False) -> nn.Sequential:
    """A 3x3 convolution, normalised, with SiLU; it may halve (`stride` 2) or double the size."""
    shuffle = [nn.Conv2d(inputs, 4 * outputs, 3, padding=1), nn.PixelShuffle(2)]
    plain = [nn.Conv2d(inputs, outputs, 3, stride=stride, padding=1)]
    return nn.Sequential(*(shuffle if doubles else plain), nn.GroupNorm(2, outputs), nn.SiLU())


class GatedBlock(nn.Module):
    """A block of the translator, (B, C, m, m) -> the same."""

    def __init__(self, channels: int, *, resolution_input: bool) -> None:
        super().__init__()
        wide = WIDENING * channels
        self.norm, self.norm_2 = nn.GroupNorm(2, channels), nn.GroupNorm(2, channels)
        self.project = nn.Conv2d(channels, channels, 1, bias=False)
        self.bias = nn.Parameter(torch.zeros(channels))
        self.shift = ResolutionShift(channels) if resolution_input else nn.Identity()
        self.attend = nn.Sequential(
            nn.Conv2d(channels, channels, 5, padding=2, groups=channels),
            nn.Conv2d(channels, channels, 7, padding=9, dilation=3, groups=channels),
            nn.Conv2d(channels, 2 * channels, 1),
        )
        self.join = nn.Conv2d(channels, channels, 1)
        self.mix = nn.Sequential(
            nn.Conv2d(channels, wide, 1),
            nn.Conv2d(wide, wide, 3, padding=1, groups=wide),
            nn.GELU(),
            nn.Conv2d(wide, channels, 1),
        )
        self.scales = nn.Parameter(torch.full((2, channels), BLOCK_SCALE))

    def forward(self, x: Tensor) -> Tensor:
        """Gated features and mixed channels, each added to `x`."""
        of_gates, of_channels = self.scales.view(2, -1, 1, 1)
        normed = self.norm(x)
        projected = gelu(conv2d(normed, self.project.weight) + self.shift(self.bias.view(-1, 1, 1)))
        features, gates = self.attend(projected).chunk(2, dim=1)
        x = x + of_gates * (normed + self.join(torch.sigmoid(gates) * features))
        mixed: Tensor = x + of_channels * self.mix(self.norm_2(x))
        return mixed


class SimVP(PastFramesNetwork):
    """The network."""

    def __init__(self, size: int, settings: SimVPSettings) -> None:
        super().__init__(size)
        channels, together = settings.channels, PAST_STEPS * settings.channels
        self.stride = 2**settings.halvings
        strides = (1, 2) * settings.halvings
        self.encode = nn.ModuleList(
            _convolution(2 if k == 0 else channels, channels, stride=stride) for k, stride in enumerate(strides)
        )
        widths = [together, *(settings.hidden,) * (settings.blocks - 1)]
        self.translate = nn.Sequential(
            *(
                nn.Sequential(
                    GatedBlock(width, resolution_input=settings.resolution_input),
                    nn.Identity() if width == after else nn.Conv2d(width, after, 1),
                )
                for width, after in zip(widths, [*widths[1:], together], strict=True)
            )
        )
        self.decode = nn.ModuleList(
            _convolution(2 * channels if k == 0 else channels, channels, doubles=stride == 2)
            for k, stride in reversed(list(enumerate(strides)))
        )
        self.read = nn.Conv2d(channels, 1, 1)

    @property
    def decoder(self) -> nn.Conv2d:
        """The convolution `read`."""
        return self.read

    def next_steps(self, past: Tensor, draw: torch.Generator | None) -> StepsAhead:
        """As many steps as are read; nothing is random."""
        batch, steps, _, size, _ = past.shape
        x = padded(past.flatten(0, 1), self.stride).contiguous(memory_format=torch.channels_last)
        first, *others = self.encode
        skip = x = first(x)
        for convolution in others:
            x = convolution(x)
        channels, small = x.shape[1], x.shape[-1]
        x = self.translate(x.reshape(batch, steps * channels, small, small))
        x = x.reshape(batch * steps, channels, small, small)
        *others, last = self.decode
        for convolution in others:
            x = convolution(x)
        logits = self.read(last(torch.cat([x, skip], dim=1)))
        return StepsAhead(logits[:, 0, :size, :size].reshape(batch, steps, size, size).float())


class SimVPTracker(PastFramesTracker):
    """SimVP as a tracker of occupancy."""

    Options: ClassVar[type[SimVPOptions]] = SimVPOptions

    @classmethod
    def build(cls, size: int, options: Any, classes: int) -> SimVP:
        """The untrained network; it has no classes."""
        return SimVP(size, options)

"""Training windows: consecutive frames of the training stretches, drawn and augmented by a seed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import Dataset, Sampler

from gridtrack.common.errors import ConfigurationError
from gridtrack.trackers.contract import FrameSource


def load_frames(source: FrameSource) -> NDArray[np.uint8]:
    """All frames of a stretch, (T, 2, M, ceil(M / 8)): planes visible and occupied, eight cells a byte."""
    planes = (np.stack([frame.visible, frame.occupied]) for frame in source)
    return np.stack([np.packbits(pair, axis=-1) for pair in planes])


def occupied_rate(stretches: Sequence[NDArray[np.uint8]]) -> float:
    """Occupied cells divided by visible cells; 1 occupied and 2 visible at least."""
    visible, occupied = (sum(int(np.bitwise_count(s[:, plane]).sum()) for s in stretches) for plane in (0, 1))
    return max(occupied, 1) / max(visible, 2)


class SequenceDataset(Dataset[Tensor]):
    """Windows of `length` frames as (length, 2, M, M) uint8; item i is drawn by a generator seeded with (seed, i).

    Augmentation: with `time_reversal`, every second window is in reverse order of time; with `superposition`, every
    second window is the superposition of two. Raises ConfigurationError where a stretch is shorter than one window.
    """

    def __init__(
        self, sources: Sequence[FrameSource], length: int, seed: int, *, time_reversal: bool, superposition: bool
    ) -> None:
        self.sources = [(source.name, source.sha256) for source in sources]
        self.stretches = [load_frames(source) for source in sources]
        self.size, self.length, self.seed = sources[0].grid.size, length, seed
        self.time_reversal, self.superposition = time_reversal, superposition
        for source, frames in zip(sources, self.stretches, strict=True):
            if len(frames) < length:
                raise ConfigurationError(f"{source.name}: {len(frames)} frames; training needs at least {length}")
        self.starts = np.cumsum([len(frames) - length + 1 for frames in self.stretches])

    def __getitem__(self, index: int) -> Tensor:
        """Window number `index`; the series has no end."""
        draw = np.random.default_rng((self.seed, index))
        window = self._draw(draw)
        if self.superposition and draw.integers(2):
            window = superposed(window, self._draw(draw))
        return torch.from_numpy(np.unpackbits(window, axis=-1, count=self.size))

    def _draw(self, draw: np.random.Generator) -> NDArray[np.uint8]:
        at = int(draw.integers(self.starts[-1]))
        stretch = int(np.searchsorted(self.starts, at, side="right"))
        start = at - (int(self.starts[stretch - 1]) if stretch else 0)
        window = self.stretches[stretch][start : start + self.length]
        return window[::-1] if self.time_reversal and draw.integers(2) else window


def superposed(one: NDArray[np.uint8], other: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The frames of a laser if the moving objects of two windows (T, 2, M, ceil(M / 8)) were present together.

    A beam ends at the nearer of its two returns: a cell is visible if it is visible in both windows, and occupied if it
    is visible and occupied in either.
    """
    visible = one[:, 0] & other[:, 0]
    return np.stack([visible, visible & (one[:, 1] | other[:, 1])], axis=1)


class EpochSampler(Sampler[int]):
    """Item numbers of one epoch after the other: a resumed training continues with the next unused window."""

    def __init__(self, items: int, used: int = 0) -> None:
        """`items` of an epoch; the first `used` items of all were drawn by the training that is resumed."""
        self.items, self.used, self.epoch = items, used, 0

    def set_epoch(self, epoch: int) -> None:
        """Called by Lightning before each epoch."""
        self.epoch = epoch

    def __iter__(self) -> Iterator[int]:
        return iter(range(max(self.epoch * self.items, self.used), (self.epoch + 1) * self.items))

    def __len__(self) -> int:
        return self.items

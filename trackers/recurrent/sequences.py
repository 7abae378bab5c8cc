"""Training sequences: windows of frames, some shown and some withheld, in a seeded order."""

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
    """The share of occupied among visible cells."""
    visible, occupied = (sum(int(np.bitwise_count(s[:, plane]).sum()) for s in stretches) for plane in (0, 1))
    return max(occupied, 1) / max(visible, 2)


class SequenceDataset(Dataset[Tensor]):
    """Windows of `length` frames as (length, 2, M, M) uint8; item i is drawn by a generator seeded with (seed, i).

    With `reverse`, every second window runs backwards in time: what walks on a path may walk it the other way. With
    `superpose`, every second window is two of them laid over one another, as if the movers of both had been there.
    Raises ConfigurationError where a stretch is shorter than one window.
    """

    def __init__(
        self, sources: Sequence[FrameSource], length: int, seed: int, *, reverse: bool, superpose: bool
    ) -> None:
        self.sources = [(source.name, source.sha256) for source in sources]
        self.stretches = [load_frames(source) for source in sources]
        self.size, self.length, self.seed = sources[0].grid.size, length, seed
        self.reverse, self.superpose = reverse, superpose
        for source, frames in zip(sources, self.stretches, strict=True):
            if len(frames) < length:
                raise ConfigurationError(f"{source.name}: {len(frames)} frames; training needs at least {length}")
        self.starts = np.cumsum([len(frames) - length + 1 for frames in self.stretches])

    def __getitem__(self, index: int) -> Tensor:
        """Window number `index` of an endless series."""
        draw = np.random.default_rng((self.seed, index))
        window = self._draw(draw)
        if self.superpose and draw.integers(2):
            window = superposed(window, self._draw(draw))
        return torch.from_numpy(np.unpackbits(window, axis=-1, count=self.size))

    def _draw(self, draw: np.random.Generator) -> NDArray[np.uint8]:
        at = int(draw.integers(self.starts[-1]))
        stretch = int(np.searchsorted(self.starts, at, side="right"))
        start = at - (int(self.starts[stretch - 1]) if stretch else 0)
        window = self.stretches[stretch][start : start + self.length]
        return window[::-1] if self.reverse and draw.integers(2) else window


def superposed(one: NDArray[np.uint8], other: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """What a laser would have seen had the movers of two windows (T, 2, M, ceil(M / 8)) been there at once.

    A beam ends at the nearer of its two returns: a cell is visible where it was in both, and occupied where it is
    visible and was occupied in either.
    """
    visible = one[:, 0] & other[:, 0]
    return np.stack([visible, visible & (one[:, 1] | other[:, 1])], axis=1)


class EpochSampler(Sampler[int]):
    """Item numbers, epoch after epoch: a resumed training goes on with the windows that it had not seen."""

    def __init__(self, items: int) -> None:
        self.items, self.epoch = items, 0

    def set_epoch(self, epoch: int) -> None:
        """Called by Lightning before each epoch."""
        self.epoch = epoch

    def __iter__(self) -> Iterator[int]:
        return iter(range(self.epoch * self.items, (self.epoch + 1) * self.items))

    def __len__(self) -> int:
        return self.items

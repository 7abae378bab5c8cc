"""Training windows: consecutive frames of the training stretches, drawn and augmented by a seed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import Dataset, Sampler

from gridtrack.common.errors import ConfigurationError
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import Shift, rolled, shift_between
from gridtrack.trackers.contract import FrameSource
from gridtrack.trackers.recurrent.motion import entered_cells, moving_shapes
from gridtrack.trackers.recurrent.network import resolution_of
from gridtrack.trackers.recurrent.pacing import StepPace
from gridtrack.trackers.recurrent.settings import TrainingSettings
from gridtrack.trackers.site_map import posterior_rate

LARGEST_WINDOW = 64
"""Cells a side of the windows that general weights are trained on: larger grids are cut, smaller ones padded. 100
cells would take two and a half times as long, so that a training would see fewer places."""
DRAWS, MOVING_CELLS = 8, 10
"""With `moving_windows` a window with fewer than MOVING_CELLS entered cells is drawn again, up to DRAWS times."""

COUNTED_FRAMES = 1024
"""Frames that are counted at a time: unpacked they take eight times the memory."""


class Item(NamedTuple):
    """A window (T, 2, M, M) uint8, visible and occupied at each step of the network, and its `resolution_of` (2,)."""

    window: Tensor
    resolution: Tensor


class Frames(NamedTuple):
    """All frames of a stretch: their planes, visible and occupied, and the places of their windows.

    `planes` (T, 2, M, ceil(M / 8)) uint8, eight cells a byte; `windows` (T, 2) int64, rows and columns from the window
    of a first frame to each window; `size`: M; `resolution` (2,), see `resolution_of`; `pace` of the network's steps.
    """

    planes: NDArray[np.uint8]
    windows: NDArray[np.int64]
    size: int
    resolution: Tensor
    pace: StepPace


def load_frames(source: FrameSource, first_window: SE2 | None, step_s: float = 0.0) -> Frames:
    """All frames of a stretch; their windows are relative to `first_window`, by default the first frame's."""
    planes, windows = [], []
    for frame in source:
        first_window = first_window or frame.world_T_grid
        planes.append(np.packbits(np.stack([frame.visible, frame.occupied]), axis=-1))
        windows.append(shift_between(first_window, frame.world_T_grid, source.grid.cell_m))
    pace = StepPace.of(source.period_s, step_s)
    resolution = resolution_of(source.grid.cell_m, pace.step_s(source.period_s))
    return Frames(np.stack(planes), np.array(windows, np.int64), source.grid.size, resolution, pace)


def in_one_window(planes: NDArray[np.uint8], windows: NDArray[np.int64], number: int, size: int) -> NDArray[np.uint8]:
    """The `planes` (T, 2, M, ceil(M / 8)) of frames in the window of frame `number`: cells outside theirs are unseen.

    A sequence then has one window, like a forecast, and nothing in the network moves in training.
    """
    shifts = windows[number] - windows
    if not shifts.any():
        return planes
    cells = np.unpackbits(planes, axis=-1, count=size)
    rolled_cells = [rolled(each, Shift(*shift), 0) for each, shift in zip(cells, shifts.tolist(), strict=True)]
    return np.packbits(np.stack(rolled_cells), axis=-1)


def cut_or_padded(cells: NDArray[np.uint8], size: int, draw: np.random.Generator) -> NDArray[np.uint8]:
    """A random part of `size` cells a side of `cells` (T, 2, M, M); if M is smaller, all of them at a random place.

    The cells around these are not visible.
    """
    room = cells.shape[-1] - size
    row, column = draw.integers(0, abs(room) + 1, 2).tolist()
    if room >= 0:
        return cells[..., row : row + size, column : column + size]
    padded = np.zeros((*cells.shape[:2], size, size), np.uint8)
    padded[..., row : row + cells.shape[-1], column : column + cells.shape[-1]] = cells
    return padded


class SequenceDataset(Dataset[Item]):
    """Windows for training with `settings`; item i is drawn by a generator seeded with (seed, i).

    All frames of an item are in the grid of its last observed frame; see TrainingSettings for the augmentations. With
    `general` the sources may differ in place, grid and period: each counts by its duration, and every item has the same
    number of cells, at most LARGEST_WINDOW a side. Raises ConfigurationError if a stretch is shorter than one item, or
    if frames of different windows would be superposed.
    """

    def __init__(
        self,
        sources: Sequence[FrameSource],
        settings: TrainingSettings,
        seed: int,
        *,
        step_s: float = 0.0,
        general: bool = False,
    ) -> None:
        if general and settings.superposition:
            raise ConfigurationError("frames of different places cannot be superposed: train with superposition=false")
        self.sources = [(source.name, source.sha256) for source in sources]
        self.first_window = None if general else next(iter(sources[0])).world_T_grid
        self.stretches = [load_frames(source, self.first_window, step_s) for source in sources]
        largest = max(source.grid.size for source in sources)
        self.size = min(largest, LARGEST_WINDOW) if general else largest
        self.settings, self.seed = settings, seed
        for source, frames in zip(sources, self.stretches, strict=True):
            self._check(source, frames)
        shortest_s = min(source.period_s for source in sources)
        # so many tickets has an item, in proportion to the period of its stretch
        self._tickets = [round(source.period_s / shortest_s) for source in sources]
        starts = (len(frames.planes) - self._frames(frames) + 1 for frames in self.stretches)
        self._last = np.cumsum([own * count for own, count in zip(self._tickets, starts, strict=True)])

    def _check(self, source: FrameSource, frames: Frames) -> None:
        if len(frames.planes) < self._frames(frames):
            raise ConfigurationError(
                f"{source.name}: {len(frames.planes)} frames; training needs at least {self._frames(frames)}"
            )
        if self.settings.superposition and np.ptp(frames.windows, axis=0).any():
            raise ConfigurationError(
                f"{source.name}: the sensor moves, and frames of different places cannot be superposed: train with"
                " superposition=false"
            )

    def _frames(self, stretch: Frames) -> int:
        """The number of frames of the stretch in one item."""
        return stretch.pace.frames(self.settings.length)

    @cached_property
    def occupied_rate(self) -> float:
        """Occupied cells divided by visible cells, in all stretches; at least 1 occupied and 2 visible."""
        visible, occupied = (sum(int(np.bitwise_count(s.planes[:, k]).sum()) for s in self.stretches) for k in (0, 1))
        return max(occupied, 1) / max(visible, 2)

    @cached_property
    def unseen_target(self) -> NDArray[np.float32]:
        """What a cell is if no frame of an item sees it: its own occupied rate (M, M) where all windows are the same,
        else that of all cells (), and where it has no weight."""
        if not (self.settings.unseen_weight and self.has_one_window):
            return np.array(self.occupied_rate, np.float32)
        visible, occupied = np.zeros((2, self.size, self.size))
        for planes in (stretch.planes for stretch in self.stretches):
            for first in range(0, len(planes), COUNTED_FRAMES):
                cells = np.unpackbits(planes[first : first + COUNTED_FRAMES], axis=-1, count=self.size)
                visible += cells[:, 0].sum(axis=0)
                occupied += cells[:, 1].sum(axis=0)
        return posterior_rate(occupied, visible)

    @property
    def has_one_window(self) -> bool:
        """Whether the windows of all frames are the same cells of the world."""
        return self.first_window is not None and not any(frames.windows.any() for frames in self.stretches)

    def __getitem__(self, index: int) -> Item:
        """Window number `index`, any number from 0 on."""
        draw = np.random.default_rng((self.seed, index))
        if index < self.settings.shape_updates * self.settings.batch:
            return Item(torch.from_numpy(self._shapes(draw)), self._place(draw)[0].resolution)
        item = self._item(draw)
        for _ in range(DRAWS - 1 if self.settings.moving_windows else 0):
            entered = entered_cells(item.window[None].bool())
            if int(entered[:, self.settings.last_observed :].sum()) >= MOVING_CELLS:
                break
            item = self._item(draw)
        if draw.random() < self.settings.shape_share:
            both = superposed(item.window.numpy(), self._shapes(draw))
            return Item(torch.from_numpy(both), item.resolution)
        return item

    def _shapes(self, draw: np.random.Generator) -> NDArray[np.uint8]:
        """The planes (T, 2, M, M) of moving shapes."""
        return moving_shapes(draw, self.settings.length, self.size)

    def _item(self, draw: np.random.Generator) -> Item:
        """A window of a recording, or the superposition of two."""
        stretch, window = self._draw(draw)
        if self.settings.superposition and draw.integers(2):
            window = superposed(window, self._draw(draw)[1])
        cells = np.unpackbits(window, axis=-1, count=stretch.size)
        if stretch.size != self.size:
            cells = cut_or_padded(cells, self.size, draw)
        return Item(torch.from_numpy(stretch.pace.steps_of(cells, self.settings.length)), stretch.resolution)

    def _draw(self, draw: np.random.Generator) -> tuple[Frames, NDArray[np.uint8]]:
        """A stretch, and the planes (frames, 2, M, ceil(M / 8)) of consecutive frames of it in one window."""
        frames, start = self._place(draw)
        item = slice(start, start + self._frames(frames))
        planes, windows = frames.planes[item], frames.windows[item]
        if self.settings.time_reversal and draw.integers(2):
            planes, windows = planes[::-1], windows[::-1]
        forecast_from = frames.pace.frame_of(self.settings.last_observed)
        return frames, in_one_window(planes, windows, forecast_from, frames.size)

    def _place(self, draw: np.random.Generator) -> tuple[Frames, int]:
        """A stretch, and the number of the frame in it with which an item starts."""
        at = int(draw.integers(self._last[-1]))
        number = int(np.searchsorted(self._last, at, side="right"))
        return self.stretches[number], (at - (int(self._last[number - 1]) if number else 0)) // self._tickets[number]


def superposed(one: NDArray[np.uint8], other: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The frames of a laser with the moving objects of two windows (T, 2, ...) together.

    A beam ends at the nearer of its two returns: a cell is visible if it is visible in both windows, and occupied if it
    is visible and occupied in either.
    """
    visible = one[:, 0] & other[:, 0]
    return np.stack([visible, visible & (one[:, 1] | other[:, 1])], axis=1)


class EpochSampler(Sampler[int]):
    """Item numbers of consecutive epochs: a resumed training continues with the next unused window.

    If several `devices` share each batch, device number `rank` has every `devices`-th item.
    """

    def __init__(self, items: int, total: int, used: int = 0, *, rank: int = 0, devices: int = 1) -> None:
        """Numbers of `items`: in an epoch, in all epochs (`total`), and `used` by the training that is resumed."""
        self.items, self.total, self.used, self.epoch = items, total, used, 0
        self.rank, self.devices = rank, devices

    def set_epoch(self, epoch: int) -> None:
        """Called by Lightning before each epoch."""
        self.epoch = epoch

    def __iter__(self) -> Iterator[int]:
        start = self.epoch * self.items
        first, end = max(start, self.used), min(start + self.items, self.total)
        return iter(range(first + self.rank, end, self.devices))

    def __len__(self) -> int:
        return min(self.items, self.total) // self.devices

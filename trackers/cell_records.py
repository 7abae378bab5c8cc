"""Records of each cell of a window that scrolls: when it was seen, how often it had a mark, and open space."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import GridFrame, Mask, Shift, rolled, with_neighbours

MEMORY_S = 5.0
"""Time constant of the record, of the time in which a cell was visible."""


class HiddenTime:
    """`seconds` (M, M) float32: time since each cell was last seen; infinite if never, and in cells that come in."""

    def __init__(self, shape: tuple[int, int]) -> None:
        self.seconds: NDArray[np.float32] = np.full(shape, np.inf, np.float32)

    def observe(self, visible: Mask, elapsed_s: float) -> None:
        """Update with the `visible` cells (M, M) of a frame, `elapsed_s` after the previous one."""
        self.seconds = np.where(visible, np.float32(0.0), self.seconds + np.float32(elapsed_s))

    def scroll(self, shift: Shift) -> None:
        """Move the record with the window."""
        self.seconds = rolled(self.seconds, shift, np.inf)


class FadingRecord:
    """In how many recent frames each cell was visible, and in how many it had a mark: `visible`, `marked` (M, M).

    Both forget with the time constant `memory_s`, of the time in which the cell was visible. A frame counts for the
    periods since the previous one.
    """

    def __init__(self, shape: tuple[int, int], period_s: float, memory_s: float) -> None:
        self.visible, self.marked = np.zeros((2, *shape), np.float32)
        self._lost = -math.expm1(-period_s / memory_s)

    def observe(self, visible: Mask, marked: Mask, periods: int) -> None:
        """Update with the `visible` and the marked cells of a frame, `periods` after the previous one."""
        kept = (1.0 - self._lost) ** periods
        keep, counts = np.where(visible, np.float32(kept), np.float32(1.0)), np.float32((1.0 - kept) / self._lost)
        self.visible = self.visible * keep + counts * visible.astype(np.float32)
        self.marked = self.marked * keep + counts * marked.astype(np.float32)

    def scroll(self, shift: Shift) -> None:
        """Move the record with the window; cells that come in were never seen."""
        self.visible, self.marked = (rolled(record, shift, 0.0) for record in (self.visible, self.marked))


def open_cells(frame: GridFrame) -> Mask:
    """The cells (M, M) that a frame shows open: seen empty with all their neighbours in the window.

    A neighbour that no beam reached may be a wall: beams that pass a wall at a small angle cross the corners of its
    cells and hide the cells behind. If beams are further apart than a cell, no cell is open.
    """
    return np.asarray(~with_neighbours(~frame.visible | frame.occupied))


class OpenSpace:
    """For each cell (M, M), the share of open frames (`open_cells`) among recent frames that saw it.

    Walls that come into view were hidden before, and noise moves returns by a cell only: there no cell is ever open. A
    walker enters cells that were open before. An object that has stood in a cell for about three time constants is no
    longer taken for an object that moves.
    """

    def __init__(self, shape: tuple[int, int], period_s: float) -> None:
        self._record = FadingRecord(shape, period_s, MEMORY_S)

    def observe(self, frame: GridFrame, periods: int) -> None:
        """Update with a frame, `periods` after the previous one."""
        self._record.observe(frame.visible, open_cells(frame), periods)

    def scroll(self, shift: Shift) -> None:
        """Move the record with the window; cells that come in were never seen."""
        self._record.scroll(shift)

    def closed(self, share: float) -> Mask:
        """The cells (M, M) that were open in at most this share of the frames, or never visible."""
        return np.asarray(self._record.marked <= np.float32(share) * self._record.visible)

"""Open space: cells that were seen empty. A return in such a cell has moved in; elsewhere it may always have stood."""

from __future__ import annotations

import numpy as np

from gridtrack.common.grid import GridFrame, Mask, Shift, with_neighbours
from gridtrack.trackers.fading_record import FadingRecord

MEMORY_S = 5.0
"""Time constant of the record, of the time in which a cell was visible."""


def open_cells(frame: GridFrame) -> Mask:
    """The cells (M, M) that a frame shows open: seen empty with all their neighbours in the window.

    A neighbour that no beam reached may be a wall: beams that pass a wall at a small angle cross the corners of its
    cells, and what lies behind those is hidden. Where beams are further apart than a cell, no cell is open.
    """
    return np.asarray(~with_neighbours(~frame.visible | frame.occupied))


class OpenSpace:
    """For each cell (M, M), in which share of the recent frames in which it was visible it was open (`open_cells`).

    Walls that come into view were hidden before, and noise moves returns by a cell only: there no cell is ever open. A
    walker enters cells that were open before. What has stood in a cell for about three time constants is no longer
    taken for an object that moves.
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

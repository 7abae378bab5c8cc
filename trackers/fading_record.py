"""A record of what was seen in each cell, which fades while the cell is visible."""

from __future__ import annotations

import math

import numpy as np

from gridtrack.common.grid import Mask, Shift, rolled


class FadingRecord:
    """In how many recent frames each cell was visible, and in how many it had a mark: `visible`, `marked` (M, M).

    Both forget with the time constant `memory_s`, of the time in which the cell was visible. A frame counts for the
    periods since the previous one.
    """

    def __init__(self, shape: tuple[int, int], period_s: float, memory_s: float) -> None:
        self.visible, self.marked = np.zeros((2, *shape), np.float32)
        self._lost = -math.expm1(-period_s / memory_s)

    def observe(self, visible: Mask, marked: Mask, periods: int) -> None:
        """Update with the `visible` cells of a frame, `periods` after the previous one, and those with a mark."""
        kept = (1.0 - self._lost) ** periods
        keep, counts = np.where(visible, np.float32(kept), np.float32(1.0)), np.float32((1.0 - kept) / self._lost)
        self.visible = self.visible * keep + counts * visible.astype(np.float32)
        self.marked = self.marked * keep + counts * marked.astype(np.float32)

    def scroll(self, shift: Shift) -> None:
        """Move the record with the window; cells that come in were never seen."""
        self.visible, self.marked = (rolled(record, shift, 0.0) for record in (self.visible, self.marked))

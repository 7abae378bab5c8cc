"""The time since each cell was last seen, in a window that scrolls with the sensor."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import Mask, Shift, rolled


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

"""The window of the grid in the fixed frame, in which positions are kept while the window scrolls with the sensor."""

from __future__ import annotations

import numpy as np

from gridtrack.common.grid import GridSpec, Shift
from gridtrack.trackers.model_free.arrays import Array


class Window:
    """Where the grid lies in the fixed frame, which is the grid frame of the first update and does not move.

    The axes of the fixed frame are the world's; its origin is near the sensor, so that coordinates stay small wherever
    the origin of the world is. `shift` is how far the window has moved since then, in whole cells; `fixed_grid` is the
    grid with its corner in the fixed frame; `offset_m` (2,) leads from the grid frame to the fixed frame.
    """

    __slots__ = ("fixed_grid", "grid", "offset_m", "shift")

    def __init__(self, grid: GridSpec, shift: Shift = Shift()) -> None:  # noqa: B008 (immutable)
        self.grid, self.shift = grid, shift
        self.offset_m: Array = np.array([shift.columns, shift.rows]) * grid.cell_m
        x, y = (np.array(grid.origin) + self.offset_m).tolist()
        self.fixed_grid = GridSpec(grid.size, grid.cell_m, (x, y)) if shift else grid

    def moved(self, by: Shift) -> Window:
        """The window after it moved on."""
        return Window(self.grid, Shift(self.shift.rows + by.rows, self.shift.columns + by.columns))

"""Values per cell that were learned at a site: they keep their place in the world while the window scrolls."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, Mask, Shift, rolled, shift_between


class SiteMap:
    """Values (..., M, M) of the cells of a grid of cells of `cell_m` that lay at `world_T_grid`.

    Without that pose the map lies in the window of the first frame. Cells of a window that are not on the map have the
    value `outside`, a scalar or an array that can be broadcast to the values. `size`: the cells a side of the window,
    where the map is larger.
    """

    def __init__(
        self,
        values: NDArray[Any],
        outside: Any,
        cell_m: float,
        world_T_grid: SE2 | None = None,
        size: int | None = None,
    ) -> None:
        self._values, self._outside, self._cell_m, self._world_T_map = values, outside, cell_m, world_T_grid
        self._size = size
        self.unmoved = values if size is None else rolled(values, Shift(), outside, size=size)
        """The values (..., M, M) in a window at the pose of the map, read-only."""
        self._shift, self._in_window = Shift(), self.unmoved

    def at(self, world_T_grid: SE2) -> NDArray[Any]:
        """The values (..., M, M) in the window at this pose, read-only; the same array until the window moves.

        Raises RecordingError for a pose that is not a whole number of cells from that of the map.
        """
        if self._world_T_map is None:
            self._world_T_map = world_T_grid
        shift = shift_between(self._world_T_map, world_T_grid, self._cell_m)
        if shift != self._shift:
            self._shift, self._in_window = shift, rolled(self._values, shift, self._outside, size=self._size)
        return self._in_window


def mean_of_cells(values: NDArray[np.floating]) -> NDArray[Any]:
    """The mean of values (..., M, M) over all cells, (..., 1, 1): what is known of a cell that is not on the map."""
    return np.asarray(values.mean(axis=(-2, -1), keepdims=True, dtype=np.float64).astype(values.dtype))


def marks_in_window(world_T_grid: SE2, frame: GridFrame, marks: Mask, cell_m: float) -> Mask:
    """The `marks` (..., M, M) of a frame in the window at another pose: unset where the frame does not reach."""
    shift = shift_between(frame.world_T_grid, world_T_grid, cell_m)
    return rolled(marks, shift, False) if shift else marks

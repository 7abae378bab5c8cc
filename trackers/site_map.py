"""Values per cell that were learned at a site: occupancy rates counted there, in a window that scrolls."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, Mask, Shift, rolled, shift_between

PRIOR_FRAMES = 20.0
"""Weight of the prior, in frames."""
NO_MAP = "the sensor moves: no map of the place is learned, every cell has the mean rate"
"""Reported by a training on recordings of a moving sensor."""
Marks = Callable[[GridFrame], Sequence[Mask]]
"""The masks to count in a frame: K of (M, M)."""


class SiteMap:
    """Values (..., M, M) of the cells of a grid of cells of `cell_m` that lay at `world_T_grid`.

    Without that pose the map lies in the window of the first frame. Cells of a window that are not on the map have the
    value `outside`, a scalar or an array that can be broadcast to the values. `size`: the cells a side of the window,
    if the map is larger.
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
        self._size, self._shift = size, Shift()
        self.in_window = values if size is None else rolled(values, Shift(), outside, size=size)
        """The values (..., M, M) in the last window, at first in one at the pose of the map; read-only."""

    def at(self, world_T_grid: SE2) -> NDArray[Any]:
        """The values (..., M, M) in the window at this pose, read-only; the same array until the window moves.

        Raises RecordingError for a pose that is not a whole number of cells from the pose of the map.
        """
        if self._world_T_map is None:
            self._world_T_map = world_T_grid
        shift = shift_between(self._world_T_map, world_T_grid, self._cell_m)
        if shift != self._shift:
            self._shift, self.in_window = shift, rolled(self._values, shift, self._outside, size=self._size)
        return self.in_window


def mean_of_cells(values: NDArray[np.floating]) -> NDArray[Any]:
    """The mean of values (..., M, M) over all cells, (..., 1, 1): the value of a cell that is not on the map."""
    return np.asarray(values.mean(axis=(-2, -1), keepdims=True, dtype=np.float64).astype(values.dtype))


def marks_in_window(world_T_grid: SE2, frame: GridFrame, marks: Mask, cell_m: float) -> Mask:
    """The `marks` (..., M, M) of a frame in the window at another pose: unset in cells outside the frame."""
    shift = shift_between(frame.world_T_grid, world_T_grid, cell_m)
    return rolled(marks, shift, False) if shift else marks


def count_anywhere(sources: Sequence[Iterable[GridFrame]], marks: Marks) -> NDArray[np.float64]:
    """In how many frames the `marks` are set, (K, 1, 1), the mean over all cells: for weights of no place."""
    frames = (frame for source in sources for frame in source)
    return np.asarray(sum(np.stack(marks(frame)).mean(axis=(1, 2), keepdims=True) for frame in frames))


def count_frames(
    sources: Sequence[Iterable[GridFrame]], cell_m: float, marks: Marks
) -> tuple[NDArray[np.float64], bool]:
    """In how many frames of all sources each of K `marks` (M, M) is set, (K, M, M), and whether a sensor moves.

    The cells are in the window of the first frame; sources with a sensor that stands elsewhere are counted at their
    place. A sensor that moves learns no place, because the world frames of other recordings begin elsewhere: the counts
    are then the same in every cell, the mean over all cells.
    """
    first, moves = None, False
    placed, everywhere = np.zeros(()), np.zeros(())
    for source in sources:
        start = None
        for frame in source:
            start = start or frame.world_T_grid
            first = first or start
            moves = moves or frame.world_T_grid != start
            marked = np.stack(marks(frame))
            everywhere = everywhere + marked.mean(axis=(1, 2), keepdims=True)
            placed = placed + (marked if moves else marks_in_window(first, frame, marked, cell_m))
    return (np.broadcast_to(everywhere, placed.shape) if moves else placed), moves


def posterior_rate(counted: NDArray[np.float64], visible: NDArray[np.float64]) -> NDArray[np.float32]:
    """Posterior mean (M, M) float32 of the rate of the `counted` (M, M) among the `visible` frames (M, M) of each cell.

    The Beta prior has the weight of PRIOR_FRAMES frames and the mean rate of all visible cells, so that a cell that was
    never seen, or never seen occupied, has a small positive probability.
    """
    base_rate = counted.sum() / max(visible.sum(), 1.0)
    return np.asarray((counted + PRIOR_FRAMES * base_rate) / (visible + PRIOR_FRAMES), np.float32)

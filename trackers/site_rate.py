"""The occupancy rate of each cell of a site: counts of frames, and rates with a Beta prior."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import GridFrame, Mask
from gridtrack.trackers.site_map import marks_in_window

PRIOR_FRAMES = 20.0
"""Weight of the prior, in frames."""
NO_MAP = "the sensor moves: no map of the place is learned, every cell has the mean rate"
"""What a training on such recordings reports."""

Marks = Callable[[GridFrame], Sequence[Mask]]
"""What is counted in a frame: K masks (M, M)."""


def count_anywhere(sources: Sequence[Iterable[GridFrame]], marks: Marks) -> NDArray[np.float64]:
    """In how many frames the `marks` are set, (K, 1, 1), the mean over all cells: for weights of no place."""
    frames = (frame for source in sources for frame in source)
    return np.asarray(sum(np.stack(marks(frame)).mean(axis=(1, 2), keepdims=True) for frame in frames))


def count_frames(
    sources: Sequence[Iterable[GridFrame]], cell_m: float, marks: Marks
) -> tuple[NDArray[np.float64], bool]:
    """In how many frames of all sources each of K `marks` (M, M) is set, (K, M, M), and whether a sensor moves.

    The cells are those of the window of the first frame; sources whose sensor stands elsewhere are counted at their
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

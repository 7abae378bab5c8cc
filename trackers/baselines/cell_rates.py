"""The occupied rate of each cell of a window: from a map of the place, or from the frames of the stream so far."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec, rolled, shift_between
from gridtrack.trackers.site_map import SiteMap


class LearnedRates:
    """The rates of a map; cells that are not on it have its overall rate."""

    def __init__(self, place: SiteMap) -> None:
        self._place = place
        self.in_window = place.unmoved
        """P(occupied) (M, M) float32; before the first frame in a window where the map begins."""

    def observe(self, frame: GridFrame) -> None:
        """Take the part of the map that lies in the window of a frame."""
        self.in_window = self._place.at(frame.world_T_grid)


class RunningRates:
    """The rates of the stream so far; the `overall` rate of other places is a prior of `prior_frames` frames."""

    def __init__(self, grid: GridSpec, overall: float, prior_frames: float) -> None:
        self._cell_m, self._overall, self._prior_frames = grid.cell_m, overall, prior_frames
        self._visible, self._occupied = np.zeros((2, *grid.shape))
        self._window: SE2 | None = None

    def observe(self, frame: GridFrame) -> None:
        """Count a frame; cells that come into the window were never seen."""
        shift = shift_between(self._window or frame.world_T_grid, frame.world_T_grid, self._cell_m)
        self._window = frame.world_T_grid
        self._visible = rolled(self._visible, shift, 0.0) + frame.visible
        self._occupied = rolled(self._occupied, shift, 0.0) + frame.occupied

    @property
    def in_window(self) -> NDArray[np.float32]:
        """P(occupied) (M, M) float32."""
        return smoothed_rate(self._occupied, self._visible, self._overall, self._prior_frames)


def smoothed_rate(
    occupied: NDArray[np.floating | np.integer],
    visible: NDArray[np.floating | np.integer],
    overall: float,
    prior_frames: float,
) -> NDArray[np.float32]:
    """P(occupied) (M, M) from counts of frames (M, M), with the `overall` rate as a prior of weight `prior_frames`.

    A cell that was never visible has the overall rate.
    """
    seen = visible + prior_frames
    smoothed = np.full(visible.shape, overall)
    np.divide(occupied + prior_frames * overall, seen, out=smoothed, where=seen > 0)
    return smoothed.astype(np.float32)

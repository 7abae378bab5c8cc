"""The same stream in a window that scrolls: a sensor that moves sees the world as one that stands does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec, Shift, rolled

WORLD = SE2(512.0, -1024.0)
"""Pose of the first window; whole numbers, so that moving by cells of an eighth or a quarter is exact."""


def scrolled(frame: GridFrame, shift: Shift, grid: GridSpec) -> GridFrame:
    """The `frame` as it is after the window moved by `shift`: cells that come in are not visible."""
    visible, occupied = (rolled(cells, shift, False) for cells in (frame.visible, frame.occupied))
    offset = np.array([shift.columns, shift.rows]) * grid.cell_m
    points = (frame.points - offset).astype(np.float32)
    inside = grid.cells_of(points)[1]
    return replace(
        frame,
        visible=visible,
        occupied=occupied,
        world_T_grid=SE2(WORLD.x + offset[0], WORLD.y + offset[1]),
        origins=(frame.origins - offset).astype(np.float32),
        points=points[inside],
        point_origin=frame.point_origin[inside],
    )

"""Strata: the regions of cells that are scored apart, so that false alarms have a home."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import SE2, wrap_angle
from gridtrack.common.grid import GridFrame, GridSpec, Mask

REGIONS = ("ring", "static", "moving")
"""Disjoint regions of a grid; a region array (M, M) uint8 holds indices into this."""
STRATA = ("visible", "moving", "static")
SUMS_OF_REGIONS = np.array([[1, 1, 1], [0, 0, 1], [0, 1, 0]])
"""(strata, regions): which regions each stratum is the sum of. The ring round static cells counts as visible only."""


def regions_of(frames: Iterable[GridFrame], grid: GridSpec, world_T_grid: SE2) -> NDArray[np.uint8]:
    """Region of each cell (M, M), from every frame of a recording whose grid lies at `world_T_grid`.

    Static: occupied in more than half of the frames in which the cell is visible. Ring: the eight neighbours of a
    static cell, where range noise flickers. Moving: all others.
    """
    seen, hits = np.zeros(grid.shape, np.int64), np.zeros(grid.shape, np.int64)
    for frame in frames:
        if same_place(frame.world_T_grid, world_T_grid):
            seen += frame.visible
            hits += frame.occupied
    static = 2 * hits > seen
    regions = np.full(grid.shape, REGIONS.index("moving"), np.uint8)
    regions[_with_neighbours(static)] = REGIONS.index("ring")
    regions[static] = REGIONS.index("static")
    return regions


def same_place(one: SE2, other: SE2) -> bool:
    """Whether two poses of a grid agree to a millimetre and a milliradian: its cells are then the same places."""
    turned = abs(wrap_angle(one.theta - other.theta))
    return max(abs(one.x - other.x), abs(one.y - other.y), turned) < 1e-3


def _with_neighbours(cells: Mask) -> Mask:
    """The marked cells (M, M) and their eight neighbours."""
    rows = cells.copy()
    rows[1:] |= cells[:-1]
    rows[:-1] |= cells[1:]
    grown = rows.copy()
    grown[:, 1:] |= rows[:, :-1]
    grown[:, :-1] |= rows[:, 1:]
    return grown

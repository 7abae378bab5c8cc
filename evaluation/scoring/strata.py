"""Strata: the regions of cells that are scored apart, so that false alarms have a home."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import SE2, wrap_angle
from gridtrack.common.grid import GridFrame, GridSpec, Mask, with_neighbours

CELL_KINDS = ("ring", "static", "moving")
"""Disjoint kinds of cells; an array `cell_kinds` (M, M) uint8 holds indices into this."""
RANGES_M = (5.0, 10.0)
"""Where bands of the distance to the nearest sensor end; the last has no end."""
AGES_S = (0.5, 1.0, 2.0, 4.0)
"""Where bands of the time since a cell was last seen end; the last has no end, and holds cells never seen."""

_RANGE_NAMES = ("to 5 m", "5-10 m", "over 10 m")
_AGE_NAMES = ("to 0.5 s", "0.5-1 s", "1-2 s", "2-4 s", "over 4 s")
_STANDING, _MOVING = range(2)
SEEN_REGIONS = tuple(product(CELL_KINDS, _RANGE_NAMES))
HIDDEN_REGIONS = tuple(product((_STANDING, _MOVING), _AGE_NAMES))
REGIONS = len(SEEN_REGIONS) + len(HIDDEN_REGIONS)
"""Disjoint regions that every scored cell falls into: by kind and range where it is visible, where not by whether
what moves could be there and by age. Strata are sums of them."""


def _seen(cell_kinds: Iterable[str] = CELL_KINDS, ranges: Iterable[str] = _RANGE_NAMES) -> list[int]:
    return [SEEN_REGIONS.index(region) for region in product(cell_kinds, ranges)]


def _hidden(motions: Iterable[int] = (_STANDING, _MOVING), ages: Iterable[str] = _AGE_NAMES) -> list[int]:
    return [len(SEEN_REGIONS) + HIDDEN_REGIONS.index(region) for region in product(motions, ages)]


_REGIONS_OF: Mapping[str, list[int]] = {
    "visible": _seen(),
    "moving": _seen(["moving"]),
    "static": _seen(["static"]),
    **{f"visible {name}": _seen(ranges=[name]) for name in _RANGE_NAMES},
    "occluded": _hidden(),
    "occluded moving": _hidden([_MOVING]),
    **{f"occluded {name}": _hidden(ages=[name]) for name in _AGE_NAMES},
}
STRATA = ("visible", "moving", "static")
"""Strata of a recording without truth. The ring round static cells counts as visible only."""
STRATA_WITH_TRUTH = tuple(_REGIONS_OF)
"""Strata of a recording that knows what was truly there: those without truth first, so that indices agree."""
THRESHOLD_OF = {
    name: "visible" if name.startswith("visible ") else "occluded" if name.startswith("occluded ") else name
    for name in STRATA_WITH_TRUTH
}
"""The stratum whose threshold each one shares: bands are scored at that of the whole."""
SUMS_OF_REGIONS = np.array([np.bincount(regions, minlength=REGIONS) for regions in _REGIONS_OF.values()])
"""(strata with truth, regions): which regions each stratum is the sum of."""


@dataclass(frozen=True, slots=True)
class RegionMaps:
    """Where the cells of a stretch belong.

    `visible` (M, M) uint8: the region of a cell when it is visible. `hidden` (M, M) uint8: when it is not and has just
    been seen; the band of its age is added to that. `cell_kinds` (M, M) uint8; `strata` are the names of those scored.
    """

    visible: NDArray[np.uint8]
    hidden: NDArray[np.uint8]
    cell_kinds: NDArray[np.uint8]
    strata: tuple[str, ...]


def region_maps_of(
    cell_kinds: NDArray[np.uint8], grid: GridSpec, origins: NDArray[np.float32], strata: tuple[str, ...] = STRATA
) -> RegionMaps:
    """Region maps of a stretch whose sensors stand at `origins` (S, 2), metres, grid frame."""
    centres = grid.cell_centres(np.ones(grid.shape, np.bool_)).astype(np.float64)
    distance = np.linalg.norm(centres - origins.reshape(-1, 1, 2), axis=2).min(axis=0, initial=np.inf)
    band = np.searchsorted(RANGES_M, distance).reshape(grid.shape)
    moving = cell_kinds == CELL_KINDS.index("moving")
    visible = cell_kinds * len(_RANGE_NAMES) + band
    hidden = len(SEEN_REGIONS) + np.where(moving, _MOVING, _STANDING) * len(_AGE_NAMES)
    return RegionMaps(visible.astype(np.uint8), hidden.astype(np.uint8), cell_kinds, strata)


def cell_kinds_of(frames: Iterable[GridFrame], grid: GridSpec, world_T_grid: SE2) -> NDArray[np.uint8]:
    """Kind of each cell (M, M), from every frame of a recording whose grid lies at `world_T_grid`.

    Static: occupied in more than half of the frames in which the cell is visible. Ring: the eight neighbours of a
    static cell, where range noise flickers. Moving: all others.
    """
    seen, hits = np.zeros(grid.shape, np.int64), np.zeros(grid.shape, np.int64)
    for frame in frames:
        if same_pose(frame.world_T_grid, world_T_grid):
            seen += frame.visible
            hits += frame.occupied
    return cell_kinds_around(2 * hits > seen)


def cell_kinds_around(static: Mask) -> NDArray[np.uint8]:
    """Kind of each cell (M, M), from those that are static."""
    cell_kinds = np.full(static.shape, CELL_KINDS.index("moving"), np.uint8)
    cell_kinds[with_neighbours(static)] = CELL_KINDS.index("ring")
    cell_kinds[static] = CELL_KINDS.index("static")
    return cell_kinds


class LastSeen:
    """When each cell was last seen, since the stream began."""

    def __init__(self) -> None:
        self._stamp_ns: NDArray[np.int64] | None = None

    def add(self, frame: GridFrame) -> None:
        """The next frame."""
        if self._stamp_ns is None:
            self._stamp_ns = np.full(frame.visible.shape, np.iinfo(np.int64).min // 2)
        self._stamp_ns[frame.visible] = frame.stamp_ns

    def bands(self, now_ns: int) -> NDArray[np.uint8]:
        """The band (M, M) of AGES_S that each cell's age falls into: an age of 0.5 s is in the first."""
        assert self._stamp_ns is not None
        bands = np.zeros(self._stamp_ns.shape, np.uint8)
        for age_s in AGES_S:
            bands += now_ns - self._stamp_ns > round(age_s * 1e9)
        return bands


def same_pose(one: SE2, other: SE2) -> bool:
    """Whether two poses of a grid agree to a millimetre and a milliradian: a cell is then the same place in both."""
    turned = abs(wrap_angle(one.theta - other.theta))
    return max(abs(one.x - other.x), abs(one.y - other.y), turned) < 1e-3

"""Strata: sets of cells that are scored separately, false alarms included."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import product
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec, Mask, rolled, shift_between, with_neighbours

SCORING_RULES: Final = 2
"""Number of the rules by which forecasts are scored: kinds of cells, strata, counts. A change of them adds one: scores
by other rules are not continued by a resumed run, and are no baseline."""

CELL_KINDS = ("ring", "static", "dynamic")
"""Disjoint kinds of cells; an array `cell_kinds` (M, M) uint8 holds indices into this."""
RANGES_M = (5.0, 10.0)
"""Upper ends of the bands of distance to the nearest sensor, m; one more band is beyond the last."""
AGES_S = (0.5, 1.0, 2.0, 4.0)
"""Upper ends of the age bands (time since a cell was visible), s; one more band also has the cells never visible."""

PARTS = ("open", "standing", "in-motion")
"""Parts of the dynamic cells of an observed frame; an array `motion` (M, M) uint8 holds indices into this, and 0 for
cells of other kinds."""

RANGE_NAMES = ("to 5 m", "5-10 m", "over 10 m")
_AGE_NAMES = ("to 0.5 s", "0.5-1 s", "1-2 s", "2-4 s", "over 4 s")
_STATIC, _DYNAMIC = range(2)
_DYNAMIC_PARTS = tuple(f"dynamic {part}" for part in PARTS)
_SEEN_KINDS = (*CELL_KINDS[:-1], *_DYNAMIC_PARTS)
SEEN_REGIONS = tuple(product(_SEEN_KINDS, RANGE_NAMES))
RANGES = len(RANGE_NAMES)
"""Number of bands of distance to the nearest sensor."""
HIDDEN_REGIONS = tuple(product((_STATIC, _DYNAMIC), _AGE_NAMES))
REGIONS = len(SEEN_REGIONS) + len(HIDDEN_REGIONS)
"""Number of disjoint regions: visible cells by kind, part and range, hidden ones by whether they are dynamic and by
age. Strata are sums of regions."""


def _seen(kinds: Iterable[str] = _SEEN_KINDS, ranges: Iterable[str] = RANGE_NAMES) -> list[int]:
    return [SEEN_REGIONS.index(region) for region in product(kinds, ranges)]


def _hidden(motions: Iterable[int] = (_STATIC, _DYNAMIC), ages: Iterable[str] = _AGE_NAMES) -> list[int]:
    return [len(SEEN_REGIONS) + HIDDEN_REGIONS.index(region) for region in product(motions, ages)]


OCCLUDED = "occluded"
"""The stratum of all hidden cells."""

_REGIONS_OF: Mapping[str, list[int]] = {
    "visible": _seen(),
    "dynamic": _seen(_DYNAMIC_PARTS),
    "static": _seen(["static"]),
    "in-motion": _seen(["dynamic open", "dynamic in-motion"]),
    "standing": _seen(["dynamic standing"]),
    **{f"visible {name}": _seen(ranges=[name]) for name in RANGE_NAMES},
    OCCLUDED: _hidden(),
    "occluded dynamic": _hidden([_DYNAMIC]),
    **{f"occluded {name}": _hidden(ages=[name]) for name in _AGE_NAMES},
}
STRATA = ("visible", "dynamic", "static", "in-motion", "standing")
"""Strata of a recording without truth. The ring round static cells is part of `visible` only."""
STRATA_WITH_TRUTH = tuple(_REGIONS_OF)
"""Strata of a recording with truth: first STRATA, so that indices agree."""
THRESHOLD_OF = {
    name: "visible" if name.startswith("visible ") else "occluded" if name.startswith("occluded ") else name
    for name in STRATA_WITH_TRUTH
}
"""By stratum the stratum of its threshold: bands use the threshold of the whole."""
SUMS_OF_REGIONS = np.array([np.bincount(regions, minlength=REGIONS) for regions in _REGIONS_OF.values()])
"""(strata with truth, regions): 1 where the region is part of the stratum."""


@dataclass(frozen=True, slots=True)
class RegionMaps:
    """The region of each cell of a window.

    `visible` (M, M) uint8: the region of a cell while it is visible; a dynamic cell's is an open cell's plus RANGES
    times the index of its part. `hidden` (M, M) uint8: its region while it is hidden, at age 0; the index of its age
    band is added. `cell_kinds` (M, M) uint8; `strata`: names of those scored.
    """

    visible: NDArray[np.uint8]
    hidden: NDArray[np.uint8]
    cell_kinds: NDArray[np.uint8]
    strata: tuple[str, ...]

    @property
    def dynamic(self) -> Mask:
        """The dynamic cells (M, M) of the window."""
        cells: Mask = self.cell_kinds == CELL_KINDS.index("dynamic")
        return cells


def region_maps_of(
    cell_kinds: NDArray[np.uint8], grid: GridSpec, origins: NDArray[np.float32], strata: tuple[str, ...] = STRATA
) -> RegionMaps:
    """Region maps of a window with sensors at `origins` (S, 2), metres, grid frame."""
    centres = grid.cell_centres(np.ones(grid.shape, np.bool_)).astype(np.float64)
    distance = np.linalg.norm(centres - origins.reshape(-1, 1, 2), axis=2).min(axis=0, initial=np.inf)
    band = np.searchsorted(RANGES_M, distance).reshape(grid.shape)
    dynamic = cell_kinds == CELL_KINDS.index("dynamic")
    visible = cell_kinds * RANGES + band
    hidden = len(SEEN_REGIONS) + np.where(dynamic, _DYNAMIC, _STATIC) * len(_AGE_NAMES)
    return RegionMaps(visible.astype(np.uint8), hidden.astype(np.uint8), cell_kinds, strata)


def cell_kinds_around(static: Mask) -> NDArray[np.uint8]:
    """Kind of each cell (M, M) uint8, from the mask of static cells."""
    cell_kinds = np.full(static.shape, CELL_KINDS.index("dynamic"), np.uint8)
    cell_kinds[with_neighbours(static)] = CELL_KINDS.index("ring")
    cell_kinds[static] = CELL_KINDS.index("static")
    return cell_kinds


_NEVER_NS = np.iinfo(np.int64).min // 2


class LastSeen:
    """The stamp at which each cell of the window was last visible; it moves with the window."""

    def __init__(self) -> None:
        self._window: SE2 | None = None
        self._stamp_ns: NDArray[np.int64] | None = None

    def add(self, frame: GridFrame, cell_m: float) -> None:
        """Update with the next frame, of a grid with cells of `cell_m`."""
        if self._window is None or self._stamp_ns is None:
            self._stamp_ns = np.full(frame.visible.shape, _NEVER_NS)
        elif frame.world_T_grid != self._window:
            shift = shift_between(self._window, frame.world_T_grid, cell_m)
            self._stamp_ns = rolled(self._stamp_ns, shift, _NEVER_NS)
        self._window = frame.world_T_grid
        self._stamp_ns[frame.visible] = frame.stamp_ns

    def bands(self, now_ns: int) -> NDArray[np.uint8]:
        """Age band (M, M) uint8 of each cell, an index into AGES_S: an age of 0.5 s is in the first band."""
        assert self._stamp_ns is not None
        bands = np.zeros(self._stamp_ns.shape, np.uint8)
        for age_s in AGES_S:
            bands += now_ns - self._stamp_ns > round(age_s * 1e9)
        return bands

"""The expected scan of a known scene: probabilities that each cell is visible, and that it is occupied."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import FRACTION_BITS, GridSpec, snapped
from gridtrack.common.raycast import MAX_COORDINATE_CELLS, clip, directions_of, first_cell, snap, turned
from gridtrack.common.scan import Scan
from gridtrack.common.scene import Scene
from gridtrack.recordings.observation import reference_pose
from gridtrack.simulation.laser import sweep

BAND_M = 1.0
"""Width of a band of true range with one error distribution."""
MIN_ERRORS = 1000
"""A band with fewer errors uses the errors of all ranges."""
PARALLEL = 2.0 ** -(FRACTION_BITS + 1)
"""A beam is parallel to a grid line if its direction differs by less than this."""
CORNER = 1e-11
"""A beam that passes the corner of a cell at less than this distance (cells) does not enter the cell beside it."""


@dataclass(frozen=True, slots=True)
class RangeErrors:
    """Errors (measured minus true range) of one laser, metres, by band of true range.

    The last band is for beams without a true return, with the measured range itself. `values` (N,) float64, ascending
    within each band: -inf for an invalid range, +inf for a lost return. Band b has `values[starts[b] : ends[b]]`;
    `starts`, `ends` (bands,) int64.
    """

    values: NDArray[np.float64]
    starts: NDArray[np.int64]
    ends: NDArray[np.int64]

    def bands(self, true_ranges: NDArray[np.float32]) -> NDArray[np.int64]:
        """The band (B,) of each true range (B,), which is +inf without a surface in range."""
        last = self.starts.size - 1
        nearer = np.floor(np.where(np.isfinite(true_ranges), true_ranges, 0.0) / BAND_M).astype(np.int64)
        return np.where(np.isfinite(true_ranges), np.minimum(nearer, last - 1), last)


def measure_range_errors(scans: Iterable[tuple[Scan, Scene]], every: int = 1) -> dict[str, RangeErrors]:
    """The range errors of each sensor, from every `every`-th of its scans, each with its true scene."""
    found: dict[str, list[tuple[NDArray[np.float32], NDArray[np.float32]]]] = {}
    count: Counter[str] = Counter()
    for scan, scene in scans:
        if count[scan.sensor] % every == 0:
            found.setdefault(scan.sensor, []).append((true_ranges(scan, scene), scan.ranges))
        count[scan.sensor] += 1
    return {sensor: _by_band(*map(np.concatenate, zip(*pairs, strict=True))) for sensor, pairs in found.items()}


def true_ranges(scan: Scan, scene: Scene) -> NDArray[np.float32]:
    """The ranges (B,) float32, metres, that the laser of `scan` would measure of `scene` without errors."""
    ranges, _ = sweep(
        scene, reference_pose(scan), scan.angle_min, scan.angle_increment, scan.ranges.size, scan.range_max
    )
    return ranges


def _by_band(true: NDArray[np.float32], measured: NDArray[np.float32]) -> RangeErrors:
    """Sort the errors by band and then by size."""
    returned = np.isfinite(true)
    errors = measured.astype(np.float64) - np.where(returned, true, 0.0)
    errors[np.isnan(errors)] = -np.inf
    bands = 1 + int(true[returned].max(initial=0.0) // BAND_M)
    band = np.where(returned, np.where(returned, true, 0.0) // BAND_M, bands).astype(np.int64)
    order = np.lexsort((errors, band))
    edges = np.searchsorted(band[order], np.arange(bands + 2))
    values, starts, ends = errors[order], edges[:-1].copy(), edges[1:].copy()
    few = ends - starts < MIN_ERRORS
    few[-1] = False
    if few.any():
        starts[few], ends[few] = values.size, values.size + int(returned.sum())
        values = np.concatenate([values, np.sort(errors[returned])])
    return RangeErrors(values, starts, ends)


@dataclass(frozen=True, slots=True)
class ExpectedScan:
    """Probabilities (M, M) float64 that a cell is not visible, and not occupied, in any of the scans added."""

    unseen: NDArray[np.float64]
    unoccupied: NDArray[np.float64]

    @classmethod
    def nothing(cls, grid: GridSpec) -> ExpectedScan:
        """Without a scan no cell is visible."""
        return cls(np.ones(grid.shape), np.ones(grid.shape))

    def add(
        self,
        scan: Scan,
        true_ranges: NDArray[np.float32],
        errors: RangeErrors,
        grid: GridSpec,
        grid_T_sensor: SE2,
    ) -> None:
        """Add a scan with the beams of `scan`; its ranges are `true_ranges` (B,), metres, with `errors`."""
        band = errors.bands(true_ranges)
        _add_beams(
            np.where(np.isfinite(true_ranges), true_ranges, 0.0).astype(np.float64),
            turned(directions_of(scan.angle_min, scan.angle_increment, true_ranges.size), grid_T_sensor.theta),
            errors.values,
            errors.starts[band],
            errors.ends[band],
            scan.range_min,
            scan.range_max,
            snapped((grid_T_sensor.x - grid.origin[0]) / grid.cell_m),
            snapped((grid_T_sensor.y - grid.origin[1]) / grid.cell_m),
            grid.cell_m,
            self.unseen.reshape(-1),
            self.unoccupied.reshape(-1),
            grid.size,
        )

    def occupied_where_visible(self) -> NDArray[np.float64]:
        """P(occupied | visible) (M, M); NaN for cells that no beam can reach."""
        visible = 1.0 - self.unseen
        found = np.full(visible.shape, np.nan)
        np.divide(1.0 - self.unoccupied, visible, out=found, where=visible > 0.0)
        return found


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _add_beams(base, directions, errors, starts, ends, range_min, range_max, x0, y0, cell_m, unseen, unoccupied, size):  # type: ignore[no-untyped-def]
    """Multiply `unseen` and `unoccupied` by the probabilities of each beam; coordinates in cells.

    The range of beam i is `base[i]` plus one of `errors[starts[i]:ends[i]]`, all equally probable.
    """
    if not abs(x0) + abs(y0) < MAX_COORDINATE_CELLS:
        return
    for i in range(base.size):
        own = errors[starts[i] : ends[i]]
        if own.size:
            valid = np.searchsorted(own, range_min - base[i])
            dx, dy = directions[i, 0], directions[i, 1]
            _walk(x0, y0, dx, dy, base[i], own, valid, range_max, cell_m, unseen, unoccupied, size)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _walk(x0, y0, dx, dy, base, errors, valid, range_max, cell_m, unseen, unoccupied, size):  # type: ignore[no-untyped-def]
    """Follow one beam from cell to cell (Amanatides and Woo, 1987) until its probability is 0.

    `errors[valid:]` give valid ranges, and `errors[before:]` ranges that reach the current cell.
    """
    across_x, across_y = 0.0 if abs(dx) < PARALLEL else dx, 0.0 if abs(dy) < PARALLEL else dy
    reach = range_max / cell_m
    enter, leave = clip(x0, y0, across_x * reach, across_y * reach, size)
    if enter >= leave:
        return
    enter *= reach
    column, row = first_cell(x0 + enter * dx, across_x, size), first_cell(y0 + enter * dy, across_y, size)
    exit_x, exit_y = _exit(x0, across_x, column), _exit(y0, across_y, row)
    step_x, step_y = 1.0 / abs(across_x), 1.0 / abs(across_y)
    before = max(valid, np.searchsorted(errors, enter * cell_m - base))
    while before < errors.size:
        after = _first_past(errors, before, base, range_max, cell_m, x0, y0, dx, dy, column, row)
        unseen[row * size + column] *= before / errors.size
        if after > before:
            length = (base + errors[before]) / cell_m
            end_row, end_column = math.floor(snap(y0 + dy * length)), math.floor(snap(x0 + dx * length))
            if 0 <= end_row < size and 0 <= end_column < size:
                unoccupied[end_row * size + end_column] *= 1.0 - (after - before) / errors.size
        exit_ = min(exit_x, exit_y)
        if exit_ >= reach:
            return
        if exit_x <= exit_ + CORNER:
            column += 1 if dx > 0.0 else -1
            exit_x += step_x
        if exit_y <= exit_ + CORNER:
            row += 1 if dy > 0.0 else -1
            exit_y += step_y
        if not (0 <= row < size and 0 <= column < size):
            return
        before = after


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _exit(start, along, cell):  # type: ignore[no-untyped-def]
    """Distance, in cells, at which a beam leaves its row or column `cell`."""
    return np.inf if along == 0.0 else (cell + (along > 0.0) - start) / along


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _first_past(errors, first, base, range_max, cell_m, x0, y0, dx, dy, column, row):  # type: ignore[no-untyped-def]
    """Index of the first of the ascending `errors[first:]` with which the beam ends beyond a cell."""
    if _past(base + errors[first], range_max, cell_m, x0, y0, dx, dy, column, row):
        return first
    if not _past(base + errors[-1], range_max, cell_m, x0, y0, dx, dy, column, row):
        return errors.size
    low, high = first, errors.size - 1
    while high - low > 1:
        middle = (low + high) // 2
        if _past(base + errors[middle], range_max, cell_m, x0, y0, dx, dy, column, row):
            high = middle
        else:
            low = middle
    return high


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _past(distance, range_max, cell_m, x0, y0, dx, dy, column, row):  # type: ignore[no-untyped-def]
    """Whether a beam of this range ends beyond a cell that it enters, with the arithmetic of `cast_scan`."""
    if distance > range_max:
        return True
    length = distance / cell_m
    x, y = snap(x0 + dx * length), snap(y0 + dy * length)
    past_x = x >= column + 1 if dx >= PARALLEL else (dx <= -PARALLEL and x < column)
    past_y = y >= row + 1 if dy >= PARALLEL else (dy <= -PARALLEL and y < row)
    return past_x or past_y

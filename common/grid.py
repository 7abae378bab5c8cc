"""The occupancy grid: its geometry (GridSpec), one observation (GridFrame, LabelledFrame), and its scrolling window."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.errors import ConfigurationError, RecordingError
from gridtrack.common.geometry import SE2, same_pose

MAX_ORIGIN_M = 1e6
Mask = NDArray[np.bool_]
Points = Literal["centres", "raw"]
"""The points of a frame: the centres of the occupied cells, or the returns of the laser."""
FRACTION_BITS = 40
RESOLUTION_CELLS = 2.0**-FRACTION_BITS
"""Coordinates in cells are rounded to this before the cell is found: a point that a rounding error puts beside a grid
line is on it, and belongs to the upper cell."""
TIE_DIGITS = 3
"""Decimals of a number of steps; a period of six digits makes further decimals inexact."""


@dataclass(frozen=True, slots=True)
class GridSpec:
    """M x M square cells parallel to the ground.

    Array index [row, column]; cell [r, c] covers `origin_m + [c, c+1) cell_m` in x and `origin_m + [r, r+1) cell_m`
    in y of the grid frame. Without an origin the grid is centred on the grid frame's origin.
    """

    size: int = 100
    cell_m: float = 0.2
    origin_m: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if not 1 <= self.size <= 4096:
            raise ConfigurationError(f"grid: {self.size} cells a side; expected 1 to 4096")
        if not 0.001 <= self.cell_m <= 100.0:
            raise ConfigurationError(f"grid: a cell of {self.cell_m} m; expected 0.001 to 100 m")
        if self.origin_m is None:
            half = -self.size * self.cell_m / 2.0
            object.__setattr__(self, "origin_m", (half, half))
        elif not all(abs(value) <= MAX_ORIGIN_M for value in self.origin_m):
            raise ConfigurationError(
                f"grid: origin {self.origin_m}; expected finite coordinates up to {MAX_ORIGIN_M:g} m"
            )

    @property
    def origin(self) -> tuple[float, float]:
        """Lower-left corner (x, y) of cell [0, 0], metres, grid frame."""
        assert self.origin_m is not None
        return self.origin_m

    @property
    def shape(self) -> tuple[int, int]:
        """(M, M)."""
        return (self.size, self.size)

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """(x_min, x_max, y_min, y_max) in metres, in the order of `extent` in matplotlib."""
        x, y = self.origin
        side = self.size * self.cell_m
        return (x, x + side, y, y + side)

    @classmethod
    def parse(cls, text: str) -> GridSpec:
        """Read `100x0.2` (cells x metres), optionally with the lower-left corner: `100x0.1@-2,-4.5`.

        Raises ConfigurationError.
        """
        number = r"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?|[-+]?\.\d+"
        match = re.fullmatch(rf"(\d{{1,9}})x({number})(?:@({number}),({number}))?", text.strip())
        if not match:
            raise ConfigurationError(f"grid '{text}': expected CELLSxMETRES such as 100x0.2, or 100x0.1@-2,-4.5")
        size, cell, x, y = match.groups()
        return cls(int(size), float(cell), None if x is None else (float(x), float(y)))

    def __str__(self) -> str:
        cell, x, y = (np.format_float_positional(value, trim="-") for value in (self.cell_m, *self.origin))
        return f"{self.size}x{cell}@{x},{y}"

    def cell_centres(self, cells: Mask) -> NDArray[np.float32]:
        """Centres (N, 2) float32 of the marked cells, metres, grid frame, in row-major order."""
        rows, columns = np.nonzero(cells)
        return (np.stack([columns, rows], axis=1) + 0.5).astype(np.float32) * np.float32(self.cell_m) + np.array(
            self.origin, np.float32
        )

    def cells_of(self, points: NDArray[np.floating]) -> tuple[NDArray[np.int64], Mask]:
        """Cells (N, 2) as [row, column] of points (N, 2) in the grid frame, and whether each lies inside (N,)."""
        scaled = (np.asarray(points, np.float64) - np.array(self.origin)) / self.cell_m
        scaled = np.floor(snapped(scaled)).astype(np.int64)
        return scaled[:, ::-1], ((scaled >= 0) & (scaled < self.size)).all(axis=1)


def snapped(coordinate: Any) -> Any:
    """A coordinate, or an array of them, in cells, rounded to RESOLUTION_CELLS."""
    return np.rint(coordinate / RESOLUTION_CELLS) * RESOLUTION_CELLS


@dataclass(frozen=True, slots=True)
class GridFrame:
    """One grid observation x_t.

    `visible`, `occupied` (M, M) bool, occupied within visible; `world_T_grid` the pose of the grid frame, which scrolls
    with the sensor: it moves by whole cells and never turns; `origins` (S, 2) float32, positions of the sensors,
    metres, grid frame; `points` (N, 2) float32, the returns inside the grid window, metres, grid frame, each from
    sensor `point_origin` (N,) uint8.

    >>> from gridtrack.recordings import packaged_recording
    >>> from gridtrack.recordings.stream import open_stream
    >>> frame = next(iter(open_stream(packaged_recording("leg_tracker"))))
    >>> frame.visible.shape, int(frame.occupied.sum()), frame.points.shape
    ((100, 100), 60, (60, 2))
    """

    stamp_ns: int
    visible: Mask
    occupied: Mask
    world_T_grid: SE2
    origins: NDArray[np.float32]
    points: NDArray[np.float32]
    point_origin: NDArray[np.uint8]


class LabelledFrame(NamedTuple):
    """A frame, and the classes of its labelled occupied cells.

    `cells` (N,) int64, row * M + column; `labels` (N,) uint8, indices into the recording's classes.
    """

    frame: GridFrame
    cells: NDArray[np.int64]
    labels: NDArray[np.uint8]


def window_about(world_T_sensor: SE2, cell_m: float) -> SE2:
    """`world_T_grid` of the window about a sensor: at a whole multiple of the cell, not turned."""
    return SE2(round(world_T_sensor.x / cell_m) * cell_m, round(world_T_sensor.y / cell_m) * cell_m)


class Shift(NamedTuple):
    """Motion of the window of a grid in whole cells: `rows` upwards (y) and `columns` to the right (x)."""

    rows: int = 0
    columns: int = 0

    def __bool__(self) -> bool:
        return self != (0, 0)


def shift_between(before: SE2, after: SE2, cell_m: float) -> Shift:
    """The motion of the window from pose `before` to `after`, both `world_T_grid`.

    Raises RecordingError if it turned, or moved by a part of a cell.
    """
    columns, rows = (after.x - before.x) / cell_m, (after.y - before.y) / cell_m
    shift = Shift(round(rows), round(columns))
    whole = SE2(before.x + shift.columns * cell_m, before.y + shift.rows * cell_m, before.theta)
    if not same_pose(after, whole):
        raise RecordingError(
            f"the window moved by {columns:g} x {rows:g} cells and turned by {after.theta - before.theta:g} rad: it"
            " moves by whole cells and never turns"
        )
    return shift


def rolled(
    values: NDArray[Any], shift: Shift, fill: Any, *, axes: tuple[int, int] = (-2, -1), size: int | None = None
) -> NDArray[Any]:
    """The values of cells after the window moved by `shift`: each value stays at its place in the world.

    `axes` of `values` are row and column. New cells get `fill`, a scalar or an array that broadcasts to the result.
    With `size` the result has `size` cells a side, cut from `values` of a larger area, such as a map; its first cell
    was the first cell of the window before the shift. The result is always a copy.
    """
    shape = list(values.shape)
    for axis in axes:
        shape[axis] = shape[axis] if size is None else size
    result = np.empty(shape, values.dtype)
    filling = np.broadcast_to(fill, result.shape)
    kept: list[slice] = [slice(None)] * values.ndim
    source = kept.copy()
    for axis, by in zip(axes, shift, strict=True):
        first = min(max(-by, 0), shape[axis])
        last = min(max(values.shape[axis] - by, first), shape[axis])
        kept[axis], source[axis] = slice(first, last), slice(first + by, last + by)
        for coming in (slice(first), slice(last, None)):
            cells = [slice(None)] * values.ndim
            cells[axis] = coming
            result[tuple(cells)] = filling[tuple(cells)]
    result[tuple(kept)] = values[tuple(source)]
    return result


def with_neighbours(cells: Mask) -> Mask:
    """The marked cells (M, M) and their eight neighbours."""
    rows = cells.copy()
    rows[1:] |= cells[:-1]
    rows[:-1] |= cells[1:]
    grown = rows.copy()
    grown[:, 1:] |= rows[:, :-1]
    grown[:, :-1] |= rows[:, 1:]
    return grown


def nearest_step(horizon_s: float, period_s: float) -> int:
    """The step nearest to a horizon; the even one of two that are equally near.

    Rounding makes it the same for a period of 1/7 s and for its first digits: half a second is step 4 at 7 Hz.
    """
    return round(round(horizon_s / period_s, TIE_DIGITS))

"""Small synthetic streams for the contract suite: moving boxes that occlude one another, and a drive to a wall."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec

BEAMS = 720
BOXES = 3
SPEED_MPS = 1.2
NS_PER_S = 1_000_000_000


def scene(
    grid: GridSpec, period_s: float, frames: int, seed: int, turn: tuple[int, int] | None = None
) -> list[GridFrame]:
    """`frames` frames of a random scene, observed by a sensor at rest near the left edge of the grid.

    `seed` determines the boxes. With `turn` = (frame, other seed), the other seed determines their velocities from
    that frame on: two scenes that differ only in the other seed have equal frames before it.
    """
    x_min, x_max, y_min, y_max = grid.extent
    side = x_max - x_min
    sensor = np.array([x_min + 0.2 * side, y_min + 0.45 * side])
    rng = np.random.default_rng(seed)
    centres = np.array([x_min, y_min]) + side * rng.uniform([0.4, 0.2], [0.8, 0.8], (BOXES, 2))
    velocities = _velocities(rng)
    wall_x = np.full(4 * grid.size, x_min + 0.95 * side - 0.5 * grid.cell_m)
    wall = np.stack([wall_x, np.linspace(y_min, y_max, 4 * grid.size, endpoint=False)], axis=1)
    outline = _outline(half_side=0.03 * side, spacing=0.3 * grid.cell_m)
    stream = []
    for index in range(frames):
        if turn is not None and index == turn[0]:
            velocities = _velocities(np.random.default_rng(turn[1]))
        surfaces = np.concatenate([wall, *(centre + outline for centre in centres)])
        stream.append(_seen(grid, sensor, surfaces, round(index * period_s * NS_PER_S)))
        centres = centres + velocities * period_s
    return stream


def drive(
    grid: GridSpec, period_s: float, frames: int, *, unseen: int, with_wall: bool
) -> tuple[list[GridFrame], NDArray[np.int64]]:
    """`frames` frames of a sensor that moves by one cell a frame, to the right, towards a wall across its way.

    Nothing is visible in the last `unseen` frames. Also returns the cells (N, 2) of the wall, [row, column], in the
    last window. Without the wall the sensor sees no surface.
    """
    x_min, x_max, y_min, _ = grid.extent
    side = x_max - x_min
    sensor = np.array([x_min + 0.2 * side, y_min + 0.45 * side])
    rows = np.arange(round(0.3 * grid.size), round(0.6 * grid.size))
    wall = np.stack([rows, np.full_like(rows, round(0.6 * grid.size))], axis=1)
    in_last_window = np.array([x_min, y_min]) + (wall[:, ::-1] + 0.5) * grid.cell_m
    nothing = np.zeros(grid.shape, bool)
    stream = []
    for index in range(frames):
        stamp_ns, ahead = round(index * period_s * NS_PER_S), frames - 1 - index
        surfaces = in_last_window + np.array([ahead * grid.cell_m, 0.0])
        frame = _seen(grid, sensor, surfaces if with_wall else surfaces[:0], stamp_ns)
        if ahead < unseen:
            frame = _frame(grid, nothing, nothing, sensor, stamp_ns)
        stream.append(replace(frame, world_T_grid=SE2(index * grid.cell_m, 0.0)))
    return stream, wall


def empty_stream(grid: GridSpec, period_s: float, frames: int) -> list[GridFrame]:
    """`frames` frames in which nothing is visible."""
    nothing = np.zeros(grid.shape, bool)
    return [_frame(grid, nothing, nothing, np.zeros(2), round(i * period_s * NS_PER_S)) for i in range(frames)]


def _velocities(rng: np.random.Generator) -> NDArray[np.float64]:
    headings = rng.uniform(-np.pi, np.pi, BOXES)
    return SPEED_MPS * np.stack([np.cos(headings), np.sin(headings)], axis=1)


def _outline(half_side: float, spacing: float) -> NDArray[np.float64]:
    """Points (N, 2) on the sides of a square about the origin, metres."""
    along = np.linspace(-half_side, half_side, max(8, int(2 * half_side / spacing)))
    edge = np.full_like(along, half_side)
    sides = [(along, -edge), (along, edge), (-edge, along), (edge, along)]
    return np.concatenate([np.stack(side, axis=1) for side in sides])


def _seen(grid: GridSpec, sensor: NDArray[np.float64], surfaces: NDArray[np.float64], stamp_ns: int) -> GridFrame:
    """Scan of `surfaces` (N, 2) by a laser at `sensor`: per beam the nearest surface, and the free cells before it."""
    distance, beam = _polar(surfaces - sensor)
    reach = np.full(BEAMS, np.inf)
    np.minimum.at(reach, beam, distance)
    hits = surfaces[distance <= reach[beam] + 0.5 * grid.cell_m]
    cells, inside = grid.cells_of(hits)
    occupied = np.zeros(grid.shape, bool)
    occupied[tuple(cells[inside].T)] = True
    distance, beam = _polar(grid.cell_centres(np.ones(grid.shape, bool)) - sensor)
    return _frame(grid, occupied | (distance <= reach[beam]).reshape(grid.shape), occupied, sensor, stamp_ns)


def _polar(points: NDArray[np.floating]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Distance (N,) in metres and beam index (N,) of points (N, 2) in the sensor's frame."""
    x, y = np.asarray(points, np.float64).T
    angle = np.arctan2(y, x) + np.pi
    return np.hypot(x, y), (angle / (2 * np.pi) * BEAMS).astype(np.int64) % BEAMS


def _frame(
    grid: GridSpec, visible: NDArray[np.bool_], occupied: NDArray[np.bool_], sensor: NDArray[np.float64], stamp_ns: int
) -> GridFrame:
    points = grid.cell_centres(occupied)
    origins = sensor.astype(np.float32)[None]
    return GridFrame(stamp_ns, visible, occupied, SE2(), origins, points, np.zeros(len(points), np.uint8))

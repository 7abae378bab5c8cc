"""Velocity error against the truth at the junction, on the visible cells of moving bodies.

`python -m studies.velocity_errors [TRACKER...]` (default: dogma and kalman; five minutes). The true velocity of a cell
is the rigid motion of the body there, from its poses one frame before and after. If a tracker gives
objects instead of a velocity field, the cells of an object's box have its velocity; of overlapping boxes the smallest
counts, as when a bus passes a person. A cell without a velocity counts as 0.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import SE2, wrap_angle
from gridtrack.common.grid import GridSpec
from gridtrack.common.scene import Scene, SceneObject
from gridtrack.recordings.observation import Observation
from gridtrack.recordings.stream import open_stream
from gridtrack.trackers.contract import Forecast

from studies.support.results_file import measured_table, study_parser, write_table
from studies.support.shipped import JUNCTION, shipped_tracker

Points = NDArray[np.floating[Any]]
RECORDINGS = [JUNCTION / f"test-{number}.tracks" for number in range(101, 105)]
WARM_UP, EVERY = 20, 4
SEEN_FOR = 8
"""Bodies that have been in view for fewer frames are not counted."""
MOVING_MPS = 0.3
"""Slower bodies are not counted, m/s."""


def bodies(scene: Scene | None) -> dict[int, SceneObject]:
    """The bodies of a scene by their track number. Raises ValueError for a recording without a true scene."""
    if scene is None:
        raise ValueError("the recording has no true scene: choose a simulated one")
    return {body.track: body for body in scene.objects}


def points_within(points: Points, pose: SE2, sides: Sequence[float], margin: float) -> NDArray[np.bool_]:
    """Which `points` (N, 2) lie in the box (x_min, x_max, y_min, y_max) about `pose`, enlarged by `margin`."""
    x_min, x_max, y_min, y_max = sides
    x, y = pose.inverse().apply(points.astype(np.float64)).T
    return np.asarray((x > x_min - margin) & (x < x_max + margin) & (y > y_min - margin) & (y < y_max + margin))


def body_cells(
    body: SceneObject, world_T_grid: SE2, centres: Points, occupied: NDArray[np.bool_], grid: GridSpec
) -> NDArray[np.int64]:
    """The occupied cells (N,), row * M + column, in the bounding box of a body's outline and half a cell around it."""
    (x_min, y_min), (x_max, y_max) = body.outline.min(axis=0), body.outline.max(axis=0)
    pose = world_T_grid.inverse() @ body.world_T_object
    return np.flatnonzero(points_within(centres, pose, (x_min, x_max, y_min, y_max), grid.cell_m / 2) & occupied)


def rigid_velocity(before: SE2, after: SE2, elapsed_s: float, world_T_grid: SE2, points: Points) -> Points:
    """Velocity (2, N), m/s, grid frame, of `points` (N, 2) on a body that moves between two poses in the world."""
    grid_T_before, grid_T_after = (world_T_grid.inverse() @ pose for pose in (before, after))
    turn = wrap_angle(grid_T_after.theta - grid_T_before.theta) / elapsed_s
    middle = np.array([grid_T_before.x + grid_T_after.x, grid_T_before.y + grid_T_after.y]) / 2
    straight = np.array([grid_T_after.x - grid_T_before.x, grid_T_after.y - grid_T_before.y]) / elapsed_s
    x, y = (points - middle).T
    return np.stack([straight[0] - turn * y, straight[1] + turn * x])


def velocity_field(forecast: Forecast, grid: GridSpec) -> NDArray[np.float32]:
    """Velocity (2, M, M), m/s, of each cell; NaN for cells without one."""
    if forecast.velocity is not None:
        return forecast.velocity
    field = np.full((2, *grid.shape), np.nan, np.float32)
    centres = grid.cell_centres(np.ones(grid.shape, bool))
    for one in sorted(forecast.objects, key=lambda one: -float(one.box[3] * one.box[4])):
        x, y, heading, length, width = one.box
        pose, sides = SE2(float(x), float(y), float(heading)), (-length / 2, length / 2, -width / 2, width / 2)
        field[:, points_within(centres, pose, sides, grid.cell_m).reshape(grid.shape)] = one.velocity[:, None]
    return field


def true_velocities(
    observations: Sequence[Observation], grid: GridSpec
) -> Iterator[tuple[int, NDArray[np.int64], NDArray[np.float64], int]]:
    """The visible cells (N,) of each moving body in each frame: frame number, cells, velocity (2, N), class."""
    seen_for: dict[int, int] = {}
    for number in range(1, len(observations) - 1):
        before, now, after = (observations[number + shift] for shift in (-1, 0, 1))
        elapsed_s = (after.frame.stamp_ns - before.frame.stamp_ns) * 1e-9
        earlier, later = (bodies(one.scene) for one in (before, after))
        occupied = now.frame.occupied.reshape(-1)
        centres = grid.cell_centres(np.ones(grid.shape, bool))
        for track, body in bodies(now.scene).items():
            cells = body_cells(body, now.frame.world_T_grid, centres, occupied, grid)
            seen_for[track] = seen_for.get(track, 0) + 1 if cells.size else 0
            if track in earlier and track in later and seen_for[track] >= SEEN_FOR and number >= WARM_UP:
                motion = earlier[track].world_T_object, later[track].world_T_object, elapsed_s
                velocity = rigid_velocity(*motion, now.frame.world_T_grid, centres[cells])
                if np.hypot(*velocity.mean(axis=1)) > MOVING_MPS:
                    yield number, cells, velocity, body.label


def errors_by_class(name: str, recordings: Sequence[Path]) -> dict[str, NDArray[np.float64]]:
    """Error, m/s, and whether there was an estimate (2, N), of every measured cell by the class of its body."""
    found: dict[str, list[NDArray[np.float64]]] = {}
    for recording in recordings:
        stream = open_stream(recording)
        observations = list(stream.observations())
        tracker = shipped_tracker(name, stream)
        fields = {}
        for number, observation in enumerate(observations):
            tracker.update(observation.frame)
            if number >= WARM_UP and number % EVERY == 0:
                fields[number] = velocity_field(tracker.predict(1), stream.grid).reshape(2, -1)
        for number, cells, velocity, label in true_velocities(observations, stream.grid):
            if number in fields:
                estimated = fields[number][:, cells]
                error = np.hypot(*(np.nan_to_num(estimated) - velocity))
                given = np.isfinite(estimated[0]) & (estimated != 0).any(axis=0)
                found.setdefault(stream.classes[label], []).append(np.stack([error, given]))
    return {label: np.concatenate(parts, axis=1) for label, parts in sorted(found.items())}


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__, "docs/results/trackers/dogma.json")
    parser.add_argument("trackers", nargs="*", default=["dogma", "kalman"])
    parser.add_argument("--recordings", type=int, default=len(RECORDINGS), help="number of recordings")
    given = parser.parse_args(arguments)
    rows: dict[str, list[str]] = {}
    for name in given.trackers:
        by_class = errors_by_class(name, RECORDINGS[: given.recordings])
        for label, (error, known) in {**by_class, "all": np.concatenate(list(by_class.values()), axis=1)}.items():
            texts = f"{math.sqrt((error**2).mean()):.2f}", f"{np.median(error):.2f}", f"{100 * known.mean():.0f} %"
            rows.setdefault(label, [label, str(error.size)]).extend(texts)
    columns = [text for name in given.trackers for text in (f"{name} RMS m/s", "median", "with a velocity")]
    table = measured_table(["class", "cells", *columns], list(rows.values()))
    print(table.markdown())
    write_table(given.out, "velocity", table, "python -m studies.velocity_errors")


if __name__ == "__main__":
    main()

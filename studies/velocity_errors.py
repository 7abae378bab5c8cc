"""Velocity error against truth at the junction, of the seen cells of what moves, for trackers that say velocities.

`python -m studies.velocity_errors [TRACKER...]` (dogma and kalman by default). The true velocity of a cell is the rigid
motion of the body on whose outline it lies, from the poses one frame before and after. Where a tracker gives objects in
place of a velocity field, each cell of an object's box has the object's velocity; where boxes overlap, that of the
smallest (a bus passes a person). A cell without a velocity counts as 0.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Sequence

import numpy as np

from gridtrack.common.geometry import SE2, wrap_angle
from gridtrack.common.grid import GridSpec
from gridtrack.common.scene import Scene, SceneObject
from gridtrack.evaluation.comparison.learned import find_weights
from gridtrack.recordings import packaged_recording
from gridtrack.recordings.stream import Observation, open_stream
from gridtrack.trackers import registry
from gridtrack.trackers.contract import Forecast, Tracker, stream_of

JUNCTION = packaged_recording("leg_tracker").parents[1] / "junction"
RECORDINGS = [JUNCTION / f"test-{number}.tracks" for number in range(101, 105)]
WARM_UP, EVERY = 20, 4
MOVES_MPS = 0.3
"""Slower bodies, and cells of bodies that have been in view for less than SEEN_FOR frames, are not counted."""
SEEN_FOR = 8


def painted(forecast: Forecast, grid: GridSpec) -> np.ndarray:
    """Velocity (2, M, M), m/s, of each cell; NaN where the forecast has none."""
    if forecast.velocity is not None:
        return forecast.velocity
    field = np.full((2, *grid.shape), np.nan, np.float32)
    centres = grid.cell_centres(np.ones(grid.shape, bool))
    for thing in sorted(forecast.objects, key=lambda thing: -float(thing.box[3] * thing.box[4])):
        x, y, heading, length, width = thing.box
        inside = within(SE2(float(x), float(y), float(heading)), (-length / 2, length / 2, -width / 2, width / 2))
        field[:, inside(centres, grid.cell_m).reshape(grid.shape)] = thing.velocity[:, None]
    return field


def within(pose: SE2, sides: Sequence[float]):
    """Whether points (N, 2) lie in a box (x_min, x_max, y_min, y_max) about `pose`, or within `margin` of it."""
    x_min, x_max, y_min, y_max = sides

    def inside(points: np.ndarray, margin: float) -> np.ndarray:
        x, y = pose.inverse().apply(points.astype(np.float64)).T
        return (x > x_min - margin) & (x < x_max + margin) & (y > y_min - margin) & (y < y_max + margin)

    return inside


def truths(observations: Sequence[Observation], grid: GridSpec) -> Iterator[tuple[int, np.ndarray, np.ndarray, str]]:
    """Of each frame that is measured at: its number, the seen cells (N,) of each moving body, and their velocity."""
    seen_for: dict[int, int] = {}
    for number in range(1, len(observations) - 1):
        before, now, after = (observations[number + shift] for shift in (-1, 0, 1))
        elapsed_s = (after.frame.stamp_ns - before.frame.stamp_ns) * 1e-9
        earlier, later = (bodies(one.scene) for one in (before, after))
        occupied = now.frame.occupied.reshape(-1)
        centres = grid.cell_centres(np.ones(grid.shape, bool))
        for track, body in bodies(now.scene).items():
            cells = cells_of(body, now.frame.world_T_grid, centres, occupied, grid)
            seen_for[track] = seen_for.get(track, 0) + 1 if cells.size else 0
            if track in earlier and track in later and seen_for[track] >= SEEN_FOR and number >= WARM_UP:
                motion = earlier[track].world_T_object, later[track].world_T_object, elapsed_s
                velocity = rigid_velocity(*motion, now.frame.world_T_grid, centres[cells])
                if np.hypot(*velocity.mean(axis=1)) > MOVES_MPS:
                    yield number, cells, velocity, body.label


def bodies(scene: Scene | None) -> dict[int, SceneObject]:
    assert scene is not None, "the recording does not know the truth"
    return {body.track: body for body in scene.objects}


def cells_of(
    body: SceneObject, world_T_grid: SE2, centres: np.ndarray, occupied: np.ndarray, grid: GridSpec
) -> np.ndarray:
    """The occupied cells (N,), row * M + column, about the box of a body's outline."""
    (x_min, y_min), (x_max, y_max) = body.outline.min(axis=0), body.outline.max(axis=0)
    inside = within(world_T_grid.inverse() @ body.world_T_object, (x_min, x_max, y_min, y_max))
    return np.flatnonzero(inside(centres, grid.cell_m / 2) & occupied)


def rigid_velocity(before: SE2, after: SE2, elapsed_s: float, world_T_grid: SE2, points: np.ndarray) -> np.ndarray:
    """Velocity (2, N), m/s, of `points` (N, 2) of a body that goes from one pose in the world to another."""
    grid_T_before, grid_T_after = (world_T_grid.inverse() @ pose for pose in (before, after))
    turn = wrap_angle(grid_T_after.theta - grid_T_before.theta) / elapsed_s
    middle = np.array([grid_T_before.x + grid_T_after.x, grid_T_before.y + grid_T_after.y]) / 2
    straight = np.array([grid_T_after.x - grid_T_before.x, grid_T_after.y - grid_T_before.y]) / elapsed_s
    x, y = (points - middle).T
    return np.stack([straight[0] - turn * y, straight[1] + turn * x])


def errors(name: str) -> dict[str, np.ndarray]:
    """Error and whether there was an estimate (2, N) of every measured cell, by the class of its body."""
    found: dict[str, list[np.ndarray]] = {}
    for recording in RECORDINGS:
        stream = open_stream(recording)
        observations = list(stream.observations())
        learned = find_weights(name, stream.site, None)
        tracker: Tracker = registry.load(name)(
            stream_of(stream, learned.path if learned else None), registry.load(name).Options()
        )
        tracker.reset(0)
        fields = {}
        for number, observation in enumerate(observations):
            tracker.update(observation.frame)
            if number >= WARM_UP and number % EVERY == 0:
                fields[number] = painted(tracker.predict(1), stream.grid).reshape(2, -1)
        for number, cells, velocity, label in truths(observations, stream.grid):
            if number in fields:
                said = fields[number][:, cells]
                error = np.hypot(*(np.nan_to_num(said) - velocity))
                given = np.isfinite(said[0]) & (said != 0).any(axis=0)
                found.setdefault(stream.classes[label], []).append(np.stack([error, given]))
    return {label: np.concatenate(parts, axis=1) for label, parts in sorted(found.items())}


def main() -> None:
    print(f"{'tracker':14} {'class':12} {'cells':>7} {'RMS m/s':>8} {'median':>7} {'with a velocity':>15}")
    for name in sys.argv[1:] or ["dogma", "kalman"]:
        by_class = errors(name)
        for label, (error, given) in {**by_class, "all": np.concatenate(list(by_class.values()), axis=1)}.items():
            rms = math.sqrt((error**2).mean())
            print(f"{name:14} {label:12} {error.size:7} {rms:8.2f} {np.median(error):7.2f} {given.mean():15.0%}")


if __name__ == "__main__":
    main()

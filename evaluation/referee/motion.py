"""Motion: the parts of the dynamic cells that are near returns in motion, and near returns that stand.

They are regions of an observed frame and follow from the recording alone, so they are the same for every tracker.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Protocol

import numba
import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridSpec, Mask, with_neighbours
from gridtrack.common.scene import Scene
from gridtrack.evaluation.referee.strata import PARTS
from gridtrack.recordings.observation import Observation
from gridtrack.recordings.stream import GridStream
from gridtrack.recordings.truth import corners_in_cells
from gridtrack.trackers.contract import FrameSource

NEAR_M = 0.5
"""Greatest distance between the centres of a cell and of a return's cell that the cell belongs to, m."""
LOOKBACK_S = 1.0
"""A return is in motion where its cell and the eight neighbours were visible and free this long before."""
MIN_SPEED_MPS = 0.3
"""With truth, a return is in motion where it is on an object that is faster than this."""
RANGE_NOISE_M = 0.15
"""Greatest distance of a measured point from the outline that it was measured on: three standard deviations of the
noise of a laser that is 0.05 m accurate."""
_OPEN, _STANDING, _IN_MOTION = range(len(PARTS))


class ReturnsInMotion(Protocol):
    """Decides which returns of one observation are in motion, in any window."""

    @property
    def bodies(self) -> BodyMotions | None:
        """The motions of the bodies of the true scene; None if it is not known."""
        ...

    def among(self, observation: Observation, grid: GridSpec) -> Mask:
        """The returns in motion (M, M) of the observation, which is given in the window that is asked for."""
        ...


class MotionFinder(Protocol):
    """Finds returns in motion, observation by observation."""

    def of(self, observation: Observation) -> ReturnsInMotion:
        """The returns in motion of the next observation of the stretch."""
        ...


def parts_of(moving: Mask, returns: Mask, dynamic: Mask, grid: GridSpec) -> NDArray[np.uint8]:
    """`motion` (M, M) uint8 of a frame with these `returns` (M, M); `moving` ones are in motion.

    In motion: `dynamic` cells within NEAR_M of a return in motion in a dynamic cell. Standing: those of the others that
    are within NEAR_M of another dynamic return.
    """
    motion = np.full(grid.shape, _OPEN, np.uint8)
    offsets = _offsets(grid)
    _mark(np.argwhere(returns & dynamic & ~moving), offsets, dynamic, np.uint8(_STANDING), motion)
    _mark(np.argwhere(returns & dynamic & moving), offsets, dynamic, np.uint8(_IN_MOTION), motion)
    return motion


def _offsets(grid: GridSpec) -> NDArray[np.int64]:
    """Rows and columns (N, 2) to the cells with centres within NEAR_M."""
    reach = int(NEAR_M / grid.cell_m)
    rows, columns = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    near = np.hypot(rows, columns) * grid.cell_m <= NEAR_M + 1e-9
    return np.stack([rows[near], columns[near]], axis=1)


@numba.njit(cache=True, nogil=True)
def _mark(cells, offsets, dynamic, part, motion):  # type: ignore[no-untyped-def]
    """Set `part` in the `dynamic` cells at `offsets` (K, 2) from each of `cells` (N, 2)."""
    size = motion.shape[0]
    for i in range(cells.shape[0]):
        for k in range(offsets.shape[0]):
            row, column = cells[i, 0] + offsets[k, 0], cells[i, 1] + offsets[k, 1]
            if 0 <= row < size and 0 <= column < size and dynamic[row, column]:
                motion[row, column] = part


class ObservedMotion:
    """Motion in a stretch: with truth by the speed of objects, else by the cells that were free one second before.

    Observations are given in their order, every one of the stretch. A return without a recorded past stands.
    """

    def __init__(self, stream: FrameSource) -> None:
        lookback = max(1, round(LOOKBACK_S / stream.period_s))
        self._before = stream.before(lookback) if isinstance(stream, GridStream) else iter(())
        self._earlier: deque[Observation] = deque(maxlen=lookback + 1)
        self._followed = FollowedBodies()

    def of(self, observation: Observation) -> ReturnsInMotion:
        """The returns in motion of the next observation."""
        self._earlier.extend(self._before)  # read when the first observation comes
        self._earlier.append(observation)
        scan = next((scan for scan in observation.scans if scan.scene is not None), None)
        if scan is None or scan.scene is None:
            known = len(self._earlier) == self._earlier.maxlen
            return OnceFree(self._earlier[0] if known else None)
        return OnFastObjects(self._followed.motions(scan.stamp_ns, scan.scene))


class OnceFree:
    """Returns in cells of the world that were visible and free in an earlier observation, with their eight neighbours.

    Range noise moves the returns of a standing body by a cell, so that its own cell alone was often free before. A
    return at the border of the window is not called in motion, because a neighbour is not known.
    """

    bodies = None

    def __init__(self, earlier: Observation | None) -> None:
        """None: nothing is known to have been free."""
        self._earlier = earlier

    def among(self, observation: Observation, grid: GridSpec) -> Mask:
        """The returns in motion (M, M) of the observation."""
        if self._earlier is None:
            return np.zeros(grid.shape, np.bool_)
        then = self._earlier.seen_in(observation.reference_T_grid, grid).frame
        found = np.zeros(grid.shape, np.bool_)
        inner = slice(1, -1), slice(1, -1)
        known_free = ~with_neighbours(~then.visible | then.occupied)
        found[inner] = (observation.frame.occupied & known_free)[inner]
        return found


class OnFastObjects:
    """Returns on the objects of a true scene that are faster than MIN_SPEED_MPS."""

    def __init__(self, bodies: BodyMotions) -> None:
        self._bodies = bodies

    @property
    def bodies(self) -> BodyMotions:
        """The motions of all objects of the scene."""
        return self._bodies

    def among(self, observation: Observation, grid: GridSpec) -> Mask:
        """The returns in motion (M, M) of the observation. Raises RecordingError for a scene that cannot be placed."""
        fast = self._bodies.speeds > MIN_SPEED_MPS
        if not fast.any():
            return np.zeros(grid.shape, np.bool_)
        body = body_of_returns(self._bodies.scene, observation, grid)
        found: Mask = (body >= 0) & fast[body]
        return found


def body_of_returns(scene: Scene, observation: Observation, grid: GridSpec) -> NDArray[np.int32]:
    """The object of `scene` that each occupied cell (M, M) of `observation` lies on; -1 for none.

    A return lies on the object with the outline nearest to the centre of its cell, if that is within RANGE_NOISE_M and
    half a diagonal of a cell. Raises RecordingError for an object that cannot be placed.
    """
    body = np.full(grid.shape, -1, np.int32)
    if scene.objects:
        corners = corners_in_cells(scene.object_outlines, grid, observation.reference_T_grid)
        rows, columns = np.nonzero(observation.frame.occupied)
        reach = RANGE_NOISE_M / grid.cell_m + np.sqrt(0.5)
        body[rows, columns] = _nearest_outline(
            np.stack([columns, rows], axis=1) + 0.5, corners, scene.object_outlines.starts, reach
        )
    return body


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _nearest_outline(points, corners, starts, reach):  # type: ignore[no-untyped-def]
    """The outline (N,) that is nearest to each point (N, 2), within `reach`, else -1; all coordinates in cells."""
    nearest = np.full(points.shape[0], -1, np.int64)
    least_squared = np.full(points.shape[0], reach * reach)
    for polygon in range(starts.size - 1):
        first, last = starts[polygon], starts[polygon + 1]
        if last == first:
            continue
        left, right = corners[first:last, 0].min() - reach, corners[first:last, 0].max() + reach
        bottom, top = corners[first:last, 1].min() - reach, corners[first:last, 1].max() + reach
        for i in range(points.shape[0]):
            x, y = points[i, 0], points[i, 1]
            if not (left <= x <= right and bottom <= y <= top):
                continue
            x0, y0 = corners[last - 1, 0], corners[last - 1, 1]
            for k in range(first, last):
                x1, y1 = corners[k, 0], corners[k, 1]
                dx, dy = x1 - x0, y1 - y0
                length = dx * dx + dy * dy
                along = min(max(((x - x0) * dx + (y - y0) * dy) / length, 0.0), 1.0) if length > 0.0 else 0.0
                squared = (x0 + along * dx - x) ** 2 + (y0 + along * dy - y) ** 2
                if squared <= least_squared[i]:
                    least_squared[i], nearest[i] = squared, polygon
                x0, y0 = x1, y1
    return nearest


@dataclass(frozen=True, slots=True)
class BodyMotions:
    """The motions of the N objects of a `scene` since the scene before.

    `speeds` (N,) float64 of their positions, m/s, 0 for an object that is new; `moved` (N, 4) float64: the rigid motion
    from now back to then, x, y, cos and sin, in the world of the scene, NaN for an object that is new; `seconds`
    between the two.
    """

    scene: Scene
    speeds: NDArray[np.float64]
    moved: NDArray[np.float64]
    seconds: float

    def velocities(
        self, body: NDArray[np.integer], points: NDArray[np.floating], world_T_grid: SE2
    ) -> NDArray[np.float64]:
        """Velocities (K, 2), m/s, of `points` (K, 2), metres, of the objects `body` (K,); both in the grid frame.

        The mean velocity over the `seconds` before now, rotation included; NaN for an object that is new.
        """
        x, y = world_T_grid.apply(points).T
        dx, dy, cos, sin = self.moved[body].T
        then = np.stack([dx + cos * x - sin * y, dy + sin * x + cos * y], axis=1)
        velocities: NDArray[np.float64] = points - world_T_grid.inverse().apply(then)
        return velocities / self.seconds


class FollowedBodies:
    """The bodies of successive scenes, by their tracks."""

    def __init__(self) -> None:
        self._stamp_ns: int | None = None
        self._poses: dict[int, SE2] = {}
        self._earlier: dict[int, SE2] = {}
        self._seconds = math.nan

    def motions(self, stamp_ns: int, scene: Scene) -> BodyMotions:
        """The motions of the next scene; the same one again has the same."""
        if stamp_ns != self._stamp_ns:
            if self._stamp_ns is not None:
                self._seconds = (stamp_ns - self._stamp_ns) / 1e9
            self._stamp_ns, self._earlier = stamp_ns, self._poses
            self._poses = {body.track: body.world_T_object for body in scene.objects}
        speeds, moved = np.zeros(len(scene.objects)), np.full((len(scene.objects), 4), np.nan)
        for i, body in enumerate(scene.objects):
            now, then = body.world_T_object, self._earlier.get(body.track)
            if then is not None:
                speeds[i] = math.dist((now.x, now.y), (then.x, then.y)) / self._seconds
                back = then @ now.inverse()
                moved[i] = back.x, back.y, math.cos(back.theta), math.sin(back.theta)
        return BodyMotions(scene, speeds, moved, self._seconds)

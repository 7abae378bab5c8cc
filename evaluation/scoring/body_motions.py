"""The true motions of the bodies of a scene, and the velocities of the cells that they occupy."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import SE2
from gridtrack.common.scene import Scene


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

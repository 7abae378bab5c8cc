"""Rigid transforms in space, and their projection to the plane of the grid.

scipy's RigidTransform takes 0.2 ms to chain two of them, and a scan needs several.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

from gridtrack.common.geometry import SE2
from gridtrack.common.scan import MAX_POSITION_M

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
"""x, y, z, w of norm 1."""

SAME_M, SAME_RAD = 1e-3, 1e-3


class Placement(NamedTuple):
    """A transform as a pose in the plane: the heading is the direction of the x axis.

    `mirrored`: the z axis points down, so that angles run clockwise; `tilt_rad` is the angle between the z axis and the
    vertical, 0 to pi / 2.
    """

    pose: SE2
    mirrored: bool
    tilt_rad: float


@dataclass(frozen=True, slots=True)
class SE3:
    """`target_T_source` in space: a translation in metres and a unit quaternion."""

    translation: Vector = (0.0, 0.0, 0.0)
    rotation: Quaternion = (0.0, 0.0, 0.0, 1.0)

    @classmethod
    def of(cls, translation: Iterable[float], rotation: Iterable[float]) -> SE3 | None:
        """From x, y, z and a quaternion of any norm; None if they are not finite, too large, or no rotation."""
        x, y, z = map(float, translation)
        qx, qy, qz, qw = map(float, rotation)
        norm = math.sqrt(qx * qx + qy * qy + qz * qz + qw * qw)
        if not (max(abs(x), abs(y), abs(z)) <= MAX_POSITION_M and 1e-3 < norm < 1e3):
            return None
        return cls((x, y, z), (qx / norm, qy / norm, qz / norm, qw / norm))

    @classmethod
    def in_plane(cls, pose: SE2, mirrored: bool = False) -> SE3:
        """A pose in the plane; `mirrored`: rotated by 180 degrees about its x axis."""
        c, s = math.cos(pose.theta / 2.0), math.sin(pose.theta / 2.0)
        return cls((pose.x, pose.y, 0.0), (c, s, 0.0, 0.0) if mirrored else (0.0, 0.0, s, c))

    def __matmul__(self, other: SE3) -> SE3:
        """Chain transforms: `a_T_b @ b_T_c` is `a_T_c`."""
        (x, y, z, w), (ox, oy, oz, ow) = self.rotation, other.rotation
        turned = _rotated(other.translation, self.rotation)
        moved = (
            self.translation[0] + turned[0],
            self.translation[1] + turned[1],
            self.translation[2] + turned[2],
        )
        return SE3(
            moved,
            (
                w * ox + x * ow + y * oz - z * oy,
                w * oy - x * oz + y * ow + z * ox,
                w * oz + x * oy - y * ox + z * ow,
                w * ow - x * ox - y * oy - z * oz,
            ),
        )

    def inverse(self) -> SE3:
        """`source_T_target`."""
        x, y, z, w = self.rotation
        back = (-x, -y, -z, w)
        tx, ty, tz = _rotated(self.translation, back)
        return SE3((-tx, -ty, -tz), back)

    def placement(self) -> Placement:
        """The transform in the plane; its height is left out."""
        x, y, z, w = self.rotation
        heading = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        up = 1.0 - 2.0 * (x * x + y * y)
        pose = SE2(self.translation[0], self.translation[1], heading)
        return Placement(pose, up < 0.0, math.acos(min(abs(up), 1.0)))

    def is_same(self, other: SE3) -> bool:
        """Whether both agree to a millimetre and a milliradian."""
        apart = max(abs(a - b) for a, b in zip(self.translation, other.translation, strict=True))
        return apart < SAME_M and _angle_between(self.rotation, other.rotation) < SAME_RAD


def interpolated(before: SE3, after: SE3, share: float) -> SE3:
    """The transform at `share`, 0 to 1, of the way: translation linear, rotation at constant speed (slerp)."""
    (ax, ay, az), (bx, by, bz) = before.translation, after.translation
    moved = (ax + share * (bx - ax), ay + share * (by - ay), az + share * (bz - az))
    return SE3(moved, _slerp(before.rotation, after.rotation, share))


def _rotated(vector: Vector, q: Quaternion) -> Vector:
    """v + 2 w (u x v) + 2 u x (u x v), with u the vector part of the quaternion."""
    (vx, vy, vz), (x, y, z, w) = vector, q
    tx, ty, tz = 2.0 * (y * vz - z * vy), 2.0 * (z * vx - x * vz), 2.0 * (x * vy - y * vx)
    return (
        vx + w * tx + y * tz - z * ty,
        vy + w * ty + z * tx - x * tz,
        vz + w * tz + x * ty - y * tx,
    )


def _angle_between(one: Quaternion, other: Quaternion) -> float:
    """Radians, from the vector part of the relative rotation: the dot product is inexact at small angles."""
    (x, y, z, w), (ox, oy, oz, ow) = one, other
    dx = w * ox - x * ow - y * oz + z * oy
    dy = w * oy + x * oz - y * ow - z * ox
    dz = w * oz - x * oy + y * ox - z * ow
    return 2.0 * math.asin(min(math.sqrt(dx * dx + dy * dy + dz * dz), 1.0))


def _slerp(before: Quaternion, after: Quaternion, share: float) -> Quaternion:
    """Shoemake (1985), along the shorter arc; linear if the rotations are nearly equal."""
    cosine = sum(a * b for a, b in zip(before, after, strict=True))
    sign = 1.0 if cosine >= 0.0 else -1.0
    angle = math.acos(min(abs(cosine), 1.0))
    if angle < 1e-6:
        one, other = 1.0 - share, sign * share
    else:
        sine = math.sin(angle)
        one, other = math.sin((1.0 - share) * angle) / sine, sign * math.sin(share * angle) / sine
    x, y, z, w = (one * a + other * b for a, b in zip(before, after, strict=True))
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    return (x / norm, y / norm, z / norm, w / norm)

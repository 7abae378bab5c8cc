"""A planar laser in a scene: range and class of each beam, exact and with noise."""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from gridtrack.common.config import Settings
from gridtrack.common.geometry import SE2
from gridtrack.common.scan import MAX_ANGLE_RAD, MAX_BEAMS, Scan
from gridtrack.common.scene import UNLABELLED, Scene

MAX_SCENE_M = 1e6
"""Limit of the coordinates of a laser and of a static outline."""
TICK_M = 2.0**-10
"""Resolution of the ranges. A power of two compresses well."""
NEAR_RANGE_M = 10.0
NEAR_NOISE_M, FAR_NOISE_M = 0.03, 0.05
"""Standard deviation of the range up to NEAR_RANGE_M and beyond it: Hokuyo UTM-30LX, data sheet."""
TOUCHING = 1e-9
"""Distance to a side, as a share of its length, below which the sensor is taken to be on the side."""


class Laser(Settings):
    """A planar laser and its pose in the world or on its carrier; the defaults are those of the Hokuyo UTM-30LX."""

    x: float = Field(default=0.0, ge=-MAX_SCENE_M, le=MAX_SCENE_M)
    y: float = Field(default=0.0, ge=-MAX_SCENE_M, le=MAX_SCENE_M)
    theta: float = Field(default=0.0, ge=-MAX_ANGLE_RAD, le=MAX_ANGLE_RAD)
    angle_min: float = Field(default=math.radians(-135.0), ge=-MAX_ANGLE_RAD, le=MAX_ANGLE_RAD)
    """Angle of beam 0, radians, sensor frame; beam i has the angle `angle_min + i * angle_increment`."""
    angle_increment: float = Field(default=math.radians(0.25), ge=-MAX_ANGLE_RAD, le=MAX_ANGLE_RAD)
    beams: int = Field(default=1081, ge=1, le=MAX_BEAMS)
    range_min: float = Field(default=0.1, ge=0.0, le=1e3)
    range_max: float = Field(default=30.0, gt=0.0, le=1e4)

    @model_validator(mode="after")
    def _check_field_of_view(self) -> Laser:
        if abs(self.angle_increment) * (self.beams - 1) > MAX_ANGLE_RAD:
            raise ValueError(f"the beams cover more than two turns ({MAX_ANGLE_RAD:.4g} rad)")
        return self

    @property
    def pose(self) -> SE2:
        """`world_T_sensor` of a laser that stands, `carrier_T_sensor` of one that is carried."""
        return SE2(self.x, self.y, self.theta)

    def scan(self, scene: Scene, stamp_ns: int, world_T_sensor: SE2, random: np.random.Generator) -> Scan:
        """A scan of `scene` with noise from `random`, labels and the true scene."""
        ranges, labels = sweep(scene, world_T_sensor, self.angle_min, self.angle_increment, self.beams, self.range_max)
        return Scan(
            stamp_ns=stamp_ns,
            ranges=with_noise(ranges, self.range_max, random),
            angle_min=self.angle_min,
            angle_increment=self.angle_increment,
            range_min=self.range_min,
            range_max=self.range_max,
            world_T_sensor=world_T_sensor,
            labels=labels,
            scene=scene,
        )


def sweep(
    scene: Scene, world_T_sensor: SE2, angle_min: float, angle_increment: float, beams: int, range_max: float
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Ranges (B,) float32 in metres, free of noise, and labels (B,) uint8 of a laser at `world_T_sensor`.

    Beam i has the angle `angle_min + i * angle_increment` (radians, counter-clockwise, sensor frame). A range is the
    distance to the nearest side of any outline, from outside or inside; +inf, labelled UNLABELLED, where there is none
    within `range_max`.
    """
    outlines = [*scene.static, *(road_user.outline for road_user in scene.objects)]
    nearest = np.full(beams, np.inf)
    labels = np.full(beams, UNLABELLED, np.uint8)
    if outlines:
        _sweep(
            np.concatenate(outlines).astype(np.float64),
            np.array([len(outline) for outline in outlines]),
            _poses(scene, world_T_sensor.inverse()),
            np.array(
                [scene.static_label] * len(scene.static) + [road_user.label for road_user in scene.objects], np.uint8
            ),
            angle_min,
            angle_increment,
            range_max,
            nearest,
            labels,
        )
    return nearest.astype(np.float32), labels


def with_noise(ranges: NDArray[np.float32], range_max: float, random: np.random.Generator) -> NDArray[np.float32]:
    """`ranges` (B,) with normal noise, rounded to TICK_M, at most `range_max`; infinite ones are not changed."""
    std = np.where(ranges <= NEAR_RANGE_M, NEAR_NOISE_M, FAR_NOISE_M)
    ticks = np.round((ranges + std * random.standard_normal(ranges.size)) / TICK_M)
    measured = np.clip(ticks * TICK_M, 0.0, math.floor(range_max / TICK_M) * TICK_M)
    return np.where(np.isfinite(ranges), measured, np.inf).astype(np.float32)


def _poses(scene: Scene, sensor_T_world: SE2) -> NDArray[np.float64]:
    """The pose of each outline, static ones first: (O, 3) as x, y, theta in the sensor frame."""
    poses = [sensor_T_world] * len(scene.static)
    poses += [sensor_T_world @ road_user.world_T_object for road_user in scene.objects]
    return np.array([(pose.x, pose.y, pose.theta) for pose in poses])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _sweep(corners, counts, poses, outline_labels, angle_min, angle_increment, range_max, nearest, labels):  # type: ignore[no-untyped-def]
    """Lower `nearest` (B,) to the distance of each outline's sides, and set `labels` (B,) accordingly."""
    first = 0
    for o in range(counts.size):
        c, s = math.cos(poses[o, 2]), math.sin(poses[o, 2])
        for i in range(counts[o]):
            px, py = corners[first + i]
            qx, qy = corners[first + (i + 1) % counts[o]]
            _side(
                poses[o, 0] + c * px - s * py,
                poses[o, 1] + s * px + c * py,
                poses[o, 0] + c * qx - s * qy,
                poses[o, 1] + s * qx + c * qy,
                angle_min,
                angle_increment,
                range_max,
                outline_labels[o],
                nearest,
                labels,
            )
        first += counts[o]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _side(px, py, qx, qy, angle_min, angle_increment, range_max, label, nearest, labels):  # type: ignore[no-untyped-def]
    """One side from p to q, sensor frame: only the beams between the angles of its ends can intersect it."""
    ex, ey = qx - px, qy - py
    length = math.hypot(ex, ey)
    across = px * qy - py * qx
    if length == 0.0 or abs(across) >= length * range_max * (1.0 + 1e-9):
        return
    if abs(across) <= TOUCHING * length * length:
        _intersect(0, nearest.size, px, py, ex, ey, angle_min, angle_increment, range_max, label, nearest, labels)
        return
    # Mirrored for clockwise beams, so that angles always increase with the beam number.
    turn = 1.0 if angle_increment >= 0.0 else -1.0
    step = max(abs(angle_increment), 1e-12)
    span = math.atan2(abs(across), px * qx + py * qy)
    start = turn * (math.atan2(py, px) - angle_min) - (span if turn * across < 0.0 else 0.0)
    start = start % (2.0 * math.pi) - 2.0 * math.pi
    while start <= step * nearest.size:
        begin = min(max(math.ceil(start / step) - 1, 0), nearest.size)
        end = min(max(math.floor((start + span) / step) + 2, 0), nearest.size)
        _intersect(begin, end, px, py, ex, ey, angle_min, angle_increment, range_max, label, nearest, labels)
        start += 2.0 * math.pi


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _intersect(begin, end, px, py, ex, ey, angle_min, angle_increment, range_max, label, nearest, labels):  # type: ignore[no-untyped-def]
    """Intersect beams begin..end-1 with the segment p + u * e, 0 <= u <= 1."""
    for i in range(begin, end):
        angle = angle_min + i * angle_increment
        dx, dy = math.cos(angle), math.sin(angle)
        slant = dx * ey - dy * ex
        if slant == 0.0:
            continue
        distance = (px * ey - py * ex) / slant
        share = (px * dy - py * dx) / slant
        if -1e-12 <= share <= 1.0 + 1e-12 and 0.0 <= distance <= range_max and distance < nearest[i]:
            nearest[i] = distance
            labels[i] = label

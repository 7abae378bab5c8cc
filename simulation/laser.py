"""A planar laser in a scene: range and class of each beam, exact and with the errors of a real laser."""

from __future__ import annotations

import math
from collections.abc import Sequence, Set
from dataclasses import dataclass
from typing import Literal

import numba
import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from gridtrack.common.config import Settings
from gridtrack.common.geometry import SE2
from gridtrack.common.scan import MAX_ANGLE_RAD, MAX_BEAMS, Scan
from gridtrack.common.scene import Outline, Scene

MAX_SCENE_M = 1e6
"""Limit of the coordinates of a laser and of a static outline."""
TOUCHING = 1e-9
"""The sensor counts as on a side if its distance to it, as a share of the side's length, is smaller."""
TICK_M = 2.0**-10
"""Resolution of the ranges. A power of two compresses well."""
NEAR_RANGE_M = 10.0
NEAR_NOISE_M, FAR_NOISE_M = 0.03, 0.05
"""Standard deviation of ranges up to NEAR_RANGE_M and beyond: data sheet of the Hokuyo UTM-30LX."""
MIXED_GAP_M = (0.06, 2.0)
"""Depths of an edge at which a footprint on both sides may give a range in between."""
FACING_RAD, FACING_SEEN = 0.12, 0.9
"""Limit of nearly normal incidence, and the probability of a return from glass at it."""
UNKNOWN_RAD = 0.5
"""Assumed angle of incidence of a beam without a neighbour on the same outline."""
GRAZING_RAD, GRAZING_LOST = 1.45, 0.5
"""Beyond this angle of incidence, and beyond half the range, this share of the returns is lost."""
DARK_LOST = 0.1
"""Share of the returns from dark surfaces that are lost within their reach."""


class LaserErrors(Settings):
    """Errors of the ranges of a laser.

    Not modelled: reflections in glass, motion during a revolution, and crosstalk of two lasers.
    """

    std_m: float = Field(default=0.01, ge=0.0, le=1.0)
    """Standard deviation of a range at the sensor."""
    std_per_m: float = Field(default=0.0, ge=0.0, le=0.1)
    """Increase of the standard deviation per metre of range."""
    resolution_m: float = Field(default=0.001, gt=0.0, le=0.1)
    lost: float = Field(default=0.0, ge=0.0, le=1.0)
    """Probability that a beam has no return although it hits something."""
    invalid: float = Field(default=0.0, ge=0.0, le=1.0)
    """Probability that a beam gives no information: NaN."""
    mixed: float = Field(default=0.0, ge=0.0, le=1.0)
    """Probability that a beam at an edge gives a range between both surfaces."""
    glass_seen: float = Field(default=0.3, ge=0.0, le=1.0)
    """Probability of a return from glass, except at nearly normal incidence."""
    dark_reach: float = Field(default=0.7, ge=0.0, le=1.0)
    """Share of the maximum range up to which dark surfaces give returns."""
    no_return: Literal["inf", "nan"] = Field(default="inf", exclude_if=lambda value: value == "inf")
    """What the driver reports for a beam without a return: +inf, which means free to the maximum range, or NaN, from
    which nothing is known. A file has this key only for NaN: other worlds keep their bytes."""


@dataclass(frozen=True, slots=True)
class Hits:
    """The exact hits of the B beams of a scan.

    `ranges` (B,) float64, metres, +inf without a hit; `outline` (B,) int32: index of the outline, -1 without a hit.
    `behind` (B,) float64 and `behind_outline` (B,) are the same without any glass. `glass` (B,) bool: the hit is glass;
    `dark` (B,) bool: the hit behind any glass is dark.
    """

    ranges: NDArray[np.float64]
    outline: NDArray[np.int32]
    behind: NDArray[np.float64]
    behind_outline: NDArray[np.int32]
    glass: NDArray[np.bool_]
    dark: NDArray[np.bool_]


def measured(
    hits: Hits, errors: LaserErrors, angle_increment: float, range_max: float, random: np.random.Generator
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """The measured ranges (B,) float32, metres, and the outline (B,) int32 of each; -1 if it is on none.

    The random numbers depend on B only: a change of the scene does not change other beams.
    """
    draws = random.random((6, hits.ranges.size))
    noise = random.standard_normal(hits.ranges.size)
    incidence = incidences(hits.ranges, hits.outline, angle_increment)
    pane_seen = draws[0] < np.where(incidence < FACING_RAD, FACING_SEEN, errors.glass_seen)
    through = hits.glass & ~pane_seen
    ranges = np.where(through, hits.behind, hits.ranges)
    outline = np.where(through, hits.behind_outline, hits.outline)
    dark = hits.dark & ~(hits.glass & pane_seen)
    lost = draws[1] < errors.lost
    lost |= dark & ((ranges > errors.dark_reach * range_max) | (draws[2] < DARK_LOST))
    lost |= (incidence > GRAZING_RAD) & (ranges > range_max / 2.0) & (draws[2] < GRAZING_LOST)
    mixed_ranges = _mixed(ranges, draws[4])
    mixed = np.isfinite(mixed_ranges) & (draws[3] < errors.mixed)
    ranges = np.where(mixed, mixed_ranges, ranges)
    with np.errstate(invalid="ignore"):
        noisy = ranges + (errors.std_m + errors.std_per_m * ranges) * np.where(dark, 2.0, 1.0) * noise
        rounded = np.round(noisy / errors.resolution_m) * errors.resolution_m
    found = np.clip(rounded, 0.0, math.floor(range_max / errors.resolution_m) * errors.resolution_m)
    found = np.where(np.isfinite(ranges) & ~lost, found, float(errors.no_return))
    found = np.where(draws[5] < errors.invalid, np.nan, found)
    return found.astype(np.float32), np.where(np.isfinite(found) & ~mixed, outline, -1).astype(np.int32)


def incidences(ranges: NDArray[np.float64], outline: NDArray[np.int32], angle_increment: float) -> NDArray[np.float64]:
    """The angle of incidence (B,) of each beam, radians, from its neighbours on the same outline; else UNKNOWN_RAD."""
    step = np.full(ranges.size, np.inf)
    same = (outline[1:] == outline[:-1]) & (outline[1:] >= 0)
    difference = np.full(ranges.size - 1, np.inf)
    np.subtract(ranges[1:], ranges[:-1], out=difference, where=same)
    step[1:] = np.abs(difference)
    step[:-1] = np.minimum(step[:-1], np.abs(difference))
    across = np.where(np.isfinite(ranges), ranges, 1.0) * abs(angle_increment)
    return np.where(np.isfinite(step), np.arctan2(step, np.maximum(across, 1e-9)), UNKNOWN_RAD)


def _mixed(ranges: NDArray[np.float64], share: NDArray[np.float64]) -> NDArray[np.float64]:
    """The range (B,) of a footprint on the surfaces of this beam and the next one; +inf without an edge."""
    following = np.append(ranges[1:], ranges[-1:])
    with np.errstate(invalid="ignore"):
        gap = following - ranges
        at_edge = (np.abs(gap) > MIXED_GAP_M[0]) & (np.abs(gap) < MIXED_GAP_M[1])
        return np.where(at_edge, ranges + share * gap, np.inf)


@dataclass(frozen=True, slots=True)
class SceneSurfaces:
    """Surfaces other than matt: indices of static outlines of `glass` and `dark` ones, and tracks in dark clothes."""

    glass: Set[int] = frozenset()
    dark: Set[int] = frozenset()
    dark_tracks: Set[int] = frozenset()


MATT = SceneSurfaces()


class Laser(Settings):
    """A planar laser and its pose in the world or on its carrier; the defaults are of the Hokuyo UTM-30LX."""

    x: float = Field(default=0.0, ge=-MAX_SCENE_M, le=MAX_SCENE_M)
    y: float = Field(default=0.0, ge=-MAX_SCENE_M, le=MAX_SCENE_M)
    theta: float = Field(default=0.0, ge=-MAX_ANGLE_RAD, le=MAX_ANGLE_RAD)
    angle_min: float = Field(default=math.radians(-135.0), ge=-MAX_ANGLE_RAD, le=MAX_ANGLE_RAD)
    """Angle of beam 0, radians, sensor frame; beam i has the angle `angle_min + i * angle_increment`."""
    angle_increment: float = Field(default=math.radians(0.25), ge=-MAX_ANGLE_RAD, le=MAX_ANGLE_RAD)
    beams: int = Field(default=1081, ge=1, le=MAX_BEAMS)
    range_min: float = Field(default=0.1, ge=0.0, le=1e3)
    range_max: float = Field(default=30.0, gt=0.0, le=1e4)
    errors: LaserErrors | None = None
    """None: the noise of the Hokuyo UTM-30LX alone."""

    @model_validator(mode="after")
    def _check_field_of_view(self) -> Laser:
        if abs(self.angle_increment) * (self.beams - 1) > MAX_ANGLE_RAD:
            raise ValueError(f"the beams cover more than two turns ({MAX_ANGLE_RAD:.4g} rad)")
        return self

    @property
    def pose(self) -> SE2:
        """`world_T_sensor`, or `carrier_T_sensor` if the laser is carried."""
        return SE2(self.x, self.y, self.theta)

    def scan(
        self,
        scene: Scene,
        stamp_ns: int,
        world_T_sensor: SE2,
        random: np.random.Generator,
        surfaces: SceneSurfaces = MATT,
    ) -> Scan:
        """A scan of `scene` with errors from `random`, labels and the true scene."""
        if self.errors is None:
            beams = (self.angle_min, self.angle_increment, self.beams, self.range_max)
            true, labels = sweep(scene, world_T_sensor, *beams)
            ranges = with_noise(true, self.range_max, random)
        else:
            hits = self._hits(scene, world_T_sensor, surfaces)
            ranges, outline = measured(hits, self.errors, self.angle_increment, self.range_max, random)
            labels = scene.labels[outline]
        return Scan(
            stamp_ns=stamp_ns,
            ranges=ranges,
            angle_min=self.angle_min,
            angle_increment=self.angle_increment,
            range_min=self.range_min,
            range_max=self.range_max,
            world_T_sensor=world_T_sensor,
            labels=labels,
            scene=scene,
        )

    def _hits(self, scene: Scene, world_T_sensor: SE2, surfaces: SceneSurfaces) -> Hits:
        """The hits of the beams, with and without glass."""
        poses = _poses(scene, world_T_sensor.inverse())
        outlines = _outlines(scene)
        beams = (self.angle_min, self.angle_increment, self.beams, self.range_max)
        ranges, outline = first_hits(outlines, poses, *beams)
        glass, dark = np.zeros(len(outlines) + 1, np.bool_), np.zeros(len(outlines) + 1, np.bool_)
        glass[list(surfaces.glass)] = True
        dark[list(surfaces.dark)] = True
        for k, body in enumerate(scene.objects, len(scene.static)):
            dark[k] = body.track in surfaces.dark_tracks
        behind, behind_outline = ranges, outline
        if glass[outline].any():
            kept = np.flatnonzero(~glass[:-1])
            behind, among_kept = first_hits([outlines[k] for k in kept], poses[kept], *beams)
            behind_outline = np.append(kept, -1).astype(np.int32)[among_kept]
        return Hits(ranges, outline, behind, behind_outline, glass[outline], dark[behind_outline])


def sweep(
    scene: Scene, world_T_sensor: SE2, angle_min: float, angle_increment: float, beams: int, range_max: float
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Exact ranges (B,) float32, metres, and labels (B,) uint8 of a laser at `world_T_sensor`.

    Beam i has the angle `angle_min + i * angle_increment` (radians, counter-clockwise, sensor frame). A range is the
    distance to the nearest side of any outline, from outside or inside; +inf, labelled UNLABELLED, if it is beyond
    `range_max`.
    """
    ranges, outline = first_hits(
        _outlines(scene), _poses(scene, world_T_sensor.inverse()), angle_min, angle_increment, beams, range_max
    )
    return ranges.astype(np.float32), scene.labels[outline]


def first_hits(
    outlines: Sequence[Outline],
    poses: NDArray[np.float64],
    angle_min: float,
    angle_increment: float,
    beams: int,
    range_max: float,
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """The range (B,) float64 of each beam, metres, +inf without a hit, and the index (B,) int32 of the outline hit,
    -1 without a hit; `poses` (O, 3) are x, y, heading of the outlines in the sensor frame."""
    nearest = np.full(beams, np.inf)
    hit = np.full(beams, -1, np.int32)
    if len(outlines):
        _sweep(
            np.concatenate(outlines).astype(np.float64),
            np.array([len(outline) for outline in outlines]),
            poses,
            angle_min,
            angle_increment,
            range_max,
            nearest,
            hit,
        )
    return nearest, hit


def _outlines(scene: Scene) -> list[Outline]:
    return [*scene.static, *(road_user.outline for road_user in scene.objects)]


def with_noise(ranges: NDArray[np.float32], range_max: float, random: np.random.Generator) -> NDArray[np.float32]:
    """`ranges` (B,) with normal noise, rounded to TICK_M, at most `range_max`; infinite ranges stay infinite."""
    std = np.where(ranges <= NEAR_RANGE_M, NEAR_NOISE_M, FAR_NOISE_M)
    ticks = np.round((ranges + std * random.standard_normal(ranges.size)) / TICK_M)
    measured = np.clip(ticks * TICK_M, 0.0, math.floor(range_max / TICK_M) * TICK_M)
    return np.where(np.isfinite(ranges), measured, np.inf).astype(np.float32)


def _poses(scene: Scene, sensor_T_world: SE2) -> NDArray[np.float64]:
    """x, y, heading (O, 3) of each outline in the sensor frame, static ones first."""
    poses = [sensor_T_world] * len(scene.static)
    poses += [sensor_T_world @ road_user.world_T_object for road_user in scene.objects]
    return np.array([(pose.x, pose.y, pose.theta) for pose in poses])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _sweep(corners, counts, poses, angle_min, angle_increment, range_max, nearest, hit):  # type: ignore[no-untyped-def]
    """Reduce `nearest` (B,) to the distance of the nearest side, and set `hit` (B,) to the index of its outline."""
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
                o,
                nearest,
                hit,
            )
        first += counts[o]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _side(px, py, qx, qy, angle_min, angle_increment, range_max, o, nearest, hit):  # type: ignore[no-untyped-def]
    """One side from p to q, sensor frame: only the beams between the angles of its ends can intersect it."""
    ex, ey = qx - px, qy - py
    length = math.hypot(ex, ey)
    across = px * qy - py * qx
    if length == 0.0 or abs(across) >= length * range_max * (1.0 + 1e-9):
        return
    if abs(across) <= TOUCHING * length * length:
        _intersect(0, nearest.size, px, py, ex, ey, angle_min, angle_increment, range_max, o, nearest, hit)
        return
    # mirrored for clockwise beams: angles always increase with the beam number
    turn = 1.0 if angle_increment >= 0.0 else -1.0
    step = max(abs(angle_increment), 1e-12)
    span = math.atan2(abs(across), px * qx + py * qy)
    start = turn * (math.atan2(py, px) - angle_min) - (span if turn * across < 0.0 else 0.0)
    start = start % (2.0 * math.pi) - 2.0 * math.pi
    while start <= step * nearest.size:
        begin = min(max(math.ceil(start / step) - 1, 0), nearest.size)
        end = min(max(math.floor((start + span) / step) + 2, 0), nearest.size)
        _intersect(begin, end, px, py, ex, ey, angle_min, angle_increment, range_max, o, nearest, hit)
        start += 2.0 * math.pi


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _intersect(begin, end, px, py, ex, ey, angle_min, angle_increment, range_max, o, nearest, hit):  # type: ignore[no-untyped-def]
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
            hit[i] = o

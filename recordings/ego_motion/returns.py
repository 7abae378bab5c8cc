"""The returns of a scan as points with the normals of their walls, and the detection of moving returns."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gridtrack.common.geometry import SE2, wrap_angle
from gridtrack.common.scan import Scan

PlaneArray = NDArray[np.float64]
MATCHED_RANGE_M = 20.0
"""Range of the returns that are matched, and of the local map."""
MAX_RETURNS = 720
"""If a scan has more returns, every n-th one is used."""
WALL_HALF_M = 0.2
"""Half of the length of wall from which the normal at a return is estimated."""
MAX_HALF_WINDOW = 16
"""Limit of the neighbours on each side of a return for its normal."""
MAX_ROUGHNESS_M = 0.06
"""Maximum standard deviation of returns across their wall."""
NEAREST_M = 1e-3
MAX_LENGTH_M = 0.3
"""Limit of the surface that a return represents."""
CLUSTER_GAP_M = 0.5
"""Neighbouring returns that are further apart belong to different clusters."""
LOOK_BACK_NS = (400_000_000, 800_000_000, 1_200_000_000)
"""Ages of the earlier scans that are compared: a walking person has moved on in between."""
MARGIN_M, MARGIN_SHARE = 0.3, 0.03
"""Margin between a return and the earlier range, metres and share of the range: larger than pose errors."""
NEIGHBOURS = 2
"""The nearest range of this many beams on each side counts, for walls seen at a small angle."""
LAST_SCAN_NS = 50_000_000
"""For objects that left their place also the scan nearest to this age is compared, usually the one before."""
REACH_M, STAYED_M = 1.5, 0.2
"""An object that left its place is within REACH_M of it; a return within STAYED_M of an earlier one did not move."""
OBJECT_M = 6.0
"""Larger clusters are assumed to be walls, which do not move."""
MOVING_SHARE = 0.5
"""A cluster moves if a larger share of its returns seems to."""


class ScanReturns(NamedTuple):
    """The returns of one scan, sensor frame at the scan's stamp.

    `points` (N, 2) metres in the order of the beams, `normals` (N, 2) unit vectors across the wall; `on_wall` (N,): the
    neighbours are on one line with the return: its normal is valid. `length` (N,) metres: the surface that each return
    represents, so that near objects with many returns weigh no more than far ones. `cluster` (N,): number of the
    cluster, `extent` (N,) metres: diagonal of the cluster's bounding box.
    """

    points: PlaneArray
    normals: PlaneArray
    on_wall: NDArray[np.bool_]
    length: PlaneArray
    cluster: NDArray[np.int64]
    extent: PlaneArray

    def only(self, chosen: NDArray[np.bool_]) -> ScanReturns:
        """The `chosen` (N,) returns, with the normals, lengths and clusters computed from all."""
        points, normals, on_wall, length, cluster, extent = self
        return ScanReturns(
            points[chosen], normals[chosen], on_wall[chosen], length[chosen], cluster[chosen], extent[chosen]
        )


def returns_of(scan: Scan, motion: SE2, motion_s: float) -> ScanReturns:
    """The returns of `scan` up to MATCHED_RANGE_M, deskewed to its stamp.

    `motion` is the sensor's motion over `motion_s` seconds, sensor frame. If the scan has beam times, each return is
    moved by the motion since the stamp, at constant velocity.
    """
    points, beam = measured_points(scan)
    if scan.time_increment_s and motion_s > 0.0:
        points = deskewed(points, beam * (scan.time_increment_s / motion_s), motion)
    return returns_at(points)


def measured_points(scan: Scan) -> tuple[PlaneArray, PlaneArray]:
    """The returns up to MATCHED_RANGE_M as points (N, 2), sensor frame, and the numbers of their beams (N,)."""
    ranges = scan.ranges.astype(np.float64)
    (beam,) = np.nonzero((ranges >= max(scan.range_min, NEAREST_M)) & (ranges <= min(scan.range_max, MATCHED_RANGE_M)))
    beam = beam[:: max(1, -(-beam.size // MAX_RETURNS))]
    number = beam.astype(np.float64)
    angle = scan.angle_min + scan.angle_increment * number
    return ranges[beam, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1), number


def returns_at(points: PlaneArray) -> ScanReturns:
    """Points (N, 2) in the order of the beams as returns."""
    normals, on_wall = wall_normals(points)
    length, cluster, extent = surfaces(points)
    return ScanReturns(points, normals, on_wall, length, cluster, extent)


def surfaces(points: PlaneArray) -> tuple[PlaneArray, NDArray[np.int64], PlaneArray]:
    """length (N,), cluster (N,) and extent (N,), as in ScanReturns, of points (N, 2) in the order of the beams."""
    if not len(points):
        return np.zeros(0), np.zeros(0, np.int64), np.zeros(0)
    gap = np.linalg.norm(np.diff(points, axis=0), axis=1)
    near = np.minimum(gap, MAX_LENGTH_M)
    length = (np.append(near, MAX_LENGTH_M) + np.insert(near, 0, MAX_LENGTH_M)) / 2.0
    begins = np.flatnonzero(np.insert(gap > CLUSTER_GAP_M, 0, True))
    cluster = np.cumsum(np.insert(gap > CLUSTER_GAP_M, 0, False))
    sides = np.maximum.reduceat(points, begins) - np.minimum.reduceat(points, begins)
    return length, cluster, np.hypot(*sides.T)[cluster]


def deskewed(points: PlaneArray, share: PlaneArray, motion: SE2) -> PlaneArray:
    """Points (N, 2) measured after `share` (N,) of `motion`, in the frame before the motion.

    Positions are interpolated linearly: for turns up to 5 degrees within a thousandth of the arc.
    """
    c, s = np.cos(share * motion.theta), np.sin(share * motion.theta)
    turned = np.stack([c * points[:, 0] - s * points[:, 1], s * points[:, 0] + c * points[:, 1]], axis=1)
    return turned + share[:, None] * [motion.x, motion.y]


def wall_normals(points: PlaneArray) -> tuple[PlaneArray, NDArray[np.bool_]]:
    """Normals (N, 2) of the lines through neighbouring points, and whether the neighbours are on a line (N,).

    The line is the principal axis of the points within WALL_HALF_M of wall on each side.
    """
    count = len(points)
    if count < 3:
        return np.zeros((count, 2)), np.zeros(count, np.bool_)
    spacing = np.linalg.norm(np.diff(points, axis=0), axis=1)
    typical = np.minimum(np.append(spacing, np.inf), np.insert(spacing, 0, np.inf))
    half = np.clip(np.ceil(WALL_HALF_M / np.maximum(typical, 1e-6)), 2, MAX_HALF_WINDOW).astype(np.int64)
    index = np.arange(count)
    low, high = np.maximum(index - half, 0), np.minimum(index + half + 1, count)
    x, y = points.T
    sums = np.cumsum(np.concatenate([np.zeros((5, 1)), [x, y, x * x, y * y, x * y]], axis=1), axis=1)
    mean_x, mean_y, xx, yy, xy = (sums[:, high] - sums[:, low]) / (high - low)
    xx, yy, xy = xx - mean_x**2, yy - mean_y**2, xy - mean_x * mean_y
    direction = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    middle, radius = (xx + yy) / 2.0, np.hypot((xx - yy) / 2.0, xy)
    across, along = np.maximum(middle - radius, 0.0), middle + radius
    on_wall = (across < MAX_ROUGHNESS_M**2) & (across < along / 9.0)
    return np.stack([-np.sin(direction), np.cos(direction)], axis=1), on_wall


def homogeneous(pose: SE2) -> PlaneArray:
    """The pose as a 4 x 4 matrix, at z = 0."""
    c, s = math.cos(pose.theta), math.sin(pose.theta)
    return np.array([[c, -s, 0.0, pose.x], [s, c, 0.0, pose.y], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


def planar(pose: PlaneArray) -> SE2:
    """x, y and heading of a 4 x 4 matrix."""
    return SE2(float(pose[0, 3]), float(pose[1, 3]), math.atan2(pose[1, 0], pose[0, 0]))


class _Earlier(NamedTuple):
    """An earlier scan: its returns (N, 2) in its sensor frame, its pose, and the free range of each beam (B,)."""

    scan: Scan
    points: PlaneArray
    world_T_sensor: SE2
    free: PlaneArray


class EarlierScans:
    """The scans of the last seconds with their poses, to detect moving returns."""

    def __init__(self) -> None:
        self._scans: deque[_Earlier] = deque()

    def add(self, scan: Scan, points: PlaneArray, world_T_sensor: SE2) -> None:
        """Add the newest scan with its returns (N, 2), sensor frame."""
        self._scans.append(_Earlier(scan, points, world_T_sensor, _free_ranges(scan)))
        while scan.stamp_ns - self._scans[0].scan.stamp_ns > 2 * LOOK_BACK_NS[-1]:
            self._scans.popleft()

    def moving(self, scan: Scan, returns: ScanReturns, world_T_sensor: SE2) -> NDArray[np.bool_]:
        """Which returns (N,) of `scan` at a pose move."""
        appeared = self._appeared(returns.points, world_T_sensor, scan.stamp_ns)
        return appeared | self._departed(scan, returns, world_T_sensor)

    def _appeared(self, points: PlaneArray, world_T_sensor: SE2, stamp_ns: int) -> NDArray[np.bool_]:
        """Which of `points` (N, 2), sensor frame at `stamp_ns`, are in the free space of an earlier scan, (N,)."""
        appeared = np.zeros(len(points), np.bool_)
        there = world_T_sensor.apply(points)
        for earlier in self._compared(stamp_ns, LOOK_BACK_NS):
            in_earlier_frame = earlier.world_T_sensor.inverse().apply(there)
            appeared |= _in_free_space(in_earlier_frame, earlier.scan, earlier.free)
        return appeared

    def _departed(self, scan: Scan, returns: ScanReturns, world_T_sensor: SE2) -> NDArray[np.bool_]:
        """Which returns (N,) are of an object near the place that it has left."""
        departed, free = np.zeros(len(returns.points), np.bool_), _free_ranges(scan)
        for earlier in self._compared(scan.stamp_ns, (LAST_SCAN_NS, *LOOK_BACK_NS)):
            then = (world_T_sensor.inverse() @ earlier.world_T_sensor).apply(earlier.points)
            left = _in_free_space(then, scan, free)
            candidates = (returns.extent < OBJECT_M) & ~departed
            if left.any() and not left.all() and candidates.any():
                from_left, _ = cKDTree(then[left]).query(returns.points[candidates], distance_upper_bound=REACH_M)
                from_stayed, _ = cKDTree(then[~left]).query(returns.points[candidates], distance_upper_bound=STAYED_M)
                cluster = returns.cluster[candidates]
                away = np.bincount(cluster, np.isfinite(from_left) & np.isinf(from_stayed))
                departed[candidates] = (away > MOVING_SHARE * np.maximum(np.bincount(cluster), 1))[cluster]
        return departed

    def _compared(self, stamp_ns: int, ages_ns: Sequence[int]) -> list[_Earlier]:
        """The scan nearest to each age, of the scans at least half as old."""
        chosen = {}
        for age_ns in ages_ns:
            old = [earlier for earlier in self._scans if stamp_ns - earlier.scan.stamp_ns >= age_ns // 2]
            if old:
                nearest = min(old, key=lambda earlier: abs(stamp_ns - earlier.scan.stamp_ns - age_ns))
                chosen[nearest.scan.stamp_ns] = nearest
        return list(chosen.values())


def _free_ranges(scan: Scan) -> PlaneArray:
    """The free range of each beam and its neighbours (B,), metres; 0 if one of them is invalid."""
    ranges = scan.ranges.astype(np.float64)
    if not ranges.size:
        return ranges
    ranges[~(ranges >= scan.range_min)] = 0.0
    padded = np.pad(np.minimum(ranges, scan.range_max), NEIGHBOURS)
    nearest: PlaneArray = np.lib.stride_tricks.sliding_window_view(padded, 2 * NEIGHBOURS + 1).min(
        axis=1, initial=math.inf
    )
    return nearest


def _in_free_space(points: PlaneArray, scan: Scan, free: PlaneArray) -> NDArray[np.bool_]:
    """Which of `points` (N, 2), in the sensor frame of `scan`, are in its free space, (N,)."""
    if not free.size:
        return np.zeros(len(points), np.bool_)
    distance = np.hypot(points[:, 0], points[:, 1])
    middle = scan.angle_min + scan.angle_increment * (free.size - 1) / 2.0
    bearing = wrap_angle(np.arctan2(points[:, 1], points[:, 0]) - middle) / scan.angle_increment
    beam = np.rint(bearing + (free.size - 1) / 2.0).astype(np.int64)
    seen = (beam >= 0) & (beam < free.size)
    reach = np.where(seen, free[np.clip(beam, 0, free.size - 1)], 0.0)
    clear: NDArray[np.bool_] = distance * (1.0 + MARGIN_SHARE) + MARGIN_M < reach
    return clear

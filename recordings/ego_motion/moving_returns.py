"""Returns of what moves: they lie where an earlier scan saw free space, or left a place that is seen empty now.

Visibility between range images, as for 3D scanners: Yoon, Tang and Barfoot, Mapless online detection of dynamic objects
in 3D lidar, CRV 2019. What walks all in one direction would otherwise drag the pose along. A car that drives in front
is never where an earlier scan saw free space, for it hid that space itself: it is found by the place that it left.
"""

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
from gridtrack.recordings.ego_motion.returns import PlaneArray, ScanReturns

LOOK_BACK_NS = (400_000_000, 800_000_000, 1_200_000_000)
"""Ages of the earlier scans that are compared: someone who walks has left his place in between."""
MARGIN_M, MARGIN_SHARE = 0.3, 0.03
"""A return must be nearer than the earlier range by this much, and by this share of it: more than pose errors."""
NEIGHBOURS = 2
"""Beams on each side of which the nearest range counts, for walls that are seen at a small angle."""
LAST_SCAN_NS = 50_000_000
"""For what left its place the scan nearest to this age is compared too, as a rule the one before."""
REACH_M, STAYED_M = 1.5, 0.2
"""What left its place is within reach of it; a return this near to an earlier one that is still there did not move."""
OBJECT_M = 6.0
"""A larger cluster is taken for a wall, which has not left its place."""
MOVING_SHARE = 0.5
"""A cluster moves of which a larger share of the returns seem to."""


class _Earlier(NamedTuple):
    """An earlier scan: its returns (N, 2) in its sensor frame, its pose, and how far each beam saw free space, (B,)."""

    scan: Scan
    points: PlaneArray
    world_T_sensor: SE2
    free: PlaneArray


class EarlierScans:
    """The scans of the last second or so with their poses."""

    def __init__(self) -> None:
        self._scans: deque[_Earlier] = deque()

    def add(self, scan: Scan, points: PlaneArray, world_T_sensor: SE2) -> None:
        """Add the newest scan with its returns (N, 2), sensor frame."""
        self._scans.append(_Earlier(scan, points, world_T_sensor, _free_ranges(scan)))
        while scan.stamp_ns - self._scans[0].scan.stamp_ns > 2 * LOOK_BACK_NS[-1]:
            self._scans.popleft()

    def moving(self, scan: Scan, returns: ScanReturns, world_T_sensor: SE2) -> NDArray[np.bool_]:
        """Which of the returns of `scan` at a pose move, (N,)."""
        appeared = self._appeared(returns.points, world_T_sensor, scan.stamp_ns)
        return appeared | self._departed(scan, returns, world_T_sensor)

    def _appeared(self, points: PlaneArray, world_T_sensor: SE2, stamp_ns: int) -> NDArray[np.bool_]:
        """Which of `points` (N, 2), sensor frame at `stamp_ns`, lie where an earlier scan saw free space, (N,)."""
        appeared = np.zeros(len(points), np.bool_)
        there = world_T_sensor.apply(points)
        for earlier in self._compared(stamp_ns, LOOK_BACK_NS):
            in_it = earlier.world_T_sensor.inverse().apply(there)
            appeared |= _in_free_space(in_it, earlier.scan, earlier.free)
        return appeared

    def _departed(self, scan: Scan, returns: ScanReturns, world_T_sensor: SE2) -> NDArray[np.bool_]:
        """Which returns (N,) are of an object beside a place that it has left."""
        departed, free = np.zeros(len(returns.points), np.bool_), _free_ranges(scan)
        for earlier in self._compared(scan.stamp_ns, (LAST_SCAN_NS, *LOOK_BACK_NS)):
            then = (world_T_sensor.inverse() @ earlier.world_T_sensor).apply(earlier.points)
            left = _in_free_space(then, scan, free)
            asked = (returns.extent < OBJECT_M) & ~departed
            if left.any() and not left.all() and asked.any():
                from_left, _ = cKDTree(then[left]).query(returns.points[asked], distance_upper_bound=REACH_M)
                from_stayed, _ = cKDTree(then[~left]).query(returns.points[asked], distance_upper_bound=STAYED_M)
                cluster = returns.cluster[asked]
                away = np.bincount(cluster, np.isfinite(from_left) & np.isinf(from_stayed))
                departed[asked] = (away > MOVING_SHARE * np.maximum(np.bincount(cluster), 1))[cluster]
        return departed

    def _compared(self, stamp_ns: int, ages_ns: Sequence[int]) -> list[_Earlier]:
        """The scan nearest to each age, of those at least half as old as it."""
        chosen = {}
        for age_ns in ages_ns:
            old = [one for one in self._scans if stamp_ns - one.scan.stamp_ns >= age_ns // 2]
            if old:
                nearest = min(old, key=lambda one: abs(stamp_ns - one.scan.stamp_ns - age_ns))
                chosen[nearest.scan.stamp_ns] = nearest
        return list(chosen.values())


def _free_ranges(scan: Scan) -> PlaneArray:
    """How far each beam and its neighbours saw free space, (B,) metres; 0 where one says nothing."""
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
    """Which of `points` (N, 2), in the sensor frame of `scan`, lie in its free space."""
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

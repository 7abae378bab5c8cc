"""Returns of what moves: they lie where an earlier scan saw free space.

Visibility between range images, as for 3D scanners: Yoon, Tang and Barfoot, Mapless online detection of dynamic objects
in 3D lidar, CRV 2019. What walks all in one direction would otherwise drag the pose along.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import SE2, wrap_angle
from gridtrack.common.scan import Scan
from gridtrack.recordings.ego_motion.returns import PlaneArray

LOOK_BACK_NS = (400_000_000, 800_000_000, 1_200_000_000)
"""Ages of the earlier scans that are compared: someone who walks has left his place in between."""
MARGIN_M, MARGIN_SHARE = 0.3, 0.03
"""A return must be nearer than the earlier range by this much, and by this share of it: more than pose errors."""
NEIGHBOURS = 2
"""Beams on each side of which the nearest range counts, for walls that are seen at a small angle."""


class EarlierScans:
    """The scans of the last second or so with their poses."""

    def __init__(self) -> None:
        self._scans: deque[tuple[Scan, SE2, PlaneArray]] = deque()

    def add(self, scan: Scan, world_T_sensor: SE2) -> None:
        """Add the newest scan."""
        self._scans.append((scan, world_T_sensor, _free_ranges(scan)))
        while scan.stamp_ns - self._scans[0][0].stamp_ns > 2 * LOOK_BACK_NS[-1]:
            self._scans.popleft()

    def moving(self, points: PlaneArray, world_T_sensor: SE2, stamp_ns: int) -> NDArray[np.bool_]:
        """Which of `points` (N, 2), sensor frame at `stamp_ns`, lie where an earlier scan saw free space, (N,)."""
        moving = np.zeros(len(points), np.bool_)
        there = world_T_sensor.apply(points)
        for scan, pose, free in self._compared(stamp_ns):
            moving |= _in_free_space(pose.inverse().apply(there), scan, free)
        return moving

    def _compared(self, stamp_ns: int) -> list[tuple[Scan, SE2, PlaneArray]]:
        """The scan nearest to each age, of those at least half as old as it."""
        chosen = {}
        for age_ns in LOOK_BACK_NS:
            old = [one for one in self._scans if stamp_ns - one[0].stamp_ns >= age_ns // 2]
            if old:
                nearest = min(old, key=lambda one: abs(stamp_ns - one[0].stamp_ns - age_ns))
                chosen[nearest[0].stamp_ns] = nearest
        return list(chosen.values())


def _free_ranges(scan: Scan) -> PlaneArray:
    """How far each beam and its neighbours saw free space, (B,) metres; 0 where one says nothing."""
    ranges = scan.ranges.astype(np.float64)
    ranges[~(ranges >= scan.range_min)] = 0.0
    padded = np.pad(np.minimum(ranges, scan.range_max), NEIGHBOURS)
    nearest: PlaneArray = np.lib.stride_tricks.sliding_window_view(padded, 2 * NEIGHBOURS + 1).min(
        axis=1, initial=math.inf
    )
    return nearest


def _in_free_space(points: PlaneArray, scan: Scan, free: PlaneArray) -> NDArray[np.bool_]:
    """Which of `points` (N, 2), in the sensor frame of `scan`, lie in its free space."""
    distance = np.hypot(points[:, 0], points[:, 1])
    middle = scan.angle_min + scan.angle_increment * (free.size - 1) / 2.0
    bearing = wrap_angle(np.arctan2(points[:, 1], points[:, 0]) - middle) / scan.angle_increment
    beam = np.rint(bearing + (free.size - 1) / 2.0).astype(np.int64)
    seen = (beam >= 0) & (beam < free.size)
    reach = np.where(seen, free[np.clip(beam, 0, free.size - 1)], 0.0)
    clear: NDArray[np.bool_] = distance * (1.0 + MARGIN_SHARE) + MARGIN_M < reach
    return clear

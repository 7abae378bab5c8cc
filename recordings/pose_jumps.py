"""Jumps in the poses of a sensor: steps that no robot makes, from a localisation or a damaged transform."""

from __future__ import annotations

import math
from dataclasses import dataclass

from gridtrack.common.geometry import SE2, wrap_angle

MIN_JUMP_M, MIN_JUMP_RAD = 0.3, math.radians(20.0)
MAX_ACCELERATION, MAX_TURN_ACCELERATION = 20.0, 40.0
"""m/s^2 and rad/s^2: twice those of a car that brakes, and of a small robot that begins to turn."""


MAX_FASTER = 2.0
"""A step at constant velocity is up to this many times the one before; stamps may be irregular."""


@dataclass(slots=True)
class PoseJumps:
    """Counts the steps from pose to pose that the step before and an acceleration do not explain."""

    count: int = 0
    largest_m: float = 0.0
    largest_rad: float = 0.0
    first_ns: int = 0
    _before: tuple[int, SE2] | None = None
    _step: tuple[float, float, float] | None = None
    """x, y and heading of the step before, metres and radians."""
    _period_s: float = 0.0

    def add(self, stamp_ns: int, pose: SE2) -> None:
        """Add the next pose of the sensor."""
        before, self._before = self._before, (stamp_ns, pose)
        if before is None or stamp_ns <= before[0]:
            return
        period_s = (stamp_ns - before[0]) / 1e9
        step = (pose.x - before[1].x, pose.y - before[1].y, wrap_angle(pose.theta - before[1].theta))
        if self._step is not None and self._is_jump(step, self._step, period_s):
            self.first_ns = self.first_ns or stamp_ns
            self.count += 1
            self.largest_m = max(self.largest_m, math.hypot(step[0] - self._step[0], step[1] - self._step[1]))
            self.largest_rad = max(self.largest_rad, abs(wrap_angle(step[2] - self._step[2])))
            return
        self._step, self._period_s = step, period_s

    def _is_jump(self, step: tuple[float, float, float], last: tuple[float, float, float], period_s: float) -> bool:
        faster = MAX_FASTER * max(1.0, period_s / self._period_s)
        reach = 0.5 * period_s * (period_s + self._period_s)
        away_m = _distance_to_segment(step[:2], (faster * last[0], faster * last[1]))
        away_rad = max(-step[2], 0.0) if last[2] >= 0.0 else max(step[2], 0.0)
        away_rad = max(away_rad, abs(step[2]) - faster * abs(last[2]))
        return away_m > max(MIN_JUMP_M, MAX_ACCELERATION * reach) or away_rad > max(
            MIN_JUMP_RAD, MAX_TURN_ACCELERATION * reach
        )

    def warning(self, recording_start_ns: int) -> str:
        """One line about the jumps; empty without any."""
        if not self.count:
            return ""
        at_s = (self.first_ns - recording_start_ns) / 1e9
        return (
            f"its pose jumps: {self.count} times in the whole recording, by up to {self.largest_m:.2f} m and"
            f" {math.degrees(self.largest_rad):.0f} deg, first {at_s:.1f} s after the first scan; walls are in two"
            " places there: choose a stretch without a jump, or continuous poses, such as those of odometry or of"
            " `recording import --ego-motion kiss-icp`"
        )


def _distance_to_segment(point: tuple[float, float], end: tuple[float, float]) -> float:
    """The distance of a point from the segment between the origin and `end`."""
    squared = end[0] ** 2 + end[1] ** 2
    share = (point[0] * end[0] + point[1] * end[1]) / squared if squared > 0.0 else 0.0
    share = min(max(share, 0.0), 1.0)
    return math.hypot(point[0] - share * end[0], point[1] - share * end[1])

"""Checks of recorded poses: jumps from scan to scan, and drift in comparison with the scans.

A jump is a step that no robot makes, from a localisation or a damaged transform.

For the drift scans a second apart are laid on each other: the later scan is matched with the earlier one, from the
relative pose that the recorded poses give (ego_motion/fit.py). The motion of its walls in the match, across themselves,
is the displacement of a wall in a second by the poses; sliding along a wall is not visible. Exact poses leave the noise
of the ranges and of the match: a centimetre or less. A sensor without recorded motion is taken to stand still, and the
same displacement shows whether it does.
"""

from __future__ import annotations

import math
from array import array
from dataclasses import dataclass, field, replace

import numpy as np

from gridtrack.common.geometry import SE2, same_pose, wrap_angle
from gridtrack.common.scan import Scan

MIN_JUMP_M, MIN_JUMP_RAD = 0.3, math.radians(20.0)
MAX_ACCELERATION, MAX_TURN_ACCELERATION = 20.0, 40.0
"""m/s^2 and rad/s^2: twice the values of a braking car, and of a small robot that begins to turn."""
MAX_FASTER = 2.0
"""Limit of a step at constant velocity, relative to the step before; stamps may be irregular."""
PAIR_S, LONGEST_PAIR_S = 1.0, 2.0
"""Time between the two scans of a pair, and its limit. Drift is reported per PAIR_S."""
PAIR_MOVED_M, PAIR_TURNED_RAD, PAIR_JUMPED_M = 0.2, math.radians(5.0), 20.0
"""Limits of the motion between the scans of a pair: below the first two odometry is exact, beyond the third it
jumps."""
SPARSER = 1.0 / 32.0
"""The next pair begins after this share of the time since the first scan, so long recordings have few more pairs."""
KERNELS_M = (0.5, 0.2, 0.1)
"""Kernels of successive matches of a pair: the first one reaches poses that are far off."""
PRIOR_INFORMATION = 0.01
"""Weight of the recorded poses in these matches: they decide only in directions that the walls leave open."""
ENOUGH_PAIRS = 8
DRIFT_LIMIT_M = 0.04
"""Median displacement from which there is a warning: half a cell or less of any usual grid."""
TURNS_DEG = (90, 180, 270)
TURNED_LIMIT_M, TURNED_SHARE = 0.1, 0.25
"""A turned mount explains the displacements if it leaves less than this, and than this share of them."""
ScanPair = tuple[Scan, tuple[SE2, float], Scan, tuple[SE2, float]]
"""Two scans, each with the motion of the sensor since the scan before it and its duration in seconds."""


@dataclass(slots=True)
class PoseDrift:
    """The displacements of walls between pairs of scans of one sensor by its poses, metres in PAIR_S.

    The pairs are of scans between which it moved by its poses; with `at_rest`, of those between which it did not, and
    a scan that lies on too little of the earlier one counts as displaced without limit. `turned_m` has the displaced
    pairs once more: as they are (0), and if the sensor was mounted turned by TURNS_DEG.
    """

    at_rest: bool = False
    displacements_m: array[float] = field(default_factory=lambda: array("d"))
    turned_m: dict[int, array[float]] = field(default_factory=lambda: {deg: array("d") for deg in (0, *TURNS_DEG)})
    _start_ns: int = 0
    _earlier: Scan | None = None
    _earlier_motion: tuple[SE2, float] = (SE2(), 0.0)
    _before: tuple[int, SE2] | None = None
    _next_ns: int = 0

    def add(self, scan: Scan) -> None:
        """Add the sensor's next scan."""
        before, self._before = self._before, (scan.stamp_ns, scan.world_T_sensor)
        if before is None:
            self._start_ns = scan.stamp_ns
        if self._earlier is None:
            if scan.stamp_ns >= self._next_ns:
                self._begin(scan, before)
            return
        since_s = (scan.stamp_ns - self._earlier.stamp_ns) / 1e9
        if since_s < PAIR_S:
            return
        between = self._earlier.world_T_sensor.inverse() @ scan.world_T_sensor
        way_m = math.hypot(between.x, between.y)
        has_turned = abs(between.theta) > PAIR_TURNED_RAD
        moved = PAIR_MOVED_M < way_m < PAIR_JUMPED_M or (way_m <= PAIR_MOVED_M and has_turned)
        wanted = same_pose(self._earlier.world_T_sensor, scan.world_T_sensor) if self.at_rest else moved
        if not wanted or since_s > LONGEST_PAIR_S:
            self._begin(scan, before)
            return
        self._add_pair((self._earlier, self._earlier_motion, scan, motion_since(before, scan)), since_s)
        self._earlier = None
        self._next_ns = scan.stamp_ns + int(SPARSER * (scan.stamp_ns - self._start_ns))

    def _add_pair(self, pair: ScanPair, since_s: float) -> None:
        """Add the displacement of a pair of scans `since_s` seconds apart."""
        displaced_m = displacement_m(*pair)
        if displaced_m is None:
            return
        if self.at_rest or math.isfinite(displaced_m):
            self.displacements_m.append(displaced_m * PAIR_S / since_s)
        if displaced_m > DRIFT_LIMIT_M and not self.at_rest:
            self.turned_m[0].append(displaced_m)
            for deg in TURNS_DEG:
                off_m = displacement_m(*as_if_turned(deg, *pair))
                self.turned_m[deg].append(math.inf if off_m is None else off_m)

    def _begin(self, scan: Scan, before: tuple[int, SE2] | None) -> None:
        self._earlier, self._earlier_motion = scan, motion_since(before, scan)

    @property
    def median_m(self) -> float | None:
        """The median displacement, metres in PAIR_S; None for fewer than ENOUGH_PAIRS."""
        return float(np.median(self.displacements_m)) if len(self.displacements_m) >= ENOUGH_PAIRS else None

    @property
    def upper_quartile_m(self) -> float | None:
        """The displacement that a quarter of the pairs exceeds, metres in PAIR_S; None for fewer than ENOUGH_PAIRS."""
        if len(self.displacements_m) < ENOUGH_PAIRS:
            return None
        return float(np.quantile(self.displacements_m, 0.75, method="lower"))

    @property
    def turn_deg(self) -> int:
        """The turn of the mount that explains most displacements, TURNS_DEG; 0 without one."""
        displaced = len(self.turned_m[0])
        agree = sum(found_m <= DRIFT_LIMIT_M for found_m in self.displacements_m)
        if displaced < max(ENOUGH_PAIRS, agree):
            return 0
        medians_m = {deg: float(np.median(found_m)) for deg, found_m in self.turned_m.items()}
        best = min(medians_m, key=medians_m.__getitem__)
        limit_m = min(TURNED_LIMIT_M, TURNED_SHARE * medians_m[0])
        return best if medians_m[best] < limit_m else 0

    def wrong_mount(self, turn_deg: int, remedy: str) -> str:
        """One line about a sensor that is mounted turned by `turn_deg`, with the `remedy`."""
        before_m, after_m = (float(np.median(self.turned_m[deg])) for deg in (0, turn_deg))
        return (
            f"its poses disagree with its scans, and agree if it is turned by {turn_deg} deg: walls then move"
            f" {after_m:.2f} m in a second, not {before_m:.2f} m: {remedy}"
        )

    def unrest(self, remedy: str) -> str:
        """One line about scans that move while the poses rest, with the `remedy`, a command; else empty.

        A robot may stand still for most of a recording: a quarter of the pairs decides.
        """
        quartile_m = self.upper_quartile_m
        if quartile_m is None or quartile_m < DRIFT_LIMIT_M:
            return ""
        by = f"by {quartile_m:.2f} m or more" if math.isfinite(quartile_m) else "too far to lay the scans on each other"
        return (
            f"no motion is recorded, but it moves: in a quarter of {len(self.displacements_m)} pairs of scans the walls"
            f" move {by} in a second, and every score is of turning walls: take the poses from the scans, in `compare`"
            f" and `train` with --ego-motion kiss-icp, or once with `{remedy}`"
        )

    def problem(self, remedy: str) -> str:
        """One line about poses that disagree with the scans, with the `remedy`, a command; else empty."""
        median_m = self.median_m
        if median_m is None or median_m < DRIFT_LIMIT_M:
            return ""
        return (
            f"its poses disagree with its scans: by them a wall moves {median_m:.2f} m in a second (median of"
            f" {len(self.displacements_m)} pairs of scans), so trackers with a memory smear the walls and score worse:"
            f" correct the poses with `{remedy}`"
        )


def motion_since(before: tuple[int, SE2] | None, scan: Scan) -> tuple[SE2, float]:
    """The sensor's motion since the scan before (stamp, pose), and its duration in seconds; 0 without such a scan."""
    if before is None or scan.stamp_ns <= before[0]:
        return SE2(), 0.0
    return before[1].inverse() @ scan.world_T_sensor, (scan.stamp_ns - before[0]) / 1e9


def as_if_turned(deg: int, earlier: Scan, moved: tuple[SE2, float], later: Scan, moves: tuple[SE2, float]) -> ScanPair:
    """A pair of scans, the arguments of `displacement_m`, as if the sensor was mounted turned by `deg`."""
    turn = SE2(0.0, 0.0, math.radians(deg))

    def seen(motion: SE2) -> SE2:
        return turn.inverse() @ motion @ turn

    between = earlier.world_T_sensor.inverse() @ later.world_T_sensor
    pose = earlier.world_T_sensor @ seen(between)
    return earlier, (seen(moved[0]), moved[1]), replace(later, world_T_sensor=pose), (seen(moves[0]), moves[1])


def displacement_m(earlier: Scan, moved: tuple[SE2, float], later: Scan, moves: tuple[SE2, float]) -> float | None:
    """The displacement of common walls of two scans by their poses: root mean square across the walls, metres.

    `moved` and `moves` are the motion of the sensor at each scan and its duration in seconds, for scans with beam
    times. Infinite if too small a part of the later scan, or of its walls, lies on the earlier one for a match; None
    for too few returns.
    """
    from scipy.spatial import cKDTree

    from gridtrack.recordings.ego_motion.fit import (
        MIN_INLIER_SHARE,
        MIN_RETURNS,
        fit_at,
        share_on_map,
        stepped,
        walls_of,
    )
    from gridtrack.recordings.ego_motion.returns import returns_of

    before, returns = returns_of(earlier, *moved), returns_of(later, *moves)
    if min(len(before.points), len(returns.points)) < MIN_RETURNS:
        return None
    between = earlier.world_T_sensor.inverse() @ later.world_T_sensor
    map_points, walls, pose = cKDTree(before.points), walls_of(returns), between
    for kernel_m in KERNELS_M:
        pose = stepped(pose, walls, map_points, (between, PRIOR_INFORMATION * np.eye(3)), kernel_m)
    fit = fit_at(pose, walls, map_points, KERNELS_M[-1])
    shared = share_on_map(pose, returns, map_points, KERNELS_M[-1], len(returns.points))
    if shared < MIN_INLIER_SHARE or np.count_nonzero(fit.on_map) < MIN_RETURNS:
        return math.inf
    off = pose.inverse() @ between
    across = walls.jacobian[fit.on_map] @ [off.x, off.y, off.theta]
    return float(np.sqrt(np.mean(np.square(across))))


@dataclass(slots=True)
class PoseJumps:
    """Counts the steps from pose to pose that neither the step before nor an acceleration explains."""

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
            " places there: choose a stretch without a jump, or continuous poses, from odometry or with --ego-motion"
            " kiss-icp"
        )


def _distance_to_segment(point: tuple[float, float], end: tuple[float, float]) -> float:
    """The distance of a point from the segment between the origin and `end`."""
    squared = end[0] ** 2 + end[1] ** 2
    share = (point[0] * end[0] + point[1] * end[1]) / squared if squared > 0.0 else 0.0
    share = min(max(share, 0.0), 1.0)
    return math.hypot(point[0] - share * end[0], point[1] - share * end[1])

"""Scan after scan matched: the pose of each follows from the one before, odometry or the last motion, and the match."""

from __future__ import annotations

from gridtrack.common.geometry import SE2
from gridtrack.common.pose_quality import PoseQuality
from gridtrack.common.scan import Scan
from gridtrack.recordings.ego_motion.matching import ScanMatcher
from gridtrack.recordings.ego_motion.prior import MAX_COAST_S, Prior, motion_prior, odometry_prior
from gridtrack.recordings.ego_motion.settings import MatchingSettings

REST_M, REST_RAD = 0.01, 0.005
"""Where odometry reports no motion at all, a match within these limits is noise: the pose stays as it is."""


MIN_VELOCITY_S = 0.04
"""The velocity is measured over at least this time."""


class Follower:
    """Follows one sensor, scan after scan; with `odometry` the recorded motion is the prior of each match."""

    def __init__(self, settings: MatchingSettings, odometry: bool) -> None:
        """Raises RecordingError where kiss-icp is not installed."""
        self._settings, self._odometry = settings, odometry
        self._matcher = ScanMatcher(settings)
        self._first: Scan | None = None
        self._last: Scan | None = None
        self._pose = SE2()
        self._velocity = SE2()
        self._velocity_from: tuple[int, SE2] = 0, SE2()
        self._matched_ns = 0

    def follow(self, scan: Scan) -> tuple[SE2, PoseQuality]:
        """`world_T_sensor` of the next scan; the first scan has its recorded pose."""
        if self._last is None:
            self._last = self._first = scan
            self._pose, self._matched_ns = scan.world_T_sensor, scan.stamp_ns
            self._velocity_from = scan.stamp_ns, self._pose
            self._matcher.start(scan, self._pose, SE2(), 0.0)
            return self._pose, PoseQuality("start")
        since_s = (scan.stamp_ns - self._last.stamp_ns) / 1e9
        prior = self._prior(scan, self._last, since_s)
        pose, quality = self._matcher.match(scan, prior, since_s)
        motion = self._pose.inverse() @ pose
        if self._last is self._first and self._last.time_increment_s:
            # without odometry both scans were matched as they are, alike skewed, so that the match gives the motion
            pose, quality = self._started_again(scan, self._last, prior.motion if self._odometry else motion, since_s)
            motion = self._pose.inverse() @ pose
        if self._odometry and prior.motion == SE2() and _is_noise(motion):
            pose = self._pose
        if not quality.failed:
            self._measure_velocity(scan.stamp_ns, pose)
        if not quality.fell_back:
            self._matched_ns = scan.stamp_ns
        self._last, self._pose = scan, pose
        return pose, quality

    def _measure_velocity(self, stamp_ns: int, pose: SE2) -> None:
        """From the last pose that is old enough: stamps of a log that come in bursts would give any velocity."""
        then_ns, then = self._velocity_from
        since_s = (stamp_ns - then_ns) / 1e9
        if since_s >= MIN_VELOCITY_S:
            motion = then.inverse() @ pose
            self._velocity = SE2(motion.x / since_s, motion.y / since_s, motion.theta / since_s)
            self._velocity_from = stamp_ns, pose

    def _started_again(self, scan: Scan, first: Scan, motion: SE2, since_s: float) -> tuple[SE2, PoseQuality]:
        """The second scan matched with the first once the motion is known by which the first is skewed."""
        self._matcher = ScanMatcher(self._settings)
        self._matcher.start(first, self._pose, motion, since_s)
        velocity = SE2(motion.x / since_s, motion.y / since_s, motion.theta / since_s)
        return self._matcher.match(scan, motion_prior(self._pose, velocity, since_s, self._settings), since_s)

    def _prior(self, scan: Scan, last: Scan, since_s: float) -> Prior:
        if self._odometry:
            return odometry_prior(self._pose, last.world_T_sensor.inverse() @ scan.world_T_sensor, self._settings)
        coasting_s = (scan.stamp_ns - self._matched_ns) / 1e9
        velocity = self._velocity if coasting_s <= MAX_COAST_S else SE2()
        return motion_prior(self._pose, velocity, since_s, self._settings)


def _is_noise(motion: SE2) -> bool:
    return max(abs(motion.x), abs(motion.y)) < REST_M and abs(motion.theta) < REST_RAD

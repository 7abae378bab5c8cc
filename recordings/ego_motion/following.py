"""Scan after scan matched: the pose of each follows from the one before, odometry or the last motion, and the match."""

from __future__ import annotations

import numpy as np

from gridtrack.common.geometry import SE2
from gridtrack.common.pose_quality import PoseQuality
from gridtrack.common.scan import Scan
from gridtrack.recordings.ego_motion.last_motion import LastMotion
from gridtrack.recordings.ego_motion.matching import ScanMatch, ScanMatcher
from gridtrack.recordings.ego_motion.prior import Prior, motion_prior, odometry_prior
from gridtrack.recordings.ego_motion.settings import MatchingSettings

REST_M, REST_RAD = 0.01, 0.005
"""Where odometry reports no motion at all, a match within these limits is noise: the pose stays as it is."""


class Follower:
    """Follows one sensor, scan after scan; with `odometry` the recorded motion is the prior of each match."""

    def __init__(self, settings: MatchingSettings, odometry: bool) -> None:
        """Raises RecordingError where kiss-icp is not installed."""
        self._settings, self._odometry = settings, odometry
        self._matcher = ScanMatcher(settings)
        self._first: Scan | None = None
        self._last: Scan | None = None
        self._pose = SE2()
        self._motion = LastMotion(0, SE2(), settings)

    def follow(self, scan: Scan) -> ScanMatch:
        """The match of the next scan; the first scan has its recorded pose."""
        if self._last is None:
            self._last = self._first = scan
            self._pose = scan.world_T_sensor
            self._motion = LastMotion(scan.stamp_ns, self._pose, self._settings)
            self._matcher.start(scan, self._pose, SE2(), 0.0)
            return ScanMatch(self._pose, PoseQuality("start"), np.zeros((3, 3)))
        since_s = (scan.stamp_ns - self._last.stamp_ns) / 1e9
        prior = self._prior(scan, self._last, since_s)
        match = self._matcher.match(scan, prior, since_s)
        if self._last is self._first and self._last.time_increment_s:
            # without odometry both scans were matched as they are, alike skewed, so that the match gives the motion
            motion = prior.motion if self._odometry else self._pose.inverse() @ match.world_T_sensor
            match = self._started_again(scan, self._last, match, motion, since_s)
        pose = match.world_T_sensor
        if self._odometry and prior.motion == SE2() and _is_noise(self._pose.inverse() @ pose):
            pose = self._pose
        self._motion.add(scan.stamp_ns, pose, match.quality, match.information)
        self._last, self._pose = scan, pose
        return match._replace(world_T_sensor=pose)

    def _started_again(self, scan: Scan, first: Scan, match: ScanMatch, motion: SE2, since_s: float) -> ScanMatch:
        """The second scan matched with the first once the motion is known by which the first is skewed."""
        self._matcher = ScanMatcher(self._settings)
        self._matcher.start(first, self._pose, motion, since_s)
        again = LastMotion(first.stamp_ns, self._pose, self._settings)
        again.add(scan.stamp_ns, self._pose @ motion, match.quality, match.information)
        prior = motion_prior(self._pose, again.velocity(scan.stamp_ns), since_s, self._settings)
        return self._matcher.match(scan, prior, since_s)

    def _prior(self, scan: Scan, last: Scan, since_s: float) -> Prior:
        if self._odometry:
            return odometry_prior(self._pose, last.world_T_sensor.inverse() @ scan.world_T_sensor, self._settings)
        return motion_prior(self._pose, self._motion.velocity(scan.stamp_ns), since_s, self._settings)


def _is_noise(motion: SE2) -> bool:
    return max(abs(motion.x), abs(motion.y)) < REST_M and abs(motion.theta) < REST_RAD

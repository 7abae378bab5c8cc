"""The poses of a whole recording from its scans, with or without odometry."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from gridtrack.common.geometry import SE2, wrap_angle
from gridtrack.common.scan import PoseQuality, Scan
from gridtrack.recordings.ego_motion.matching import ScanMatch, ScanMatcher
from gridtrack.recordings.ego_motion.prior import LastMotion, Prior, motion_prior, odometry_prior
from gridtrack.recordings.ego_motion.returns import OBJECT_M
from gridtrack.recordings.interpolated_poses import InterpolatedPoses
from gridtrack.recordings.read_options import PoseSource

REST_M, REST_RAD = 0.01, 0.005
"""If odometry reports no motion at all, a match within these limits is noise: the pose is kept."""
STANDING_M, STANDING_RAD = 0.05, 0.02
"""A sensor is at rest if its matched poses are this near to one another: matching noise."""


class ScanOdometry:
    """Estimates the pose of one sensor scan by scan; with `odometry` the recorded motion is the prior of each match."""

    def __init__(self, odometry: bool) -> None:
        """Raises RecordingError if kiss-icp is not installed."""
        self._odometry = odometry
        self._matcher = ScanMatcher()
        self._first: Scan | None = None
        self._last: Scan | None = None
        self._pose = SE2()
        self._motion = LastMotion(0, SE2())

    def match(self, scan: Scan) -> ScanMatch:
        """The match of the next scan; the first scan keeps its recorded pose."""
        if self._last is None:
            self._last = self._first = scan
            self._pose = scan.world_T_sensor
            self._motion = LastMotion(scan.stamp_ns, self._pose)
            self._matcher.start(scan, self._pose, SE2(), 0.0)
            return ScanMatch(self._pose, PoseQuality("start"), np.zeros((3, 3)))
        since_s = (scan.stamp_ns - self._last.stamp_ns) / 1e9
        prior = self._prior(scan, self._last, since_s)
        match = self._matcher.match(scan, prior, since_s)
        if self._last is self._first and self._last.time_increment_s:
            # without odometry both scans were matched with the same skew, so that the match gives the motion
            motion = prior.motion if self._odometry else self._pose.inverse() @ match.world_T_sensor
            match = self._rematched(scan, self._last, match, motion, since_s)
        pose = match.world_T_sensor
        if self._odometry and prior.motion == SE2() and _is_noise(self._pose.inverse() @ pose):
            pose = self._pose
        self._motion.add(scan.stamp_ns, pose, match.quality, match.information)
        self._last, self._pose = scan, pose
        return match._replace(world_T_sensor=pose)

    def _rematched(self, scan: Scan, first: Scan, match: ScanMatch, motion: SE2, since_s: float) -> ScanMatch:
        """The second scan matched again with the first one, now deskewed by the `motion` between them."""
        self._matcher = ScanMatcher()
        self._matcher.start(first, self._pose, motion, since_s)
        again = LastMotion(first.stamp_ns, self._pose)
        again.add(scan.stamp_ns, self._pose @ motion, match.quality, match.information)
        prior = motion_prior(self._pose, again.velocity(scan.stamp_ns), since_s)
        return self._matcher.match(scan, prior, since_s)

    def _prior(self, scan: Scan, last: Scan, since_s: float) -> Prior:
        if self._odometry:
            return odometry_prior(self._pose, last.world_T_sensor.inverse() @ scan.world_T_sensor)
        return motion_prior(self._pose, self._motion.velocity(scan.stamp_ns), since_s)


def _is_noise(motion: SE2) -> bool:
    return max(abs(motion.x), abs(motion.y)) < REST_M and abs(motion.theta) < REST_RAD


@dataclass
class MatchedTrajectory:
    """The scans of one sensor: stamps, recorded and matched poses, and the quality of the matches.

    `by_objects` marks scans in which clusters of an object's size alone constrain a direction.
    """

    sensor: str
    stamps_ns: list[int] = field(default_factory=list)
    recorded: list[SE2] = field(default_factory=list)
    matched: list[SE2] = field(default_factory=list)
    qualities: list[PoseQuality] = field(default_factory=list)
    by_objects: list[bool] = field(default_factory=list)
    stands: bool = False

    def add(self, scan: Scan, match: ScanMatch) -> None:
        """Add the next scan."""
        self.stamps_ns.append(scan.stamp_ns)
        self.recorded.append(scan.world_T_sensor)
        self.matched.append(match.world_T_sensor)
        self.qualities.append(match.quality)
        self.by_objects.append(match.by_objects)

    def finish(self) -> None:
        """If the sensor is at rest, set all matched poses to the first one."""
        x, y, theta = _columns(self.matched)
        turn = np.abs(wrap_angle(theta - theta[0]))
        still = not any(pose != self.recorded[0] for pose in self.recorded)
        self.stands = still and max(np.ptp(x), np.ptp(y)) < STANDING_M and float(turn.max()) < STANDING_RAD
        if self.stands:
            self.matched = [self.recorded[0]] * len(self.matched)

    def _share_and_time(self, chosen: Sequence[bool]) -> str:
        """The share of the `chosen` (N,) scans, and their duration."""
        seconds = float(np.diff(self.stamps_ns)[np.array(chosen[1:], np.bool_)].sum() / 1e9)
        return f"{sum(chosen) / len(chosen):.1%} of them, {seconds:.1f} s,"

    def describe(self, source: PoseSource) -> str:
        """One line: the source of the poses, the share and duration of scans that do not constrain them, the residual.

        Without odometry also the share of scans that possibly moving objects alone constrain.
        """
        outcomes = Counter(quality.outcome for quality in self.qualities if quality.fell_back)
        prior = "the recorded motion" if source == "refined" else "the motion before"
        text = f"{source}: scans of '{self.sensor}' matched"
        if outcomes:
            each = ", ".join(f"{name} {number}" for name, number in sorted(outcomes.items()))
            fell_back = self._share_and_time([quality.fell_back for quality in self.qualities])
            text += f"; {fell_back} use {prior} instead of the match or a part of it ({each})"
        if source == "kiss-icp" and any(self.by_objects) and not self.stands:
            text += f"; {self._share_and_time(self.by_objects)} have a direction that only surfaces of less than"
            text += f" {OBJECT_M:g} m constrain: if these move together, such as a queue of cars, the pose is wrong"
        residuals = [q.residual_m for q in self.qualities if not q.failed and q.outcome != "start"]
        if residuals:
            text += f"; median residual {np.median(residuals):.3f} m"
        return text + ("; the sensor is at rest" if self.stands else "")


def matched_trajectory(scans: Iterable[Scan], source: PoseSource) -> MatchedTrajectory:
    """The trajectory of the first sensor of `scans`. Raises RecordingError if kiss-icp is not installed."""
    odometry = ScanOdometry(odometry=source == "refined")
    trajectory: MatchedTrajectory | None = None
    for scan in scans:
        trajectory = trajectory or MatchedTrajectory(scan.sensor)
        if scan.sensor == trajectory.sensor:
            trajectory.add(scan, odometry.match(scan))
    if trajectory is None:
        return MatchedTrajectory("")
    trajectory.finish()
    return trajectory


def with_matched_poses(
    scans: Iterable[Scan], trajectory: MatchedTrajectory, *, has_people: bool = False
) -> Iterator[Scan]:
    """`scans` with the poses of `trajectory`, estimated from the same scans.

    Other sensors keep their recorded pose relative to the matched sensor, interpolated at their stamps. If the true
    scene is known, or the recording `has_people`, the recorded pose becomes the reference pose: they are in its world
    frame.
    """
    recorded, matched = (
        InterpolatedPoses(trajectory.stamps_ns, poses) for poses in (trajectory.recorded, trajectory.matched)
    )
    found = zip(trajectory.matched, trajectory.qualities, strict=True)
    for scan in scans:
        known = has_people or scan.scene is not None
        reference = scan.reference_T_sensor or (scan.world_T_sensor if known else None)
        if scan.sensor == trajectory.sensor:
            pose, quality = next(found)
            yield replace(scan, world_T_sensor=pose, reference_T_sensor=reference, pose_quality=quality)
        else:
            mounted = recorded.at(scan.stamp_ns).inverse() @ scan.world_T_sensor
            pose = matched.at(scan.stamp_ns) @ mounted
            yield replace(scan, world_T_sensor=pose, reference_T_sensor=reference)


def _columns(poses: list[SE2]) -> np.typing.NDArray[np.float64]:
    """x, y and heading (3, n)."""
    return np.array([(pose.x, pose.y, pose.theta) for pose in poses]).T

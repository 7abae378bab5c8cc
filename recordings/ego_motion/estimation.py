"""The poses of a whole recording from its scans: one sensor is matched, the others are mounted on it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from gridtrack.common.geometry import SE2, wrap_angle
from gridtrack.common.pose_quality import PoseQuality
from gridtrack.common.scan import Scan
from gridtrack.recordings.ego_motion.following import Follower
from gridtrack.recordings.ego_motion.matching import ScanMatch
from gridtrack.recordings.ego_motion.moving_returns import OBJECT_M
from gridtrack.recordings.ego_motion.settings import MatchingSettings

PoseSource = Literal["recorded", "kiss-icp", "refined"]
"""As they are recorded; from matching scans alone; from matching scans with the recorded motion as its prior."""
STANDING_M, STANDING_RAD = 0.05, 0.02
"""A sensor whose matched poses stay this near to one another stands: what is left is the noise of matching."""


@dataclass
class MatchedTrajectory:
    """The scans of one sensor: their stamps, recorded and matched poses, and the quality of the matches.

    `by_objects` are the scans in which clusters of an object's size alone constrain a direction.
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
        """Where the sensor stands, its matched poses become its first one, exactly."""
        x, y, theta = _columns(self.matched)
        turn = np.abs(wrap_angle(theta - theta[0]))
        still = not any(pose != self.recorded[0] for pose in self.recorded)
        self.stands = still and max(np.ptp(x), np.ptp(y)) < STANDING_M and float(turn.max()) < STANDING_RAD
        if self.stands:
            self.matched = [self.recorded[0]] * len(self.matched)

    def _share_and_time(self, chosen: Sequence[bool]) -> str:
        """The share of the scans that are `chosen` (N,), and the time before them."""
        seconds = float(np.diff(self.stamps_ns)[np.array(chosen[1:], np.bool_)].sum() / 1e9)
        return f"{sum(chosen) / len(chosen):.1%} of them, {seconds:.1f} s,"

    def describe(self, source: PoseSource) -> str:
        """One line: where the poses come from, how many scans do not constrain them and for how long, the residual.

        Without odometry also how many are constrained by what may move alone.
        """
        outcomes = Counter(quality.outcome for quality in self.qualities if quality.fell_back)
        prior = "the recorded motion" if source == "refined" else "the motion before"
        text = f"{source}: scans of '{self.sensor}' matched"
        if outcomes:
            each = ", ".join(f"{name} {number}" for name, number in sorted(outcomes.items()))
            fell_back = self._share_and_time([quality.fell_back for quality in self.qualities])
            text += f"; {fell_back} have {prior} in place of the match or of a part ({each})"
        if source == "kiss-icp" and any(self.by_objects) and not self.stands:
            text += f"; {self._share_and_time(self.by_objects)} have a direction in which only surfaces of less than"
            text += (
                f" {OBJECT_M:g} m tell the motion: if these move together, such as a queue of cars, the pose is wrong"
            )
        residuals = [q.residual_m for q in self.qualities if not q.failed and q.outcome != "start"]
        if residuals:
            text += f"; median residual {np.median(residuals):.3f} m"
        return text + ("; the sensor stands still" if self.stands else "")


def matched_trajectory(scans: Iterable[Scan], source: PoseSource, settings: MatchingSettings) -> MatchedTrajectory:
    """The trajectory of the first sensor of `scans`. Raises RecordingError where kiss-icp is not installed."""
    follower = Follower(settings, odometry=source == "refined")
    trajectory: MatchedTrajectory | None = None
    for scan in scans:
        trajectory = trajectory or MatchedTrajectory(scan.sensor)
        if scan.sensor == trajectory.sensor:
            trajectory.add(scan, follower.follow(scan))
    if trajectory is None:
        return MatchedTrajectory("")
    trajectory.finish()
    return trajectory


def with_matched_poses(scans: Iterable[Scan], trajectory: MatchedTrajectory) -> Iterator[Scan]:
    """`scans` with the poses of `trajectory`, which is of the same scans.

    Another sensor keeps its recorded place on the one that was matched, whose pose is interpolated at its stamp. Where
    the true scene is known, the recorded pose becomes the reference pose: it is the world of the scene.
    """
    recorded, matched = _Interpolated(trajectory, trajectory.recorded), _Interpolated(trajectory, trajectory.matched)
    found = zip(trajectory.matched, trajectory.qualities, strict=True)
    for scan in scans:
        reference = scan.reference_T_sensor or (scan.world_T_sensor if scan.scene is not None else None)
        if scan.sensor == trajectory.sensor:
            pose, quality = next(found)
            yield replace(scan, world_T_sensor=pose, reference_T_sensor=reference, pose_quality=quality)
        else:
            mounted = recorded.at(scan.stamp_ns).inverse() @ scan.world_T_sensor
            pose = matched.at(scan.stamp_ns) @ mounted
            yield replace(scan, world_T_sensor=pose, reference_T_sensor=reference)


class _Interpolated:
    """Poses at any stamp: position and heading linear between two scans, constant outside."""

    def __init__(self, trajectory: MatchedTrajectory, poses: list[SE2]) -> None:
        self._stamps_ns = np.array(trajectory.stamps_ns, np.int64)
        self._x, self._y, theta = _columns(poses)
        self._theta = np.unwrap(theta)

    def at(self, stamp_ns: int) -> SE2:
        # relative to the nearest scan: seconds since 1970 as floats would be exact to a microsecond only
        since_s = (self._stamps_ns - stamp_ns) / 1e9
        x, y, theta = (float(np.interp(0.0, since_s, values)) for values in (self._x, self._y, self._theta))
        return SE2(x, y, wrap_angle(theta))


def _columns(poses: list[SE2]) -> np.typing.NDArray[np.float64]:
    """(3, n): x, y and heading."""
    return np.array([(pose.x, pose.y, pose.theta) for pose in poses]).T

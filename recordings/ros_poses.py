"""Poses in ROS recordings: the pose of each scan, interpolated between the poses before and after it."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

from gridtrack.common.errors import RecordingError
from gridtrack.common.geometry import SE2, wrap_angle
from gridtrack.common.scan import Scan
from gridtrack.recordings.recording import DamageError

POSES = (
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
)
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
STATIC_TRANSFORMS = "/tf_static"
MAX_GAP_NS = 1_000_000_000


def planar_pose(message: Any) -> SE2:
    """x, y and heading of a message of one of the types in POSES; height, roll and pitch are ignored.

    Raises DamageError where it holds no finite pose.
    """
    pose = message.pose.pose if hasattr(message.pose, "pose") else message.pose
    x, y, q = float(pose.position.x), float(pose.position.y), pose.orientation
    heading = math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))
    if not all(map(math.isfinite, (x, y, heading))):
        raise DamageError("corrupt: a pose that is not finite")
    return SE2(x, y, heading)


def unread_poses_warning(topic: str, kind: str) -> str | None:
    """The warning about a topic with poses or transforms that the options do not name; None for any other topic."""
    unread = f"on {topic} ({kind}) are not read, so the sensor is taken to stand still"
    if kind in POSES:
        return f"poses {unread}: import the recording with --pose-topic {topic} to read them"
    if kind in TRANSFORMS and topic != STATIC_TRANSFORMS:
        return f"transforms {unread}: record its pose as nav_msgs/Odometry or geometry_msgs/PoseStamped where it moves"
    return None


@dataclass(slots=True)
class _Span:
    """The first and the last stamp of a topic; `start_ns` is above `end_ns` where it has no messages."""

    start_ns: float = math.inf
    end_ns: float = -math.inf

    def add(self, stamp_ns: int) -> None:
        self.start_ns, self.end_ns = min(self.start_ns, stamp_ns), max(self.end_ns, stamp_ns)


class ScansOnPoses:
    """Delays scans until the pose after them is read, and interpolates the pose of each scan.

    A scan before the first pose has the first pose, one after the last pose the last. In a gap of the poses longer
    than a second scans have the last pose before the gap, and `warn` receives a line.
    """

    def __init__(self, topic: str, warn: Callable[[str], None]) -> None:
        self._topic, self._warn = topic, warn
        self._waiting: deque[Scan] = deque()
        self._last: tuple[int, SE2] | None = None
        self._scans, self._poses = _Span(), _Span()

    def scan(self, scan: Scan) -> Iterator[Scan]:
        """Add the next scan, and yield the scans that no longer wait. Raises RecordingError where `warn` does."""
        self._scans.add(scan.stamp_ns)
        self._waiting.append(scan)
        while scan.stamp_ns - self._waiting[0].stamp_ns > MAX_GAP_NS:
            self._warn(f"no poses on {self._topic} for more than 1 s: scans there have the last pose before it")
            yield self._with_last_pose(self._waiting.popleft())

    def pose(self, stamp_ns: int, pose: SE2) -> Iterator[Scan]:
        """Add the next pose, and yield the scans up to it."""
        self._poses.add(stamp_ns)
        before = self._last or (stamp_ns, pose)
        self._last = (stamp_ns, pose)
        while self._waiting and self._waiting[0].stamp_ns <= stamp_ns:
            scan = self._waiting.popleft()
            yield replace(scan, world_T_sensor=_interpolated(before, self._last, scan.stamp_ns))

    def flush(self) -> Iterator[Scan]:
        """Yield the scans after the last pose."""
        while self._waiting:
            yield self._with_last_pose(self._waiting.popleft())

    def check_clocks(self) -> None:
        """Raise RecordingError where all poses are stamped long before or after all scans."""
        before_ns = self._scans.start_ns - self._poses.end_ns
        after_ns = self._poses.start_ns - self._scans.end_ns
        if MAX_GAP_NS < max(before_ns, after_ns) < math.inf:
            apart = f"{before_ns / 1e9:.1f} s before" if before_ns > 0 else f"{after_ns / 1e9:.1f} s after"
            raise RecordingError(
                f"no pose on {self._topic} at the time of a scan: they are stamped {apart} the scans: record poses and"
                " scans with one clock"
            )

    def _with_last_pose(self, scan: Scan) -> Scan:
        return replace(scan, world_T_sensor=self._last[1]) if self._last else scan


def _interpolated(before: tuple[int, SE2], after: tuple[int, SE2], stamp_ns: int) -> SE2:
    """The pose at `stamp_ns`: position and heading interpolated linearly between two poses, constant outside."""
    (from_ns, one), (to_ns, other) = before, after
    if stamp_ns >= to_ns or to_ns <= from_ns:
        return other
    share = max(stamp_ns - from_ns, 0) / (to_ns - from_ns)
    turn = wrap_angle(other.theta - one.theta)
    return SE2(
        one.x + share * (other.x - one.x), one.y + share * (other.y - one.y), wrap_angle(one.theta + share * turn)
    )

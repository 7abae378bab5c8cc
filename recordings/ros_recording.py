"""The common part of the ROS formats: laser and point cloud topics as scans, with the poses of a topic."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from pathlib import Path

from gridtrack.common.errors import RecordingError, did_you_mean
from gridtrack.common.geometry import SE2
from gridtrack.common.scan import Scan
from gridtrack.recordings.read_options import ReadOptions
from gridtrack.recordings.recording import Recording, Topics
from gridtrack.recordings.ros_messages import (
    LASER_SCAN,
    POINT_CLOUD,
    RosMessage,
    scan_of_cloud,
    scan_of_laser,
    stamp_ns,
)
from gridtrack.recordings.ros_poses import POSES, ScansOnPoses, planar_pose, unread_poses_warning

ROS_OPTIONS = ("topic", "cloud_slice", "pose_topic")


class RosRecording(Recording):
    """A recording of ROS messages.

    Every LaserScan topic is a sensor; a PointCloud2 topic is read where the options name it, with the slice to cut from
    it. The poses of all sensors are those of the pose topic; without one the sensors stand still. How a sensor is
    mounted is not known.
    """

    knows_mounting = False

    def __init__(self, path: Path, options: ReadOptions) -> None:
        """Raises RecordingError where rosbags is not installed."""
        from gridtrack.recordings.ros_decoding import RosDecoder

        super().__init__(path, options)
        self._decoder = RosDecoder()

    @abstractmethod
    def messages(self) -> Iterator[RosMessage]:
        """All messages in the order of the file. Raises DamageError where it is cut off or corrupt."""

    def topic_of(self, sensor: str) -> str:
        """The topic with the scans of `sensor`."""
        return f"/{sensor}"

    def read(self, topics: Topics) -> Iterator[Scan]:
        """The scans in the order of the file; counts the messages in `topics`. DamageError where it is damaged."""
        topic, pose_topic = self.options.topic, self.options.pose_topic
        scans_on_poses = None if pose_topic is None else ScansOnPoses(pose_topic, self.warn)
        for message in self.messages():
            if scans_on_poses is None and message.topic not in topics.types:
                self._warn_of_unread_poses(message)
            topics.add(message.topic, message.kind, message.kind in (LASER_SCAN, POINT_CLOUD))
            by_name = message.topic == topic and message.topic in topics.scans
            if by_name or (topic is None and message.kind == LASER_SCAN):
                scan = self._scan(message)
                yield from scans_on_poses.scan(scan) if scans_on_poses else (scan,)
            elif scans_on_poses and message.topic == pose_topic and message.kind in POSES:
                yield from scans_on_poses.pose(*self._pose(message))
        if scans_on_poses:
            yield from scans_on_poses.flush()
            self._require_poses(topics)
            scans_on_poses.check_clocks()

    def _warn_of_unread_poses(self, message: RosMessage) -> None:
        warning = unread_poses_warning(message.topic, message.kind)
        if warning is not None:
            self.notify(warning)

    def _require_poses(self, topics: Topics) -> None:
        """Raise RecordingError where the pose topic holds no poses."""
        pose_topic = self.options.pose_topic
        with_poses = [topic for topic, kind in topics.types.items() if kind in POSES]
        if pose_topic in topics.types and pose_topic not in with_poses:
            raise RecordingError(
                f"topic '{pose_topic}' is {topics.types[pose_topic]}, not poses; expected one of {', '.join(POSES)}:"
                f" topics with poses: {', '.join(with_poses) or 'none'}"
            )
        if pose_topic is not None and pose_topic not in with_poses:
            raise RecordingError(f"no topic '{pose_topic}' with poses; {did_you_mean(pose_topic, with_poses)}")

    def _pose(self, message: RosMessage) -> tuple[int, SE2]:
        """Stamp and pose."""
        with self._decoder.decoded(message) as decoded:
            return stamp_ns(decoded) or message.received_ns, planar_pose(decoded)

    def _scan(self, message: RosMessage) -> Scan:
        sensor = message.topic.strip("/") or "scan"
        with self._decoder.decoded(message) as decoded:
            if not stamp_ns(decoded):
                self.warn(f"topic '{message.topic}': no stamps in its headers, the time of reception is used")
            if message.kind == LASER_SCAN:
                return scan_of_laser(decoded, sensor, message.received_ns)
            if self.options.cloud_slice is None:
                raise RecordingError(f"'{message.topic}' is a point cloud: give the heights to cut it at")
            return scan_of_cloud(decoded, sensor, message.received_ns, self.options.cloud_slice)

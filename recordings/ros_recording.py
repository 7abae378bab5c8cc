"""The common part of the ROS formats: laser and point cloud topics as scans, transforms, and topics with poses."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from gridtrack.common.errors import RecordingError
from gridtrack.recordings.framed_recording import Content, EncodedMessage, FramedRecording
from gridtrack.recordings.frames.placing import FramedScan
from gridtrack.recordings.frames.transform import SE3
from gridtrack.recordings.frames.tree import StampedTransform
from gridtrack.recordings.read_options import ReadOptions
from gridtrack.recordings.ros_messages import (
    LASER_SCAN,
    POINT_CLOUD,
    POSES,
    TRANSFORMS,
    scan_of_cloud,
    scan_of_laser,
    stamp_ns,
    transform_of,
)

ROS_OPTIONS = ("topic", "cloud_slice", "pose_topic", "mounts")


class RosRecording(FramedRecording):
    """A recording of ROS messages.

    Every LaserScan topic is a sensor; a PointCloud2 topic is read where the options name it, with the slice to cut from
    it.
    """

    def __init__(self, path: Path, options: ReadOptions) -> None:
        """Raises RecordingError where rosbags is not installed."""
        from gridtrack.recordings.ros_decoding import RosDecoder

        super().__init__(path, options)
        self._decoder = RosDecoder()

    def content_of(self, message: EncodedMessage) -> Content | None:
        """What a message holds, from its topic and type."""
        if message.kind in (LASER_SCAN, POINT_CLOUD):
            return "scan"
        if message.kind in TRANSFORMS:
            return "transforms"
        return "pose" if message.kind in POSES else None

    def is_read(self, message: EncodedMessage) -> bool:
        """Whether the scans of a topic are read: point clouds only where the options name it."""
        return super().is_read(message) and (message.kind == LASER_SCAN or self.options.topic is not None)

    def frame_of(self, message: EncodedMessage) -> str:
        """The frame of a scan. Raises DamageError."""
        with self._decoder.decoded(message) as decoded:
            return str(decoded.header.frame_id)

    def transforms_of(self, message: EncodedMessage) -> Iterable[StampedTransform]:
        """The transforms of a message, or its pose; `child` is empty where it does not name one. DamageError."""
        with self._decoder.decoded(message) as decoded:
            if message.kind in TRANSFORMS:
                for t in decoded.transforms:
                    transform = transform_of(t.transform.translation, t.transform.rotation)
                    yield _stamped(message, t, t.child_frame_id, transform)
            else:
                pose = decoded.pose.pose if hasattr(decoded.pose, "pose") else decoded.pose
                transform = transform_of(pose.position, pose.orientation)
                yield _stamped(message, decoded, getattr(decoded, "child_frame_id", ""), transform)

    def scan_of(self, message: EncodedMessage) -> FramedScan:
        """A scan and its frame. Raises DamageError."""
        sensor = self.sensor_of(message.topic)
        with self._decoder.decoded(message) as decoded:
            if not stamp_ns(decoded):
                self.warn(f"topic '{message.topic}': no stamps in its headers, the time of reception is used")
            frame = str(decoded.header.frame_id)
            if message.kind == LASER_SCAN:
                return FramedScan(message.topic, frame, scan_of_laser(decoded, sensor, message.received_ns))
            if self.options.cloud_slice is None:
                raise RecordingError(f"'{message.topic}' is a point cloud: give the heights to cut it at")
            scan = scan_of_cloud(decoded, sensor, message.received_ns, self.options.cloud_slice)
            return FramedScan(message.topic, frame, scan)


def _stamped(message: EncodedMessage, decoded: Any, child: str, transform: SE3 | None) -> StampedTransform:
    """A transform with the stamp of its header, or of reception where the header has none."""
    return StampedTransform(stamp_ns(decoded) or message.received_ns, decoded.header.frame_id, child, transform)

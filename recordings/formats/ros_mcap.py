"""MCAP files with ROS or Foxglove messages, and ROS 2 bags that are folders of such files."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LaserScan_pb2 import LaserScan
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from google.protobuf.message import DecodeError

from gridtrack.common.errors import RecordingError
from gridtrack.common.scan import MAX_BEAMS, Scan
from gridtrack.recordings.file_reading import ZSTD_MAGIC, DamageError, unpacked
from gridtrack.recordings.formats.native import is_native
from gridtrack.recordings.framed_recording import Content, EncodedMessage, FramedRecording
from gridtrack.recordings.frames.trajectory import FramedScan
from gridtrack.recordings.frames.transform import SE3
from gridtrack.recordings.frames.tree import StampedTransform
from gridtrack.recordings.mcap_file import MCAP_MAGIC, McapFile
from gridtrack.recordings.native_messages import nanoseconds_of
from gridtrack.recordings.registry import RecordingFormat
from gridtrack.recordings.ros_recording import ROS_OPTIONS, RosRecording, ros2_name

MCAP_SUFFIXES = (".mcap", ".mcap.zstd")
FOXGLOVE = "foxglove."
FOXGLOVE_TYPES: dict[str, tuple[type[Any], Content]] = {
    "foxglove.LaserScan": (LaserScan, "scan"),
    "foxglove.FrameTransform": (FrameTransform, "transforms"),
    "foxglove.FrameTransforms": (FrameTransforms, "transforms"),
    "foxglove.PoseInFrame": (PoseInFrame, "pose"),
}
ZERO_ROTATION = "have a rotation of all zeros, the default of Protobuf: read as no rotation"
NOT_FINITE = SE3((math.nan, math.nan, math.nan))
"""The pose of a scan without valid numbers for it: StampOrder leaves the scan out."""


class RosMcap(RosRecording):
    """An MCAP file with ROS or Foxglove messages, or a folder of them as ROS 2 records it."""

    def messages(self) -> Iterator[EncodedMessage]:
        """All messages in the order of the file. Raises DamageError if it is cut off or corrupt."""
        for path in mcap_files(self.path) if self.path.is_dir() else [self.path]:
            with unpacked(path) as file:
                if path.suffix == ".zstd" and is_native(file, MCAP_MAGIC):
                    raise DamageError(f"{path.name}: a packed recording of gridtrack: unpack it with `zstd -d`")
                for schema, channel, received_ns, data in McapFile(file, self.growth).messages():
                    kind = ros2_name(schema.name)
                    yield EncodedMessage(channel.topic, kind, received_ns, channel.message_encoding, data)

    def content_of(self, message: EncodedMessage) -> Content | None:
        """The content of a message, from its topic and type."""
        if not _is_foxglove(message):
            return super().content_of(message)
        is_read = message.encoding == "protobuf" and message.kind in FOXGLOVE_TYPES
        return FOXGLOVE_TYPES[message.kind][1] if is_read else None

    def is_read(self, message: EncodedMessage) -> bool:
        """Whether the scans of a message's topic are read; point clouds only if the options name the topic."""
        return super().is_read(message) or (_is_foxglove(message) and FramedRecording.is_read(self, message))

    def frame_of(self, message: EncodedMessage) -> str:
        """The frame of a scan. Raises DamageError."""
        return str(_decoded(message).frame_id) if _is_foxglove(message) else super().frame_of(message)

    def transforms_of(self, message: EncodedMessage) -> Iterable[StampedTransform]:
        """The transforms of a message, or its pose; `child` is empty if the message does not name it. DamageError."""
        return foxglove_transforms(message, self.notify) if _is_foxglove(message) else super().transforms_of(message)

    def scan_of(self, message: EncodedMessage) -> FramedScan:
        """A scan and its frame. Raises DamageError."""
        if not _is_foxglove(message):
            return super().scan_of(message)
        longest = self._longest_ranges.get(message.topic, 0.0)
        if not longest:
            raise RecordingError(f"topic '{message.topic}': no range of its scans is finite and above 0")
        self.notify(
            f"topic '{message.topic}': its scans do not contain their range limits; the longest range, {longest:.2f} m,"
            " is used as the maximum"
        )
        return foxglove_scan(message, self.sensor_of(message.topic), longest, self.notify)

    @cached_property
    def _longest_ranges(self) -> dict[str, float]:
        """The longest finite range on each topic with foxglove.LaserScan, metres, from one pass over the file."""
        longest: dict[str, float] = {}
        try:
            for message in self.messages():
                if _is_foxglove(message) and self.content_of(message) == "scan":
                    ranges = _ranges(_decoded(message))
                    in_scan = float(np.max(ranges, where=np.isfinite(ranges), initial=0.0))
                    longest[message.topic] = max(longest.get(message.topic, 0.0), in_scan)
        except DamageError:  # reported when the scans are read
            pass
        return longest


def foxglove_transforms(message: EncodedMessage, note: Callable[[str], None]) -> Iterator[StampedTransform]:
    """The transforms of a message, or its pose, with an empty child. Raises DamageError."""
    decoded = _decoded(message)
    if isinstance(decoded, PoseInFrame):
        stamp_ns = nanoseconds_of(decoded.timestamp) or message.received_ns
        if _is_unset(decoded.pose.orientation):
            note(f"poses on {message.topic} {ZERO_ROTATION}")
        pose = _transform(decoded.pose.position, decoded.pose.orientation)
        yield StampedTransform(stamp_ns, decoded.frame_id, "", pose)
        return
    for t in decoded.transforms if isinstance(decoded, FrameTransforms) else (decoded,):
        stamp_ns = nanoseconds_of(t.timestamp) or message.received_ns
        if _is_unset(t.rotation):
            note(f"transforms on {message.topic} of frame '{t.child_frame_id}' {ZERO_ROTATION}")
        yield StampedTransform(stamp_ns, t.parent_frame_id, t.child_frame_id, _transform(t.translation, t.rotation))


def foxglove_scan(message: EncodedMessage, sensor: str, range_max: float, note: Callable[[str], None]) -> FramedScan:
    """A scan and its frame; `range_max` is the sensor's, as the message has no range limits. Raises DamageError."""
    decoded = _decoded(message)
    ranges = _ranges(decoded)
    scan = Scan(
        stamp_ns=nanoseconds_of(decoded.timestamp) or message.received_ns,
        ranges=ranges,
        angle_min=decoded.start_angle,
        angle_increment=(decoded.end_angle - decoded.start_angle) / max(ranges.size - 1, 1),
        range_min=0.0,
        range_max=range_max,
        sensor=sensor,
    )
    return FramedScan(message.topic, decoded.frame_id, scan, _laser_pose(decoded.pose, message.topic, note))


def _laser_pose(pose: Any, topic: str, note: Callable[[str], None]) -> SE3 | None:
    """The pose of a laser in the frame of its scan; None if the message has none, or an empty one."""
    if not pose.ByteSize():
        return None
    if _is_unset(pose.orientation):
        note(f"poses of the laser in the scans on {topic} {ZERO_ROTATION}")
    return _transform(pose.position, pose.orientation) or NOT_FINITE


def _ranges(scan: LaserScan) -> np.ndarray[Any, np.dtype[np.float32]]:
    if len(scan.ranges) > MAX_BEAMS:
        raise DamageError(f"corrupt: a scan of {len(scan.ranges)} beams; at most {MAX_BEAMS}")
    return np.fromiter(scan.ranges, np.float64, len(scan.ranges)).astype(np.float32)


def _transform(translation: Any, rotation: Any) -> SE3 | None:
    w = 1.0 if _is_unset(rotation) else rotation.w
    return SE3.of((translation.x, translation.y, translation.z), (rotation.x, rotation.y, rotation.z, w))


def _is_unset(rotation: Any) -> bool:
    return not (rotation.w or rotation.z or rotation.x or rotation.y)


def _is_foxglove(message: EncodedMessage) -> bool:
    return message.kind.startswith(FOXGLOVE)


def _decoded(message: EncodedMessage) -> Any:
    decoded = FOXGLOVE_TYPES[message.kind][0]()
    try:
        decoded.ParseFromString(message.data)
    except DecodeError:
        raise DamageError(f"corrupt: a message of {message.topic} is not a {message.kind}") from None
    return decoded


def mcap_files(folder: Path) -> list[Path]:
    """The MCAP files of a folder in the order in which they were written: bag_2 before bag_10."""

    def number(file: Path) -> tuple[int, str]:
        digits = re.search(r"(\d+)\.mcap", file.name)
        return (int(digits[1]) if digits else 0, file.name)

    return sorted((file for file in folder.iterdir() if file.name.endswith(MCAP_SUFFIXES)), key=number)


def is_ros_mcap(path: Path, head: bytes) -> bool:
    """Whether the path is a folder with MCAP files, or an MCAP file that is not a native recording."""
    if path.is_dir():
        return bool(mcap_files(path))
    is_packed = path.name.endswith(MCAP_SUFFIXES[1]) and head.startswith(ZSTD_MAGIC)
    return is_packed or (head.startswith(MCAP_MAGIC) and not is_native(path, head))


ROS_MCAP_FORMAT = RecordingFormat(
    "ROS or Foxglove MCAP", MCAP_SUFFIXES, is_ros_mcap, RosMcap, ROS_OPTIONS, can_grow=True
)

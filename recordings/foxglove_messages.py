"""Foxglove messages as scans and transforms: LaserScan, FrameTransform, FrameTransforms and PoseInFrame, in Protobuf.

Schemas: https://docs.foxglove.dev/docs/visualization/message-schemas. A quaternion of all zeros, the default of
Protobuf, is that of a rotation that was not set: what has it is not turned. `tell` receives a line about it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LaserScan_pb2 import LaserScan
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from google.protobuf.message import DecodeError

from gridtrack.common.scan import MAX_BEAMS, Scan
from gridtrack.recordings.framed_recording import Content, EncodedMessage
from gridtrack.recordings.frames.placing import FramedScan
from gridtrack.recordings.frames.transform import SE3
from gridtrack.recordings.frames.tree import StampedTransform
from gridtrack.recordings.protobuf_time import nanoseconds_of
from gridtrack.recordings.recording import DamageError

FOXGLOVE = "foxglove."
NOT_TURNED = "have a rotation of all zeros, as Protobuf has where none is set: taken as not turned"
NOWHERE = SE3((math.nan, math.nan, math.nan))
"""The place of a scan whose message has no numbers for it: StampOrder leaves the scan out."""
_TYPES: dict[str, tuple[type[Any], Content]] = {
    "foxglove.LaserScan": (LaserScan, "scan"),
    "foxglove.FrameTransform": (FrameTransform, "transforms"),
    "foxglove.FrameTransforms": (FrameTransforms, "transforms"),
    "foxglove.PoseInFrame": (PoseInFrame, "pose"),
}


def foxglove_content(message: EncodedMessage) -> Content | None:
    """What a message holds; None for a type that is not read."""
    return _TYPES[message.kind][1] if message.kind in _TYPES else None


def foxglove_frame(message: EncodedMessage) -> str:
    """The frame of a scan. Raises DamageError."""
    return str(_decoded_foxglove(message).frame_id)


def foxglove_transforms(message: EncodedMessage, tell: Callable[[str], None]) -> Iterator[StampedTransform]:
    """The transforms of a message, or its pose, whose child has no name. Raises DamageError."""
    decoded = _decoded_foxglove(message)
    if isinstance(decoded, PoseInFrame):
        stamp_ns = nanoseconds_of(decoded.timestamp) or message.received_ns
        if _is_unset(decoded.pose.orientation):
            tell(f"poses on {message.topic} {NOT_TURNED}")
        pose = _transform(decoded.pose.position, decoded.pose.orientation)
        yield StampedTransform(stamp_ns, decoded.frame_id, "", pose)
        return
    for t in decoded.transforms if isinstance(decoded, FrameTransforms) else (decoded,):
        stamp_ns = nanoseconds_of(t.timestamp) or message.received_ns
        if _is_unset(t.rotation):
            tell(f"transforms on {message.topic} of frame '{t.child_frame_id}' {NOT_TURNED}")
        yield StampedTransform(stamp_ns, t.parent_frame_id, t.child_frame_id, _transform(t.translation, t.rotation))


def longest_range_of(message: EncodedMessage) -> float:
    """The longest finite range of a scan, metres; 0 without any. Raises DamageError."""
    ranges = _ranges(_decoded_foxglove(message))
    return float(np.max(ranges, where=np.isfinite(ranges), initial=0.0))


def foxglove_scan(message: EncodedMessage, sensor: str, range_max: float, tell: Callable[[str], None]) -> FramedScan:
    """A scan and its frame. The message has no limits of its ranges: `range_max` is that of the sensor. DamageError."""
    decoded = _decoded_foxglove(message)
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
    return FramedScan(message.topic, decoded.frame_id, scan, _mounted(decoded.pose, message.topic, tell))


def _ranges(scan: LaserScan) -> np.ndarray[Any, np.dtype[np.float32]]:
    if len(scan.ranges) > MAX_BEAMS:
        raise DamageError(f"corrupt: a scan of {len(scan.ranges)} beams; at most {MAX_BEAMS}")
    return np.fromiter(scan.ranges, np.float64, len(scan.ranges)).astype(np.float32)


def _mounted(pose: Any, topic: str, tell: Callable[[str], None]) -> SE3 | None:
    """The place of a laser in the frame of its scan; None where its message has none, or an empty one."""
    if not pose.ByteSize():
        return None
    if _is_unset(pose.orientation):
        tell(f"poses of the laser in the scans on {topic} {NOT_TURNED}")
    return _transform(pose.position, pose.orientation) or NOWHERE


def _is_unset(rotation: Any) -> bool:
    return not (rotation.w or rotation.z or rotation.x or rotation.y)


def _transform(translation: Any, rotation: Any) -> SE3 | None:
    w = 1.0 if _is_unset(rotation) else rotation.w
    return SE3.of((translation.x, translation.y, translation.z), (rotation.x, rotation.y, rotation.z, w))


def _decoded_foxglove(message: EncodedMessage) -> Any:
    decoded = _TYPES[message.kind][0]()
    try:
        decoded.ParseFromString(message.data)
    except DecodeError:
        raise DamageError(f"corrupt: a message of {message.topic} is not a {message.kind}") from None
    return decoded

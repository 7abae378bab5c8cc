"""The native recording: an MCAP file of Foxglove messages, which the Foxglove viewer opens directly.

`/scan` or `/scan/SENSOR` (foxglove.LaserScan; the channel's metadata carry the range limits), `/pose`
(foxglove.FrameTransform, world_T_sensor, written where it changes), `/reference_pose` or `/reference_pose/SENSOR`
(foxglove.PoseInFrame, reference_T_sensor where a scan has it, written where it changes), `/labels` or `/labels/SENSOR`
(the labelled scan once more, with the index of each beam's class as its intensity; 255: unlabelled), `/outlines` and
`/objects` (the true scene, where it is known; see scene_messages.py), `/beam_times` and `/pose_quality` (see
json_messages.py). The metadata record `gridtrack` holds the RecordingInfo.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TypeVar

import numpy as np
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.LaserScan_pb2 import LaserScan
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from gridtrack.common.config import validated
from gridtrack.common.errors import RecordingError, one_line
from gridtrack.common.geometry import SE2
from gridtrack.common.scan import PoseQuality, Scan
from gridtrack.common.scene import Scene
from gridtrack.common.untrusted import parse_json
from gridtrack.recordings.file_reading import Growth
from gridtrack.recordings.mcap_file import MCAP_MAGIC, McapFile, McapMessage
from gridtrack.recordings.native_messages import (
    BEAM_TIMES,
    METADATA_NAME,
    NATIVE_SCHEMA,
    OBJECTS,
    OUTLINES,
    POSE_QUALITY,
    REFERENCE_POSE,
    WARNINGS_NAME,
    SceneReader,
    is_topic,
    nanoseconds_of,
    read_beam_times,
    read_pose_quality,
    topic_name,
)
from gridtrack.recordings.recording import DamageError, Recording, Topics
from gridtrack.recordings.recording_info import RecordingInfo
from gridtrack.recordings.registry import RecordingFormat

MAX_SOURCE_WARNINGS, MAX_WARNING_CHARS = 100, 1000
OF_SOURCE = "the source had: "

Decoded = TypeVar("Decoded", LaserScan, FrameTransform, PoseInFrame)


class NativeRecording(Recording):
    """A recording written by gridtrack."""

    @cached_property
    def info(self) -> RecordingInfo:
        """The metadata of the recording. Raises RecordingError where they are missing or cannot be read."""
        file = McapFile(self.path, Growth() if self.growth else None)
        with contextlib.suppress(DamageError):  # reported when the scans are read
            next(file.messages(), None)
        found = file.metadata.get(METADATA_NAME)
        if found is None:
            raise RecordingError(
                f"{self.path}: not a recording of gridtrack: import it with `gridtrack recording import`"
            )
        if found.get("schema") != NATIVE_SCHEMA:
            raise RecordingError(
                f"{self.path}: schema {found.get('schema')}; this gridtrack reads {NATIVE_SCHEMA}: import again"
            )
        return _read_info(found.get("info", ""), f"{self.path}: its metadata")

    def read(self, topics: Topics) -> Iterator[Scan]:
        """The scans in the order of the file; counts the messages in `topics`. DamageError where it is damaged."""
        poses: dict[str, SE2] = {}
        references: dict[str, SE2] = {}
        labels: dict[str, LaserScan] = {}
        beam_times: dict[str, float] = {}
        qualities: dict[str, PoseQuality] = {}
        truth: SceneReader | None = None
        file = McapFile(self.path, self.growth)
        for message in file.messages():
            topic = message.channel.topic
            is_scan = is_topic(topic, "/scan")
            topics.add(topic, message.schema.name, is_scan)
            if topic == "/pose":
                transform = _decoded(FrameTransform(), message)
                poses[transform.child_frame_id] = _pose(transform.translation, transform.rotation)
            elif is_topic(topic, REFERENCE_POSE):
                placed = _decoded(PoseInFrame(), message).pose
                references[topic] = _pose(placed.position, placed.orientation)
            elif is_topic(topic, "/labels"):
                labelled = _decoded(LaserScan(), message)
                labels[labelled.frame_id] = labelled
            elif is_topic(topic, BEAM_TIMES):
                beam_times[topic] = read_beam_times(message.data)
            elif is_topic(topic, POSE_QUALITY):
                qualities[topic] = read_pose_quality(message.data)
            elif topic in (OUTLINES, OBJECTS):
                truth = truth or SceneReader(self.info.classes)
                truth.add(topic, message.data)
            elif is_scan and self.options.topic in (None, topic):
                scan = _decoded(LaserScan(), message)
                scene = truth.scene_at(nanoseconds_of(scan.timestamp)) if truth is not None else None
                pose = poses.get(scan.frame_id, SE2())
                found = _scan(scan, message, pose, labels.pop(scan.frame_id, None), scene)
                yield replace(
                    found,
                    reference_T_sensor=references.get(topic_name(REFERENCE_POSE, scan.frame_id)),
                    time_increment_s=beam_times.get(topic_name(BEAM_TIMES, scan.frame_id), 0.0),
                    pose_quality=qualities.pop(topic_name(POSE_QUALITY, scan.frame_id), None),
                )
        self._report_source(file.metadata.get(WARNINGS_NAME, {}))

    def topic_of(self, sensor: str) -> str:
        """The topic with the scans of `sensor`."""
        return topic_name("/scan", sensor)

    def _report_source(self, warnings: dict[str, str]) -> None:
        """Add the warnings that the import gave."""
        for number in sorted(warnings, key=lambda text: (len(text), text))[:MAX_SOURCE_WARNINGS]:
            text = one_line(warnings[number], MAX_WARNING_CHARS).removeprefix(OF_SOURCE)
            self.notify(f"{OF_SOURCE}{text}")


def is_native(path: Path, head: bytes) -> bool:
    """Whether it is an MCAP file with the metadata of gridtrack, or without a message that can be read."""
    if not head.startswith(MCAP_MAGIC):
        return False
    file = McapFile(path)
    try:
        first = next(file.messages(), None)
    except DamageError:
        first = None
    return METADATA_NAME in file.metadata or (first is None and not file.channels)


NATIVE_FORMAT = RecordingFormat("native MCAP", (".mcap",), is_native, NativeRecording, can_grow=True)


def _read_info(text: str, where: str) -> RecordingInfo:
    try:
        values = parse_json(text.encode())
    except ValueError as error:
        raise RecordingError(f"{where} cannot be read ({str(error)[:80]})") from None
    return validated(RecordingInfo, values, where)


def _decoded(message: Decoded, received: McapMessage) -> Decoded:
    try:
        message.ParseFromString(received.data)
    except DecodeError:
        raise DamageError(f"corrupt: a message of {received.channel.topic} is not a {received.schema.name}") from None
    return message


def _pose(position: Vector3, orientation: Quaternion) -> SE2:
    return SE2(position.x, position.y, 2.0 * math.atan2(orientation.z, orientation.w))


def _scan(
    message: LaserScan, received: McapMessage, world_T_sensor: SE2, labels: LaserScan | None, scene: Scene | None
) -> Scan:
    beams = len(message.ranges)
    if labels is not None and len(labels.intensities) != beams:
        raise DamageError(f"corrupt: labels of {len(labels.intensities)} beams for a scan of {beams}")
    range_min, range_max = _range_limits(received)
    with np.errstate(over="ignore"):  # of a range beyond float32, which is then no return
        ranges = np.fromiter(message.ranges, np.float64, beams).astype(np.float32)
    return Scan(
        stamp_ns=nanoseconds_of(message.timestamp),
        ranges=ranges,
        angle_min=message.start_angle,
        angle_increment=(message.end_angle - message.start_angle) / max(beams - 1, 1),
        range_min=range_min,
        range_max=range_max,
        sensor=message.frame_id,
        world_T_sensor=world_T_sensor,
        labels=None if labels is None else _class_numbers(labels),
        scene=scene,
    )


def _class_numbers(labels: LaserScan) -> NDArray[np.uint8]:
    values = np.fromiter(labels.intensities, np.float64, len(labels.intensities))
    numbers = np.nan_to_num(values).clip(0, 255).astype(np.uint8)
    no_class = numbers != values
    if no_class.any():
        raise DamageError(f"corrupt: a label {values[no_class][0]:g}, which is no number of a class")
    return numbers


def _range_limits(received: McapMessage) -> tuple[float, float]:
    """range_min and range_max, metres: foxglove.LaserScan has no fields for them."""
    channel = received.channel
    try:
        return float(channel.metadata["range_min"]), float(channel.metadata["range_max"])
    except (KeyError, ValueError):
        raise RecordingError(f"{channel.topic}: its channel does not name range_min and range_max in metres") from None

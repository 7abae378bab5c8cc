"""The native recording: an MCAP file of Foxglove messages, which the Foxglove viewer opens directly.

`/scan` or `/scan/SENSOR` (foxglove.LaserScan; the channel's metadata have the range limits), `/pose`
(foxglove.FrameTransform, world_T_sensor, written where it changes), `/reference_pose` or `/reference_pose/SENSOR`
(foxglove.PoseInFrame, reference_T_sensor of scans that have it, written where it changes), `/labels` or
`/labels/SENSOR` (the labelled scan once more, with the index of each beam's class as its intensity; 255: unlabelled),
and the messages in native_messages.py and people_messages.py. The metadata record `gridtrack` has the RecordingInfo.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import BinaryIO, TypeVar

import numpy as np
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.LaserScan_pb2 import LaserScan
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.message import DecodeError
from mcap.writer import Writer
from mcap_protobuf.schema import register_schema
from numpy.typing import NDArray

from gridtrack.common.config import validated
from gridtrack.common.errors import RecordingError, one_line
from gridtrack.common.geometry import SE2
from gridtrack.common.scan import PoseQuality, Scan
from gridtrack.common.scene import Person, Scene
from gridtrack.common.untrusted import parse_json
from gridtrack.recordings.file_reading import DamageError, Growth
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
    WORLD,
    SceneReader,
    SceneWriter,
    beam_times_message,
    is_topic,
    json_schema,
    nanoseconds_of,
    planar_pose,
    pose_quality_message,
    read_beam_times,
    read_pose_quality,
    set_pose,
    timestamp_of,
    topic_name,
)
from gridtrack.recordings.people_messages import PEOPLE, people_message, read_people_message
from gridtrack.recordings.recording import Recording, Topics
from gridtrack.recordings.recording_info import RecordingInfo
from gridtrack.recordings.registry import RecordingFormat

MAX_SOURCE_WARNINGS, MAX_WARNING_CHARS = 100, 1000
OF_SOURCE = "the source had: "
CHUNK_BYTES = 128 * 1024
MAX_CHANNELS = 1024

Decoded = TypeVar("Decoded", LaserScan, FrameTransform, PoseInFrame)


class NativeRecording(Recording):
    """A recording written by gridtrack."""

    @cached_property
    def info(self) -> RecordingInfo:
        """The metadata of the recording. Raises RecordingError if they are missing or cannot be read."""
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
        """As in every recording."""
        poses: dict[str, SE2] = {}
        references: dict[str, SE2] = {}
        labels: dict[str, LaserScan] = {}
        beam_times: dict[str, float] = {}
        qualities: dict[str, PoseQuality] = {}
        truth: SceneReader | None = None
        people: tuple[int, tuple[Person, ...] | None] = (-1, None)
        file = McapFile(self.path, self.growth)
        for message in file.messages():
            topic = message.channel.topic
            is_scan = is_topic(topic, "/scan")
            topics.add(topic, message.schema.name, is_scan)
            if topic == "/pose":
                transform = _decoded(FrameTransform(), message)
                poses[transform.child_frame_id] = planar_pose(transform.translation, transform.rotation)
            elif is_topic(topic, REFERENCE_POSE):
                placed = _decoded(PoseInFrame(), message).pose
                references[topic] = planar_pose(placed.position, placed.orientation)
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
            elif topic == PEOPLE:
                people = read_people_message(message.data)
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
                    people=people[1] if people[0] == found.stamp_ns else None,
                )
        self._report_source(file.metadata.get(WARNINGS_NAME, {}))

    def topic_of(self, sensor: str) -> str:
        """The topic with the scans of `sensor`."""
        return topic_name("/scan", sensor)

    def _report_source(self, warnings: dict[str, str]) -> None:
        """Repeat the warnings of the import."""
        for number in sorted(warnings, key=lambda text: (len(text), text))[:MAX_SOURCE_WARNINGS]:
            text = one_line(warnings[number], MAX_WARNING_CHARS).removeprefix(OF_SOURCE)
            self.notify(f"{OF_SOURCE}{text}")


def is_native(path: Path, head: bytes) -> bool:
    """Whether it is an MCAP file with the metadata of gridtrack, or without any readable message."""
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


def _scan(
    message: LaserScan, received: McapMessage, world_T_sensor: SE2, labels: LaserScan | None, scene: Scene | None
) -> Scan:
    beams = len(message.ranges)
    if labels is not None and len(labels.intensities) != beams:
        raise DamageError(f"corrupt: labels of {len(labels.intensities)} beams for a scan of {beams}")
    range_min, range_max = _range_limits(received)
    with np.errstate(over="ignore"):  # a range beyond float32 becomes infinite: no return
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
        raise DamageError(f"corrupt: a label {values[no_class][0]:g} is not the number of a class")
    return numbers


def _range_limits(received: McapMessage) -> tuple[float, float]:
    """range_min and range_max, metres: foxglove.LaserScan has no fields for them."""
    channel = received.channel
    try:
        return float(channel.metadata["range_min"]), float(channel.metadata["range_max"])
    except (KeyError, ValueError):
        raise RecordingError(f"{channel.topic}: its channel does not name range_min and range_max in metres") from None


def write_native(
    file: BinaryIO, info: RecordingInfo, scans: Iterable[Scan], warnings: Callable[[], Sequence[str]] = tuple
) -> None:
    """Write `scans` in this order, and then their `warnings`; same input, same bytes. Raises RecordingError."""
    writer = _NativeWriter(file, info)
    for scan in scans:
        writer.write(scan)
    writer.finish(warnings())


class _NativeWriter:
    def __init__(self, file: BinaryIO, info: RecordingInfo) -> None:
        self._mcap = Writer(file, chunk_size=CHUNK_BYTES, enable_data_crcs=True)
        self._mcap.start(library="gridtrack")
        self._mcap.add_metadata(METADATA_NAME, {"schema": NATIVE_SCHEMA, "info": info.model_dump_json()})
        self._schemas: dict[type, int] = {
            kind: register_schema(self._mcap, kind) for kind in (LaserScan, FrameTransform, SceneUpdate)
        }
        self._channels: dict[tuple[str, float, float], int] = {}
        self._poses: dict[str, SE2] = {}
        self._references: dict[str, SE2] = {}
        self._beam_times: dict[str, float] = {}
        self._json_channels: dict[str, int] = {}
        self._truth = SceneWriter(info.classes)
        self._written: tuple[int, Scene] | None = None
        self._people_ns = -1

    def write(self, scan: Scan) -> None:
        """Write the pose, truth and labels before their scan, so that a reader has them in time."""
        if self._poses.get(scan.sensor) != scan.world_T_sensor:
            self._poses[scan.sensor] = scan.world_T_sensor
            self._add("/pose", _transform_message(scan), scan.stamp_ns)
        if scan.reference_T_sensor is not None or scan.sensor in self._references:
            self._write_reference(scan, scan.reference_T_sensor or scan.world_T_sensor)
        if self._beam_times.get(scan.sensor, 0.0) != scan.time_increment_s:
            self._beam_times[scan.sensor] = scan.time_increment_s
            self._add_json(BEAM_TIMES, scan, beam_times_message(scan.stamp_ns, scan.time_increment_s))
        if scan.pose_quality is not None:
            self._add_json(POSE_QUALITY, scan, pose_quality_message(scan.stamp_ns, scan.pose_quality))
        if scan.scene is not None:
            self._write_truth(scan.scene, scan.stamp_ns)
        if scan.people is not None and scan.stamp_ns != self._people_ns:
            self._people_ns = scan.stamp_ns
            self._add(PEOPLE, people_message(scan.people, scan.stamp_ns), scan.stamp_ns)
        message = _scan_message(scan)
        if scan.labels is not None:
            labelled = LaserScan()
            labelled.CopyFrom(message)
            labelled.intensities.extend(scan.labels.astype(np.float64).tolist())
            self._add(topic_name("/labels", scan.sensor), labelled, scan.stamp_ns)
        self._add(topic_name("/scan", scan.sensor), message, scan.stamp_ns, (scan.range_min, scan.range_max))

    def _write_reference(self, scan: Scan, pose: SE2) -> None:
        """Write a PoseInFrame: viewers place the sensor by FrameTransform, and allow only one parent frame."""
        if self._references.get(scan.sensor) != pose:
            self._references[scan.sensor] = pose
            if PoseInFrame not in self._schemas:
                self._schemas[PoseInFrame] = register_schema(self._mcap, PoseInFrame)
            message = PoseInFrame(timestamp=timestamp_of(scan.stamp_ns), frame_id=WORLD)
            set_pose(message.pose.position, message.pose.orientation, pose)
            self._add(topic_name(REFERENCE_POSE, scan.sensor), message, scan.stamp_ns)

    def _write_truth(self, scene: Scene, stamp_ns: int) -> None:
        """Write a scene once for each stamp, even if several sensors have a scan then."""
        if self._written is not None and self._written[0] == stamp_ns and self._written[1] is scene:
            return
        self._written = (stamp_ns, scene)
        if (outlines := self._truth.outlines(scene, stamp_ns)) is not None:
            self._add(OUTLINES, outlines, stamp_ns)
        self._add(OBJECTS, self._truth.objects(scene, stamp_ns), stamp_ns)

    def finish(self, warnings: Sequence[str]) -> None:
        """Write the warnings and the end of the file."""
        if warnings:
            self._mcap.add_metadata(WARNINGS_NAME, {str(number): text for number, text in enumerate(warnings)})
        self._mcap.finish()  # type: ignore[no-untyped-call]

    def _add(
        self,
        topic: str,
        message: LaserScan | FrameTransform | PoseInFrame | SceneUpdate,
        stamp_ns: int,
        limits: tuple[float, float] | None = None,
    ) -> None:
        key = (topic, *(limits or (0.0, 0.0)))
        if key not in self._channels:
            if len(self._channels) == MAX_CHANNELS:
                raise RecordingError(
                    f"{topic}: the range limits change from scan to scan; expected the constant limits of the laser"
                )
            metadata = {"range_min": repr(limits[0]), "range_max": repr(limits[1])} if limits else {}
            schema = self._schemas[type(message)]
            self._channels[key] = self._mcap.register_channel(topic, "protobuf", schema, metadata)
        self._mcap.add_message(self._channels[key], stamp_ns, message.SerializeToString(deterministic=True), stamp_ns)

    def _add_json(self, kind: str, scan: Scan, message: bytes) -> None:
        topic = topic_name(kind, scan.sensor)
        if topic not in self._json_channels:
            name, schema = json_schema(kind)
            schema_id = self._mcap.register_schema(name, "jsonschema", schema)
            self._json_channels[topic] = self._mcap.register_channel(topic, "json", schema_id)
        self._mcap.add_message(self._json_channels[topic], scan.stamp_ns, message, scan.stamp_ns)


def _scan_message(scan: Scan) -> LaserScan:
    message = LaserScan(timestamp=timestamp_of(scan.stamp_ns), frame_id=scan.sensor, start_angle=scan.angle_min)
    message.end_angle = scan.angle_min + scan.angle_increment * max(scan.ranges.size - 1, 0)
    message.pose.orientation.w = 1.0
    with np.errstate(invalid="ignore"):  # a NaN of any bits stays a NaN
        message.ranges.extend(scan.ranges.astype(np.float64).tolist())
    return message


def _transform_message(scan: Scan) -> FrameTransform:
    message = FrameTransform(timestamp=timestamp_of(scan.stamp_ns), parent_frame_id=WORLD, child_frame_id=scan.sensor)
    set_pose(message.translation, message.rotation, scan.world_T_sensor)
    return message

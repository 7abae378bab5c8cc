"""Writing a native recording: an MCAP file of Foxglove messages; what it holds is listed in native.py."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import BinaryIO

import numpy as np
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.LaserScan_pb2 import LaserScan
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from mcap.writer import Writer
from mcap_protobuf.schema import register_schema

from gridtrack.common.errors import RecordingError
from gridtrack.common.geometry import SE2
from gridtrack.common.scan import Scan
from gridtrack.common.scene import Scene
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
    SceneWriter,
    beam_times_message,
    json_schema,
    pose_quality_message,
    timestamp_of,
    topic_name,
)
from gridtrack.recordings.recording_info import RecordingInfo

CHUNK_BYTES = 128 * 1024
MAX_CHANNELS = 1024


def write_native(
    file: BinaryIO, info: RecordingInfo, scans: Iterable[Scan], warnings: Callable[[], Sequence[str]] = tuple
) -> None:
    """Write `scans` in the order given, and then their `warnings`; same input, same bytes. Raises RecordingError."""
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

    def write(self, scan: Scan) -> None:
        """Pose, truth and labels first, so that a reader has them when it reads the scan."""
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
        message = _scan_message(scan)
        if scan.labels is not None:
            labelled = LaserScan()
            labelled.CopyFrom(message)
            labelled.intensities.extend(scan.labels.astype(np.float64).tolist())
            self._add(topic_name("/labels", scan.sensor), labelled, scan.stamp_ns)
        self._add(topic_name("/scan", scan.sensor), message, scan.stamp_ns, (scan.range_min, scan.range_max))

    def _write_reference(self, scan: Scan, pose: SE2) -> None:
        """A PoseInFrame, for a viewer places the sensor by FrameTransform, and it has one parent frame."""
        if self._references.get(scan.sensor) != pose:
            self._references[scan.sensor] = pose
            if PoseInFrame not in self._schemas:
                self._schemas[PoseInFrame] = register_schema(self._mcap, PoseInFrame)
            message = PoseInFrame(timestamp=timestamp_of(scan.stamp_ns), frame_id=WORLD)
            _set_pose(message.pose.position, message.pose.orientation, pose)
            self._add(topic_name(REFERENCE_POSE, scan.sensor), message, scan.stamp_ns)

    def _write_truth(self, scene: Scene, stamp_ns: int) -> None:
        """Once for each stamp, even where several sensors have a scan then."""
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
    with np.errstate(invalid="ignore"):  # a NaN of any bits stays one
        message.ranges.extend(scan.ranges.astype(np.float64).tolist())
    return message


def _transform_message(scan: Scan) -> FrameTransform:
    message = FrameTransform(timestamp=timestamp_of(scan.stamp_ns), parent_frame_id=WORLD, child_frame_id=scan.sensor)
    _set_pose(message.translation, message.rotation, scan.world_T_sensor)
    return message


def _set_pose(position: Vector3, orientation: Quaternion, pose: SE2) -> None:
    position.x, position.y = pose.x, pose.y
    orientation.z, orientation.w = math.sin(pose.theta / 2.0), math.cos(pose.theta / 2.0)

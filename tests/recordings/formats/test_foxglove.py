"""MCAP files with Foxglove messages of another program."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LaserScan_pb2 import LaserScan
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from mcap.writer import Writer
from mcap_protobuf.schema import register_schema

from gridtrack.common.errors import RecordingError
from gridtrack.common.geometry import SE2
from gridtrack.recordings import import_recording, open_recording
from gridtrack.recordings.frames.transform import SE3
from gridtrack.recordings.native_messages import timestamp_of

from scenes import drive_bag as made

LIMIT = "topic '/front': its scans do not contain their range limits; the longest range, "


def stamp(at_ms: float) -> Any:
    return timestamp_of(made.START_NS + round(at_ms * made.MS))


def placed(message: Any, translation: Any, rotation: Any, transform: SE3) -> Any:
    translation.x, translation.y, translation.z = transform.translation
    rotation.x, rotation.y, rotation.z, rotation.w = transform.rotation
    return message


def transform_message(at_ms: float, parent: str, child: str, transform: SE3) -> FrameTransform:
    message = FrameTransform(timestamp=stamp(at_ms), parent_frame_id=parent, child_frame_id=child)
    return placed(message, message.translation, message.rotation, transform)


def pose_message(at_ms: float) -> PoseInFrame:
    message = PoseInFrame(timestamp=stamp(at_ms), frame_id="world")
    return placed(message, message.pose.position, message.pose.orientation, SE3.in_plane(made.robot_at(at_ms)))


def scan_message(at_ms: float, laser: made.Laser, in_base: bool = False) -> LaserScan:
    """A scan in the frame of the laser, or in that of the robot with the pose of the laser."""
    end = laser.angle_min + laser.angle_increment * (laser.beams - 1)
    message = LaserScan(timestamp=stamp(at_ms), start_angle=laser.angle_min, end_angle=end)
    message.frame_id = "base_link" if in_base else "front_laser"
    message.ranges.extend(made.ranges_at(laser, made.robot_at(at_ms), (0.0, 3.0)).astype(float).tolist())
    if in_base:
        placed(message, message.pose.position, message.pose.orientation, SE3.in_plane(laser.base_T_laser))
    return message


@pytest.fixture
def mcap(tmp_path: Path) -> Callable[..., Path]:
    """`mcap(messages)` writes an MCAP file of (topic, time in ms, message)."""

    def mcap(messages: list[tuple[str, float, Any]], name: str = "foreign.mcap") -> Path:
        with (tmp_path / name).open("wb") as file:
            writer = Writer(file)
            writer.start()
            channels: dict[str, int] = {}
            for topic, at_ms, message in sorted(messages, key=lambda m: m[1]):
                if topic not in channels:
                    channels[topic] = writer.register_channel(topic, "protobuf", register_schema(writer, type(message)))
                at_ns = made.START_NS + round(at_ms * made.MS)
                writer.add_message(channels[topic], at_ns, message.SerializeToString(), at_ns)
            writer.finish()
        return tmp_path / name

    return mcap


STAMPS_MS = range(0, made.DURATION_MS, 100)


def test_a_drive_with_frame_transforms(mcap, tmp_path: Path) -> None:
    mount = transform_message(0, "base_link", "front_laser", SE3.in_plane(made.FRONT.base_T_laser))
    scans = [("/front", at, scan_message(at, made.FRONT)) for at in STAMPS_MS]
    moving = []
    for at in made.STAMPS_MS:
        odometry = transform_message(at, "odom", "base_link", SE3.in_plane(made.robot_at(at)))
        moving.append(("/tf", at, FrameTransforms(transforms=[odometry])))
    path = mcap([*scans, *moving, ("/mount", 5, mount)])
    recording = open_recording(path)
    assert made.walls_stay(recording.scans())
    (warning,) = recording.overview().warnings
    assert LIMIT in warning
    assert recording.info.poses == "odom -> base_link -> front_laser; from /tf, /mount; longest gap 0.04 s"
    imported = import_recording(path, tmp_path / "native.mcap")
    assert made.walls_stay(imported.scans())


def test_poses_in_a_frame_and_scans_with_the_pose_of_the_laser(mcap) -> None:
    scans = [("/front", at, scan_message(at, made.FRONT, in_base=True)) for at in STAMPS_MS]
    recording = open_recording(mcap([*scans, *(("/pose", at, pose_message(at)) for at in made.STAMPS_MS)]))
    assert made.walls_stay(recording.scans())
    assert recording.info.poses == "world -> base_link; from /pose; longest gap 0.04 s"


class Broken:
    """A message that cannot be decoded."""

    def SerializeToString(self) -> bytes:
        return b"\xff\xff"


def test_a_damaged_message_ends_the_recording_with_one_line(mcap) -> None:
    good = [("/front", at, scan_message(at, made.FRONT)) for at in range(0, 500, 100)]
    recording = open_recording(mcap([*good, ("/front", 500, Broken())]))
    assert len(list(recording.scans())) == 5
    assert any("a message of /front is not a foxglove.LaserScan" in line for line in recording.warnings)


def test_scans_without_a_finite_range_are_refused(mcap) -> None:
    message = scan_message(0, made.FRONT)
    message.ranges[:] = [math.inf] * len(message.ranges)
    with pytest.raises(RecordingError, match="no range of its scans is finite"):
        list(open_recording(mcap([("/front", 0, message)])).scans())


def test_angles_and_ranges_are_kept(mcap) -> None:
    (scan,) = open_recording(mcap([("/front", 0, scan_message(0, made.FRONT))])).scans()
    assert scan.angle_min == made.FRONT.angle_min
    assert scan.angle_increment == pytest.approx(made.FRONT.angle_increment)
    np.testing.assert_array_equal(scan.ranges, made.ranges_at(made.FRONT, made.robot_at(0), (0.0, 3.0)))
    assert scan.world_T_sensor == SE2()


def without_rotation(message: Any) -> Any:
    """The message without its rotation: Protobuf reads it as all zeros."""
    for part in ("rotation", "orientation"):
        if part in message.DESCRIPTOR.fields_by_name:
            message.ClearField(part)
    return message


ZEROS = "have a rotation of all zeros, the default of Protobuf: read as no rotation"


def test_a_mount_of_zero_rotation_is_read_as_no_rotation(mcap) -> None:
    place = SE3((0.3, 0.1, 0.0))
    mount = without_rotation(transform_message(0, "base_link", "front_laser", place))
    moving = [("/tf", at, transform_message(at, "odom", "base_link", SE3((at / 1e3, 0.0, 0.0)))) for at in (0, 500)]
    scans = [("/front", at, scan_message(at, made.FRONT)) for at in range(0, 500, 100)]
    recording = open_recording(mcap([("/mount", 0, mount), *moving, *scans]), strict=True)
    assert [scan.world_T_sensor.x for scan in recording.scans()] == pytest.approx([0.3, 0.4, 0.5, 0.6, 0.7])
    assert any(f"transforms on /mount of frame 'front_laser' {ZEROS}" in line for line in recording.warnings)


def test_poses_of_zero_rotation_are_read_as_no_rotation(mcap) -> None:
    poses = []
    for at in range(0, 600, 100):
        message = pose_message(at)
        without_rotation(message.pose)
        poses.append(("/pose", at, message))
    scans = [("/front", at, scan_message(at, made.FRONT, in_base=True)) for at in range(0, 500, 100)]
    recording = open_recording(mcap([*poses, *scans]), strict=True)
    for scan, at in zip(recording.scans(), range(0, 500, 100), strict=True):
        place = made.robot_at(at)
        expected = SE2(place.x, place.y) @ made.FRONT.base_T_laser
        assert (scan.world_T_sensor.x, scan.world_T_sensor.y) == pytest.approx((expected.x, expected.y))
    assert any(f"poses on /pose {ZEROS}" in line for line in recording.warnings)


@pytest.mark.parametrize("in_base", [True, False], ids=["a position alone", "an empty pose"])
def test_a_laser_pose_without_rotation_is_read_as_no_rotation_and_an_empty_one_as_none(mcap, in_base: bool) -> None:
    message = scan_message(0, made.FRONT, in_base)
    message.pose.SetInParent()
    without_rotation(message.pose)
    recording = open_recording(mcap([("/front", 0, message)]), strict=True)
    assert [scan.world_T_sensor for scan in recording.scans()] == [SE2(0.3, 0.1) if in_base else SE2()]
    reported = f"poses of the laser in the scans on /front {ZEROS}"
    assert any(reported in line for line in recording.warnings) == in_base


def test_a_scan_with_a_laser_pose_that_is_not_finite_is_left_out(mcap) -> None:
    messages = [scan_message(at, made.FRONT, in_base=True) for at in range(0, 500, 100)]
    messages[2].pose.position.x = math.nan
    recording = open_recording(mcap([("/front", 100 * k, message) for k, message in enumerate(messages)]))
    assert len(list(recording.scans())) == 4
    assert any(
        "scans of sensor 'front' with a pose that is not finite, left out: 1 of them" in w for w in recording.warnings
    )

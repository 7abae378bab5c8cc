"""Poses in ROS recordings: read where an option names their topic, else a warning."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from typer.testing import CliRunner

from gridtrack.cli import app
from gridtrack.common.errors import RecordingError
from gridtrack.common.geometry import SE2
from gridtrack.recordings import import_recording, open_recording
from gridtrack.recordings.stream import GridStream, open_stream

ROS1 = get_typestore(Stores.ROS1_NOETIC)
LASER, ODOMETRY, POSE = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped"
TF = "tf2_msgs/msg/TFMessage"
ROS1.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))
START_NS, MS = 10**12, 10**6

Messages = Iterable[tuple[str, str, int, Any]]


def make(kind: str, **fields: Any) -> Any:
    return ROS1.types[kind](**fields)


def header(at_ms: int) -> Any:
    stamp_ns = START_NS + at_ms * MS
    stamp = make("builtin_interfaces/msg/Time", sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    return make("std_msgs/msg/Header", seq=0, stamp=stamp, frame_id="odom")


def scan(at_ms: int) -> tuple[str, str, int, Any]:
    limits = {"angle_min": -1.0, "angle_max": 1.0, "angle_increment": 0.02, "time_increment": 0.0, "scan_time": 0.1}
    message = make(
        LASER, header=header(at_ms), **limits, range_min=0.1, range_max=8.0, ranges=np.full(101, 2.0, np.float32),
        intensities=np.empty(0, np.float32),
    )  # fmt: skip
    return ("/scan", LASER, START_NS + at_ms * MS, message)


def pose_of(pose: SE2) -> Any:
    position = make("geometry_msgs/msg/Point", x=pose.x, y=pose.y, z=0.3)
    turn = {"z": math.sin(pose.theta / 2), "w": math.cos(pose.theta / 2)}
    orientation = make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, **turn)
    return make("geometry_msgs/msg/Pose", position=position, orientation=orientation)


def odometry(at_ms: int, pose: SE2) -> tuple[str, str, int, Any]:
    zero = make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
    twist = make("geometry_msgs/msg/Twist", linear=zero, angular=zero)
    message = make(
        ODOMETRY,
        header=header(at_ms),
        child_frame_id="base",
        pose=make("geometry_msgs/msg/PoseWithCovariance", pose=pose_of(pose), covariance=np.zeros(36)),
        twist=make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
    )
    return ("/odom", ODOMETRY, START_NS + at_ms * MS, message)


def stamped(at_ms: int, pose: SE2) -> tuple[str, str, int, Any]:
    return ("/pose", POSE, START_NS + at_ms * MS, make(POSE, header=header(at_ms), pose=pose_of(pose)))


@pytest.fixture
def bag(tmp_path: Path):
    """`bag(messages)` writes a ROS 1 bag of them, in the order of their reception."""

    def bag(messages: Messages) -> Path:
        path = tmp_path / "drive.bag"
        with Writer(path) as writer:
            connections: dict[str, Any] = {}
            for topic, kind, received_ns, message in sorted(messages, key=lambda m: m[2]):
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=ROS1)
                writer.write(connections[topic], received_ns, ROS1.serialize_ros1(message, kind))
        return path

    return bag


def test_unread_poses_are_one_warning_with_the_remedy(bag) -> None:
    path = bag([scan(k * 100) for k in range(5)] + [odometry(k * 20, SE2(k * 0.1)) for k in range(20)])
    recording = open_recording(path)
    summary = recording.overview()
    assert summary.warnings == (
        f"{path}: poses on /odom (nav_msgs/msg/Odometry) are not read, so the sensor is taken to stand still: import"
        " the recording with --pose-topic /odom to read them",
    )
    assert not summary.sensors["scan"].moves


def test_unread_transforms_are_a_warning(bag) -> None:
    path = bag([scan(0), scan(100), ("/tf", TF, START_NS, make(TF, transforms=[]))])
    recording = open_recording(path)
    list(recording.scans())
    assert recording.warnings == [
        f"{path}: transforms on /tf (tf2_msgs/msg/TFMessage) are not read, so the sensor is taken to stand still:"
        " record its pose as nav_msgs/Odometry or geometry_msgs/PoseStamped where it moves"
    ]


@pytest.mark.parametrize("message", [odometry, stamped])
def test_the_pose_of_a_scan_is_interpolated(bag, message) -> None:
    path = bag(
        [scan(at) for at in (0, 50, 100, 125, 300)]
        + [message(40, SE2(1.0, 2.0, 0.0)), message(100, SE2(1.6, 2.0, 0.0)), message(200, SE2(1.6, 2.0, 1.0))]
    )
    topic = "/odom" if message is odometry else "/pose"
    recording = open_recording(path, pose_topic=topic)
    poses = [s.world_T_sensor for s in recording.scans()]
    # before the first pose the first, then at 1/6, 1, and 1/4 of the way, after the last the last
    expected = [(1.0, 2.0, 0.0), (1.1, 2.0, 0.0), (1.6, 2.0, 0.0), (1.6, 2.0, 0.25), (1.6, 2.0, 1.0)]
    np.testing.assert_allclose([(p.x, p.y, p.theta) for p in poses], expected, atol=1e-9)
    assert recording.warnings == []
    assert recording.overview().sensors["scan"].moves


def test_a_gap_in_the_poses_is_a_warning_and_delays_no_scans(bag) -> None:
    path = bag([scan(k * 100) for k in range(100)] + [odometry(0, SE2()), odometry(9000, SE2(9.0))])
    recording = open_recording(path, pose_topic="/odom")
    poses = [s.world_T_sensor.x for s in recording.scans()]
    assert len(poses) == 100
    assert poses[5] == 0.0
    assert poses[-1] == 9.0
    assert any("no poses on /odom for more than 1 s" in warning for warning in recording.warnings)
    with pytest.raises(RecordingError, match="no poses on /odom"):
        list(open_recording(path, pose_topic="/odom", strict=True).scans())


@pytest.mark.parametrize(
    ("topic", "message"),
    [
        ("/odmo", "no topic '/odmo' with poses; did you mean '/odom'"),
        ("/scan", r"topic '/scan' is sensor_msgs/msg/LaserScan, not poses; .* topics with poses: /odom"),
    ],
)
def test_a_topic_without_poses_is_refused(bag, topic, message) -> None:
    path = bag([scan(0), scan(100), odometry(0, SE2())])
    with pytest.raises(RecordingError, match=message):
        list(open_recording(path, pose_topic=topic).scans())


@pytest.mark.parametrize(("late_s", "apart"), [(-900, "896.1 s before"), (1000, "996.0 s after")])
def test_poses_of_another_clock_than_the_scans_are_refused(bag, late_s: int, apart: str) -> None:
    poses = [(*odometry(k * 100 + late_s * 1000, SE2(k * 0.1))[:2], START_NS + k * 100 * MS) for k in range(40)]
    messages = [odometry(k * 100 + late_s * 1000, SE2(k * 0.1))[3] for k in range(40)]
    path = bag([scan(k * 100) for k in range(41)] + [(*p, m) for p, m in zip(poses, messages, strict=True)])
    with pytest.raises(RecordingError, match=f"no pose on /odom at the time of a scan: they are stamped {apart}"):
        open_recording(path, pose_topic="/odom").overview()


def test_poses_are_kept_by_an_import_and_its_command(bag, tmp_path: Path) -> None:
    path = bag([scan(k * 100) for k in range(5)] + [odometry(k * 100, SE2(k * 0.1)) for k in range(5)])
    imported = import_recording(path, tmp_path / "drive.mcap", pose_topic="/odom")
    assert "--pose-topic /odom" in imported.info.command
    np.testing.assert_allclose([s.world_T_sensor.x for s in imported.scans()], np.arange(5) * 0.1, atol=1e-12)


def test_a_format_without_ros_topics_has_no_pose_topic(tmp_path: Path) -> None:
    (tmp_path / "a.clf").write_text("")
    with pytest.raises(RecordingError, match=r"--pose-topic is for ROS recordings"):
        open_recording(tmp_path / "a.clf", pose_topic="/odom")


def test_warnings_of_the_source_are_warnings_of_the_imported_recording(bag, tmp_path: Path) -> None:
    path = bag([scan(0), scan(100), scan(200), ("/tf", TF, START_NS, make(TF, transforms=[]))])
    import_recording(path, tmp_path / "drive.mcap")
    recording = open_recording(tmp_path / "drive.mcap")
    (warning,) = recording.overview().warnings
    assert "drive.mcap: the source had: transforms on /tf (tf2_msgs/msg/TFMessage) are not read" in warning
    assert str(tmp_path) not in warning.partition("the source had")[2]
    assert open_stream(tmp_path / "drive.mcap").recording.warnings == [warning]
    assert open_stream(path).recording.warnings == [warning.replace("the source had: ", "").replace("mcap", "bag")]
    again = import_recording(tmp_path / "drive.mcap", tmp_path / "again.mcap")
    assert len(again.overview().warnings) == 1


@pytest.mark.parametrize("pose_topic", [None, "/odom"])
def test_several_lasers_of_a_bag_are_refused_with_their_topics(bag, tmp_path: Path, pose_topic) -> None:
    rear = [("/rear", *scan(k * 100 + 5)[1:]) for k in range(30)]
    poses = [odometry(k * 20, SE2(k * 0.1)) for k in range(160)]
    path = bag([*(scan(k * 100) for k in range(30)), *rear, *poses])
    refused = r"several sensors \(scan, rear\), and how they are mounted is not known.*--topic /scan`, or --topic /rear"
    with pytest.raises(RecordingError, match=refused):
        import_recording(path, tmp_path / "drive.mcap", pose_topic=pose_topic)
    assert not (tmp_path / "drive.mcap").exists()
    with pytest.raises(RecordingError, match=refused):
        GridStream(open_recording(path, pose_topic=pose_topic))
    assert any("several sensors" in line for line in open_recording(path, pose_topic=pose_topic).overview().warnings)
    one = import_recording(path, tmp_path / "rear.mcap", pose_topic=pose_topic, topic="/rear")
    assert len(list(one.scans())) == 30


@pytest.mark.parametrize("pose_topic", [None, "/odom"])
def test_the_command_in_the_error_for_several_lasers_imports_one(bag, tmp_path: Path, monkeypatch, pose_topic) -> None:
    rear = [("/rear", *scan(k * 100 + 5)[1:]) for k in range(30)]
    path = bag([*(scan(k * 100) for k in range(30)), *rear, *(odometry(k * 20, SE2(k * 0.1)) for k in range(160))])
    with pytest.raises(RecordingError) as error:
        import_recording(path, tmp_path / "drive.mcap", pose_topic=pose_topic)
    (command,) = re.findall(r"`gridtrack ([^`]*)`", str(error.value))
    monkeypatch.chdir(tmp_path)
    assert CliRunner().invoke(app, shlex.split(command), catch_exceptions=False).exit_code == 0
    one = open_recording(tmp_path / "drive-one.mcap").overview().sensors["scan"]
    assert (one.scans, one.moves) == (30, pose_topic is not None)

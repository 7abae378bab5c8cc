"""Poses that are recorded the other way round, twice, or not at all: used where they are clear, else told."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from gridtrack.cli import app
from gridtrack.common.errors import RecordingError
from gridtrack.common.geometry import SE2
from gridtrack.recordings import import_recording, open_recording, parse_mount
from gridtrack.recordings.frames.transform import SE3
from gridtrack.recordings.recording import Recording

from scenes import drive_bag as made

ROS = made.Ros(1)
SCANS = list(made.scans_of(ROS, 3000, made.FRONT))
STATIC = ROS.transforms(0, *made.mounts(made.FRONT), topic="/tf_static")
STAMPS_MS = range(-20, 3100, 20)
BASE_T_CAMERA = SE2(0.2, 0.1, 0.4)
CAMERA = ROS.transforms(0, ("base_link", "camera_link", SE3.in_plane(BASE_T_CAMERA)), topic="/tf_static")


def written(folder: Path, *messages: made.Message) -> Path:
    return ROS.write(folder / "a.bag", [*SCANS, *messages])


def walls_stay(recording: Recording) -> bool:
    off = [made.distance_to_walls(scan).max() for scan in recording.scans()]
    return len(off) == len(SCANS) and max(off) < 0.02


def transforms(parent: str, child: str) -> list[made.Message]:
    """The place of the robot, at 50 Hz."""
    return [ROS.transforms(at, (parent, child, SE3.in_plane(made.robot_at(at)))) for at in STAMPS_MS]


def test_the_place_of_odom_on_the_robot_is_followed_backwards(tmp_path: Path) -> None:
    inverse = [ROS.transforms(at, ("base_link", "odom", SE3.in_plane(made.robot_at(at).inverse()))) for at in STAMPS_MS]
    recording = open_recording(written(tmp_path, STATIC, *inverse))
    assert recording.info.poses == "odom -> base_link -> front_laser; from /tf, /tf_static; longest gap 0.02 s"
    assert walls_stay(recording)


def test_a_wheel_that_turns_is_no_world(tmp_path: Path) -> None:
    wheel = [ROS.transforms(at, ("base_link", "wheel", SE3.in_plane(SE2(0.0, 0.2, at / 100)))) for at in STAMPS_MS]
    recording = open_recording(written(tmp_path, STATIC, *wheel))
    assert not recording.survey.moves
    assert "no motion recorded: assumed at rest" in recording.info.poses


@pytest.mark.parametrize("named", [{}, {"pose_topic": "/camera/odom"}])
def test_the_odometry_of_a_camera_on_the_robot_is_that_of_the_laser(tmp_path: Path, named: dict[str, str]) -> None:
    poses = [
        ROS.odometry(at, made.robot_at(at) @ BASE_T_CAMERA, "/camera/odom", child="camera_link") for at in STAMPS_MS
    ]
    recording = open_recording(written(tmp_path, STATIC, CAMERA, *poses), **named)
    assert recording.info.poses.startswith("odom -> camera_link -> base_link -> front_laser; from /camera/odom")
    assert walls_stay(recording)


def test_odometry_that_names_its_frame_twice_is_that_of_what_carries_the_sensor(tmp_path: Path) -> None:
    poses = [ROS.odometry(at, made.robot_at(at), child="odom") for at in STAMPS_MS]
    assert walls_stay(open_recording(written(tmp_path, STATIC, *poses)))


@pytest.mark.parametrize(("odom", "base"), [("odom_combined", "base_link"), ("tb_odom", "tb_base_link")])
def test_odom_may_be_a_word_in_a_name(tmp_path: Path, odom: str, base: str) -> None:
    jumps = [ROS.transforms(k * 1000, ("map", odom, SE3.in_plane(SE2(0.5 * (k % 2), 0.0, 0.0)))) for k in range(4)]
    static = ROS.transforms(0, (base, "front_laser", SE3.in_plane(made.FRONT.base_T_laser)), topic="/tf_static")
    recording = open_recording(written(tmp_path, static, *jumps, *transforms(odom, base)))
    assert recording.info.poses.startswith(f"{odom} -> {base} -> front_laser")
    assert walls_stay(recording)


def test_motion_in_a_second_parent_is_refused_and_the_command_in_the_error_works(tmp_path: Path, monkeypatch) -> None:
    later = [message for message in transforms("odom", "camera_link") if message[2] > CAMERA[2]]
    path = written(tmp_path, STATIC, CAMERA, *later)
    refused = (
        r"transforms on /tf \(odom -> camera_link\) tell how the sensors move, and 'camera_link' has another parent"
    )
    with pytest.raises(RecordingError, match=refused) as error:
        import_recording(path, tmp_path / "a.mcap")
    assert any("two parents" in line for line in open_recording(path).overview().warnings)
    (command,) = re.findall(r"`gridtrack ([^`]*)`", str(error.value))
    monkeypatch.chdir(tmp_path)
    assert CliRunner().invoke(app, shlex.split(command), catch_exceptions=False).exit_code == 0
    assert open_recording("a-posed.mcap").survey.moves
    assert not open_recording(path, pose_topic="none").survey.moves


def test_two_sources_of_a_transform_are_told(tmp_path: Path) -> None:
    other = [ROS.transforms(at, ("odom", "base_link", SE3())) for at in STAMPS_MS]
    both = [message for pair in zip(transforms("odom", "base_link"), other, strict=True) for message in pair]
    (warning,) = open_recording(written(tmp_path, STATIC, *both)).overview().warnings
    assert warning.endswith("transforms on /tf of frame 'base_link' differ at one stamp: two sources may send them")


def test_scans_before_the_first_pose_have_the_first(tmp_path: Path) -> None:
    late = [ROS.odometry(at, made.robot_at(at)) for at in range(1500, 3100, 20)]
    recording = open_recording(written(tmp_path, STATIC, *late))
    (warning,) = recording.overview().warnings
    assert "without poses on /odom (odom -> base_link) within 1 s get the first one after them: 5 of them" in warning
    first = made.robot_at(1500) @ made.FRONT.base_T_laser
    moved = first.inverse() @ next(iter(recording.scans())).world_T_sensor
    assert (moved.x, moved.y, moved.theta) == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)


def test_motion_that_is_not_recorded_cannot_be_refined(tmp_path: Path) -> None:
    with pytest.raises(
        RecordingError, match="no motion to refine: --ego-motion kiss-icp takes the poses from the scans"
    ):
        import_recording(written(tmp_path), tmp_path / "a.mcap", ego_motion="refined")
    assert not (tmp_path / "a.mcap").exists()


def test_poses_from_the_scans_need_no_clock_in_common(tmp_path: Path) -> None:
    poses = [ROS.transforms(at - 900_000, ("odom", "base_link", SE3.in_plane(made.robot_at(at)))) for at in STAMPS_MS]
    received = [(topic, kind, at_ns + 900_000 * made.MS, message) for topic, kind, at_ns, message in poses]
    path = written(tmp_path, STATIC, *received)
    with pytest.raises(RecordingError, match="with one clock, or import this recording with --ego-motion kiss-icp"):
        import_recording(path, tmp_path / "a.mcap")
    assert import_recording(path, tmp_path / "a.mcap", ego_motion="kiss-icp").survey.moves


def test_a_suggested_command_has_each_mount_once_and_none_of_another_sensor(tmp_path: Path) -> None:
    scans = made.scans_of(ROS, 3000, made.FRONT, made.REAR)
    path = ROS.write(tmp_path / "a.bag", [*scans, *transforms("odom", "base_link")])
    with pytest.raises(RecordingError, match="several sensors") as error:
        import_recording(path, tmp_path / "a.mcap", mounts=[parse_mount("rear_scan=-0.3,0,180deg,mirrored")])
    one, both = re.findall(r"`gridtrack ([^`]*)`", str(error.value))
    assert "rear_scan" not in one
    assert [both.count(f"--mount {name}_scan=") for name in ("front", "rear")] == [1, 1]
    cycle = ROS.transforms(0, ("front_laser", "base_link", SE3()), topic="/tf_static")
    path = ROS.write(tmp_path / "b.bag", [*SCANS, STATIC, cycle, ROS.odometry(0, SE2())])
    with pytest.raises(RecordingError, match="frames in a cycle") as error:
        import_recording(path, tmp_path / "b.mcap", mounts=[parse_mount("front_scan=base_link:1,0,0")])
    *_, given = re.findall(r"`gridtrack ([^`]*)`", str(error.value))
    assert given.count("--mount front_scan=") == 1


def test_a_laser_that_is_tilted_too_much_is_no_damage(tmp_path: Path) -> None:
    tilted = SE3.of((0.0, 0.0, 1.0), (0.0, 0.2588, 0.0, 0.9659))
    assert tilted is not None
    path = written(tmp_path, ROS.transforms(0, ("base_link", "front_laser", tilted), topic="/tf_static"))
    with pytest.raises(RecordingError, match=r"no scan can be used: .*tilted by more than 15 deg.*--mount"):
        open_recording(path).overview()
    assert open_recording(path, mounts=[parse_mount("front_scan=0,0,0")]).overview().sensors

"""Poses of a drive from its frames: whatever a robot recorded, the returns of its scans lie on the walls."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin
from typer.testing import CliRunner

from gridtrack.cli import app
from gridtrack.common.errors import ConfigurationError, RecordingError
from gridtrack.common.geometry import SE2
from gridtrack.recordings import import_recording, open_recording, parse_mount
from gridtrack.recordings.frames.transform import SE3
from gridtrack.recordings.recording import Recording
from gridtrack.recordings.stream import open_stream

from scenes import drive_bag as made

ROS = made.Ros(1)
WALL_TOLERANCE_M = 0.02
CHAINS = (
    "front_scan: odom -> base_footprint -> base_link -> front_laser; rear_scan: odom -> base_footprint -> base_link ->"
    " rear_laser (mirrored); from /tf, /tf_static; longest gap 0.02 s"
)
NO_MOTION = "no motion recorded: assumed at rest (if the robot drives: recording import --ego-motion kiss-icp)"
FRONT_ONLY = [
    *made.scans_of(ROS, 3000, made.FRONT),
    ROS.transforms(0, *made.mounts(made.FRONT), topic="/tf_static"),
]


def walls_stay(recording: Recording) -> bool:
    """Whether all returns of all scans lie on the walls of the room."""
    off = [made.distance_to_walls(scan).max() for scan in recording.scans()]
    return len(off) > 20 and max(off) < WALL_TOLERANCE_M


@pytest.mark.parametrize("static_at_ms", [0, 5900])
@pytest.mark.parametrize("kind", ["ROS 1", "ROS 2", "ROS 2 in MCAP"])
def test_a_drive_with_two_scanners_is_read_without_an_option(tmp_path: Path, kind: str, static_at_ms: int) -> None:
    ros = made.Ros(1 if kind == "ROS 1" else 2)
    storage = StoragePlugin.MCAP if kind == "ROS 2 in MCAP" else StoragePlugin.SQLITE3
    path = ros.write(tmp_path / "drive.bag", made.two_scanner_drive(ros, static_at_ms=static_at_ms), storage)
    recording = open_recording(path)
    assert walls_stay(recording)
    assert recording.overview().warnings == ()
    assert recording.info.poses == CHAINS
    assert set(recording.survey.sensors) == {"front_scan", "rear_scan"}
    assert all(sensor.moves for sensor in recording.overview().sensors.values())
    stream = open_stream(path)
    assert len(next(iter(stream)).origins) == 2


def test_poses_and_their_source_are_imported(tmp_path: Path) -> None:
    path = ROS.write(tmp_path / "drive.bag", made.two_scanner_drive(ROS))
    imported = import_recording(path, tmp_path / "drive.mcap")
    assert walls_stay(imported)
    assert imported.info.poses == CHAINS
    assert f"poses: {CHAINS}" in str(imported.overview())
    again = import_recording(tmp_path / "drive.mcap", tmp_path / "again.mcap")
    assert again.info.poses == CHAINS
    for one, other in zip(imported.scans(), open_recording(path).scans(), strict=True):
        assert one.world_T_sensor.x == other.world_T_sensor.x
        np.testing.assert_array_equal(one.ranges, other.ranges)


def test_odometry_with_its_child_frame_joins_the_static_transforms(tmp_path: Path) -> None:
    poses = [ROS.odometry(at, made.robot_at(at)) for at in range(0, 3100, 20)]
    recording = open_recording(ROS.write(tmp_path / "a.bag", [*FRONT_ONLY, *poses]))
    assert recording.info.poses == "odom -> base_link -> front_laser; from /odom, /tf_static; longest gap 0.02 s"
    assert walls_stay(recording)


def test_the_only_poses_are_those_of_what_carries_the_sensor(tmp_path: Path) -> None:
    poses = [ROS.pose(at, made.robot_at(at)) for at in range(0, 3100, 20)]
    recording = open_recording(ROS.write(tmp_path / "a.bag", [*FRONT_ONLY, *poses]))
    assert recording.info.poses == "world -> base_link -> front_laser; from /pose, /tf_static; longest gap 0.02 s"
    assert walls_stay(recording)


def test_a_mount_that_is_not_recorded_is_asked_for_and_used(tmp_path: Path) -> None:
    poses = [ROS.odometry(at, made.robot_at(at)) for at in range(0, 3100, 20)]
    path = ROS.write(tmp_path / "a.bag", [*made.scans_of(ROS, 3000, made.FRONT, made.REAR), *poses])
    with pytest.raises(
        RecordingError, match=r"several sensors .*--mount front_scan=0,0,0deg --mount rear_scan=0,0,0deg"
    ):
        open_stream(path)
    mounts = [parse_mount("front_laser=0.3,0.1,30deg"), parse_mount("rear_scan=-0.3,0,180deg,mirrored")]
    recording = open_recording(path, mounts=mounts)
    assert walls_stay(recording)
    assert "odom -> base_link -> rear_scan (mirrored); from /odom, --mount" in recording.info.poses
    one = ROS.write(tmp_path / "one.bag", [*made.scans_of(ROS, 3000, made.FRONT), *poses])
    with pytest.raises(RecordingError, match=r"poses on /odom are those of 'base_link', .*--mount front_scan=0,0,0deg"):
        import_recording(one, tmp_path / "one.mcap")
    imported = import_recording(one, tmp_path / "one.mcap", mounts=[parse_mount("front_scan=0.3,0.1,30deg")])
    assert walls_stay(imported)
    assert "--mount front_scan=0.3,0.1,30deg" in imported.info.command


def test_the_pose_of_a_scan_is_interpolated(tmp_path: Path) -> None:
    stamps = (0, 50, 100, 125, 300)
    scans = [ROS.laser(at, np.full(181, 2.0, np.float32), made.FRONT) for at in stamps]
    known = [(40, SE2(1.0, 2.0, 0.0)), (100, SE2(1.6, 2.0, 0.0)), (200, SE2(1.6, 2.0, 1.0))]
    path = ROS.write(tmp_path / "a.bag", [*scans, *(ROS.odometry(at, pose) for at, pose in known)])
    recording = open_recording(path, mounts=[parse_mount("front_scan=0,0,0")])
    poses = [s.world_T_sensor for s in recording.scans()]
    # before the first pose the first, then at 1/6, 1, and 1/4 of the way, after the last the last
    expected = [(1.0, 2.0, 0.0), (1.1, 2.0, 0.0), (1.6, 2.0, 0.0), (1.6, 2.0, 0.25), (1.6, 2.0, 1.0)]
    np.testing.assert_allclose([(p.x, p.y, p.theta) for p in poses], expected, atol=1e-9)
    assert recording.warnings == []


def test_a_gap_in_the_poses_is_a_warning_and_delays_no_scans(tmp_path: Path) -> None:
    scans = [ROS.laser(k * 100, np.full(181, 2.0, np.float32), made.FRONT) for k in range(100)]
    poses = [ROS.odometry(0, SE2()), ROS.odometry(9000, SE2(9.0))]
    path = ROS.write(tmp_path / "a.bag", [*scans, *poses])
    recording = open_recording(path, mounts=[parse_mount("front_scan=0,0,0")])
    found = [s.world_T_sensor.x for s in recording.scans()]
    assert (len(found), found[5], found[80], found[-1]) == (100, 0.0, 0.0, 9.0)
    assert recording.info.poses.endswith("longest gap 9.00 s")
    (warning,) = recording.warnings
    assert "without poses on /odom (odom -> base_link) within 1 s get the last one before them: 79 of them" in warning
    strict = open_recording(path, mounts=[parse_mount("front_scan=0,0,0")], strict=True)
    with pytest.raises(RecordingError, match="without poses on /odom"):
        list(strict.scans())


@pytest.mark.parametrize("topic", ["/odmo", "/front_scan"])
def test_a_topic_without_poses_is_refused(tmp_path: Path, topic: str) -> None:
    path = ROS.write(tmp_path / "a.bag", [*FRONT_ONLY, ROS.odometry(0, SE2())])
    with pytest.raises(RecordingError, match=f"no topic '{topic}' with poses; .*/odom"):
        list(open_recording(path, pose_topic=topic).scans())


@pytest.mark.parametrize(("late_ms", "apart"), [(-900_000, "897.1 s before"), (1_000_000, "997.1 s after")])
def test_poses_of_another_clock_than_the_scans_are_refused(tmp_path: Path, late_ms: int, apart: str) -> None:
    poses = [ROS.odometry(at + late_ms, made.robot_at(at)) for at in range(0, 3000, 100)]
    received = [(topic, kind, at - late_ms * made.MS, message) for topic, kind, at, message in poses]
    path = ROS.write(tmp_path / "a.bag", [*FRONT_ONLY, *received])
    with pytest.raises(RecordingError, match=f"no pose on /odom at the time of a scan: their stamps are {apart}"):
        open_recording(path).overview()


def test_a_format_without_frames_has_no_pose_topic_and_no_mounts(tmp_path: Path) -> None:
    (tmp_path / "a.clf").write_text("")
    with pytest.raises(RecordingError, match=r"--pose-topic is for recordings whose poses are on topics of their own"):
        open_recording(tmp_path / "a.clf", pose_topic="/odom")
    with pytest.raises(RecordingError, match=r"--mount is for recordings whose scans name their frame"):
        open_recording(tmp_path / "a.clf", mounts=[parse_mount("scan=0,0,0")])
    path = ROS.write(tmp_path / "a.bag", list(made.scans_of(ROS, 1000, made.REAR)))
    recording = open_recording(path, mounts=[parse_mount("rare_scan=0,0,0")])
    with pytest.raises(ConfigurationError, match=r"--mount rare_scan=.*no sensor 'rare_scan'; did you mean 'rear_"):
        list(recording.scans())


@pytest.mark.parametrize("with_odometry", [False, True])
def test_the_commands_in_the_error_for_several_lasers_import_them(tmp_path: Path, monkeypatch, with_odometry) -> None:
    poses = [ROS.odometry(at, made.robot_at(at)) for at in range(0, 3100, 20)] if with_odometry else []
    path = ROS.write(tmp_path / "drive.bag", [*made.scans_of(ROS, 3000, made.FRONT, made.REAR), *poses])
    refused = (
        r"several sensors \(front_scan, rear_scan\), and how they are mounted is not known.*--topic /front_scan.*`,"
        r" or --topic /rear_scan"
    )
    with pytest.raises(RecordingError, match=refused) as error:
        import_recording(path, tmp_path / "drive.mcap")
    assert not (tmp_path / "drive.mcap").exists()
    assert any("several sensors" in line for line in open_recording(path).overview().warnings)
    one, both = re.findall(r"`gridtrack ([^`]*)`", str(error.value))
    monkeypatch.chdir(tmp_path)
    assert CliRunner().invoke(app, shlex.split(both), catch_exceptions=False).exit_code == 0
    posed = open_recording(tmp_path / "drive-posed.mcap").overview()
    assert (len(posed.sensors), posed.sensors["front_scan"].moves) == (2, with_odometry)
    assert CliRunner().invoke(app, shlex.split(one), catch_exceptions=False).exit_code == 0
    assert open_recording(tmp_path / "drive-one.mcap").survey.moves == with_odometry


def test_a_robot_that_stands_needs_no_mount(tmp_path: Path) -> None:
    poses = [ROS.odometry(at, SE2(3.0, 1.0, 0.5)) for at in range(0, 3100, 20)]
    path = ROS.write(tmp_path / "a.bag", [*made.scans_of(ROS, 3000, made.FRONT), *poses])
    recording = open_recording(path)
    assert recording.overview().warnings == ()
    assert not recording.survey.moves
    assert recording.info.poses == "at rest"


def test_scanners_at_rest_share_a_grid_by_their_static_transforms(tmp_path: Path) -> None:
    static = ROS.transforms(0, *made.mounts(made.FRONT, made.REAR), topic="/tf_static")
    path = ROS.write(tmp_path / "a.bag", [static, *made.scans_of(ROS, 3000, made.FRONT, made.REAR)])
    recording = open_recording(path)
    assert recording.overview().warnings == ()
    assert recording.info.poses.endswith("base_link -> rear_laser (mirrored); from /tf_static; " + NO_MOTION)
    assert recording.survey.poses["front_scan"] == pytest.approx(made.FRONT.base_T_laser)


def test_poses_of_several_things_are_asked_about(tmp_path: Path) -> None:
    poses = [ROS.pose(at, made.robot_at(at), topic) for at in range(0, 3100, 20) for topic in ("/ego", "/other")]
    path = ROS.write(tmp_path / "a.bag", [*made.scans_of(ROS, 3000, made.FRONT), *poses])
    with pytest.raises(RecordingError) as error:
        open_stream(path)
    asked = str(error.value)
    which = "it is not known which of the poses on /ego, /other are, if any, those of what carries sensor 'front_scan'"
    assert which in asked
    assert "--pose-topic /ego --mount front_scan=0,0,0deg`" in asked
    assert "\n" not in asked
    assert "its poses are not known" in str(open_recording(path).overview())
    named = open_recording(path, pose_topic="/ego", mounts=[parse_mount("front_scan=0.3,0.1,30deg")])
    assert walls_stay(named)
    still = open_recording(path, pose_topic="none")
    assert still.overview().warnings == ()
    assert not still.survey.moves


def test_beside_poses_that_are_asked_about_it_is_said_why_the_transforms_do_not_help(tmp_path: Path) -> None:
    carried = [ROS.transforms(at, ("odom", "base", SE3.in_plane(made.robot_at(at)))) for at in range(0, 3100, 20)]
    poses = [ROS.pose(at, made.robot_at(at), "/ego") for at in range(0, 3100, 20)]
    path = ROS.write(tmp_path / "a.bag", [*made.scans_of(ROS, 3000, made.FRONT), *carried, *poses])
    with pytest.raises(RecordingError) as error:
        open_stream(path)
    why = (
        r"transforms on /tf \(odom -> base\) do not reach frame '\w+' of sensor 'front_scan'; it is not known whether"
        r" the poses on /ego are those of what carries sensor 'front_scan': name the topic that has them"
    )
    assert re.search(why, str(error.value))


def test_recorded_poses_that_cannot_be_used_are_no_obstacle_where_scans_alone_give_the_poses(tmp_path: Path) -> None:
    pytest.importorskip("kiss_icp")
    poses = [ROS.pose(at, made.robot_at(at), topic) for at in range(0, 3100, 20) for topic in ("/ego", "/other")]
    path = ROS.write(tmp_path / "a.bag", [*made.scans_of(ROS, 3000, made.FRONT), *poses])
    found = import_recording(path, tmp_path / "a.mcap", ego_motion="kiss-icp")
    assert found.info.poses.startswith("kiss-icp: scans of 'front_scan' matched")
    assert found.overview().warnings == ()
    assert "--pose-topic none" in found.info.command
    assert found.survey.moves
    with pytest.raises(RecordingError, match="it is not known which of the poses on /ego, /other are"):
        import_recording(path, tmp_path / "b.mcap", ego_motion="refined")


def test_transforms_that_do_not_reach_the_sensor_are_told_with_the_frame_to_mount_it_on(tmp_path: Path) -> None:
    links = [ROS.transforms(at, ("map", "car", SE3.in_plane(made.robot_at(at)))) for at in range(0, 3100, 20)]
    path = ROS.write(tmp_path / "a.bag", [*made.scans_of(ROS, 3000, made.FRONT), *links])
    with pytest.raises(RecordingError) as error:
        open_stream(path)
    assert "transforms on /tf (map -> car) do not reach frame 'front_laser' of sensor 'front_scan'" in str(error.value)
    assert "--mount front_scan=car:0,0,0deg`" in str(error.value)
    assert walls_stay(open_recording(path, mounts=[parse_mount("front_laser=car:0.3,0.1,30deg")]))


def test_odometry_is_taken_before_a_localisation_that_jumps(tmp_path: Path) -> None:
    drive = made.two_scanner_drive(ROS)
    assert walls_stay(open_recording(ROS.write(tmp_path / "odom.bag", drive)))
    renamed = [
        ROS.transforms(at, ("map", "base_link", SE3.in_plane(SE2(0.5 * (at // 1000 % 2)) @ made.robot_at(at))))
        for at in range(-20, 3100, 20)
    ]
    recording = open_recording(ROS.write(tmp_path / "map.bag", [*FRONT_ONLY, *renamed]))
    (warning,) = recording.overview().warnings
    assert "sensor 'front_scan': its pose jumps: 2 times in the whole recording, by up to 0.50 m and 0 deg" in warning


def test_two_robots_with_prefixed_frames_meet_in_the_map(tmp_path: Path) -> None:
    messages = []
    for name in ("a", "b"):
        laser = made.Laser(name, made.FRONT.base_T_laser)
        at_ms = range(-20, 3100, 20)
        odom, mounted = f"{name}/odom", SE3.in_plane(laser.base_T_laser)
        poses = {at: made.robot_at(at) for at in at_ms}
        messages += [
            ROS.transforms(
                0, ("map", odom, SE3()), (f"{name}/base_link", f"{name}_laser", mounted), topic="/tf_static"
            ),
            *(ROS.transforms(at, (odom, f"{name}/base_link", SE3.in_plane(poses[at]))) for at in at_ms),
            *made.scans_of(ROS, 3000, laser),
        ]
    recording = open_recording(ROS.write(tmp_path / "a.bag", messages))
    assert walls_stay(recording)
    assert recording.info.poses.startswith("a_scan: map -> a/odom -> a/base_link -> a_laser; b_scan: map -> b/odom")
    only_a = open_recording(tmp_path / "a.bag", topic="/a_scan")
    assert walls_stay(only_a)
    assert only_a.info.poses.startswith("a/odom -> a/base_link -> a_laser")


def test_a_mount_is_on_the_frame_whose_poses_are_recorded(tmp_path: Path) -> None:
    poses = [ROS.odometry(at, made.robot_at(at), child="base_footprint") for at in range(0, 3100, 20)]
    path = ROS.write(tmp_path / "a.bag", [*FRONT_ONLY, *poses])
    with pytest.raises(RecordingError, match=r"of 'base_footprint', and where sensor 'front_scan' is mounted"):
        open_stream(path)
    recording = open_recording(path, mounts=[parse_mount("front_scan=0.3,0.1,30deg")])
    assert walls_stay(recording)
    assert recording.info.poses.startswith("odom -> base_footprint -> front_scan; from /odom, --mount")


def test_a_laser_that_pans_on_a_robot_at_rest_moves(tmp_path: Path) -> None:
    def pan_at(at_ms: float) -> SE2:
        return SE2(0.5, 0.1, 0.05 + 0.3 * np.sin(at_ms / 500.0))

    laser = made.Laser("pan", SE2())
    messages = [ROS.laser(at, made.ranges_at(laser, pan_at(at), (0.0, 3.0)), laser) for at in range(0, 3000, 100)]
    links = [ROS.transforms(at, ("base_link", "pan_laser", SE3.in_plane(pan_at(at)))) for at in range(-20, 3100, 20)]
    recording = open_recording(ROS.write(tmp_path / "a.bag", [*messages, *links]))
    assert walls_stay(recording)
    assert recording.info.poses == "base_link -> pan_laser; from /tf; longest gap 0.02 s"


def test_two_topics_of_one_frame_are_told(tmp_path: Path) -> None:
    drive = made.two_scanner_drive(ROS)
    twice = [("/filtered", *message[1:]) for message in drive if message[0] == "/front_scan"]
    recording = open_recording(ROS.write(tmp_path / "a.bag", [*drive, *twice]))
    (warning,) = recording.overview().warnings
    assert "/front_scan and /filtered have scans in one frame, 'front_laser'" in warning
    assert "--topic /front_scan`" in warning

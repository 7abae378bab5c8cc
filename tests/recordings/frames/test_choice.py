"""The chain of transforms of each sensor: by its poses, the returns of every scan lie on the walls of the room."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin
from typer.testing import CliRunner

from gridtrack.cli import app
from gridtrack.common.errors import ConfigurationError, RecordingError
from gridtrack.common.geometry import SE2, same_pose
from gridtrack.recordings import import_recording, open_recording, parse_mount
from gridtrack.recordings.frames.transform import SE3
from gridtrack.recordings.stream import open_stream

from scenes import drive_bag as made

Bag = Callable[..., Path]
ROS = made.Ros(1)
FRONT, REAR = (list(made.scans_of(ROS, made.DURATION_MS, laser)) for laser in (made.FRONT, made.REAR))
STATIC = ROS.transforms(0, *made.mounts(made.FRONT), topic="/tf_static")
BASE_T_CAMERA = SE2(0.2, 0.1, 0.4)
CAMERA = ROS.transforms(0, ("base_link", "camera_link", SE3.in_plane(BASE_T_CAMERA)), topic="/tf_static")
CHAINS = (
    "front_scan: odom -> base_footprint -> base_link -> front_laser; rear_scan: odom -> base_footprint -> base_link ->"
    " rear_laser (mirrored); from /tf, /tf_static; longest gap 0.02 s"
)
NO_MOTION = "no motion recorded: assumed at rest (if the robot drives: --ego-motion kiss-icp)"


def static(*links: tuple[str, str, SE3]) -> made.Message:
    return ROS.transforms(0, *links, topic="/tf_static")


def on_topic(topic: str, messages: Iterable[made.Message]) -> list[made.Message]:
    return [(topic, *rest) for _, *rest in messages]


def commands_in(error: object) -> list[str]:
    """The gridtrack commands that a message suggests."""
    return re.findall(r"`gridtrack ([^`]*)`", str(error))


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Runs a command in the folder of the bags; it must succeed."""
    monkeypatch.chdir(tmp_path)

    def run_command(command: str) -> None:
        assert CliRunner().invoke(app, shlex.split(command), catch_exceptions=False).exit_code == 0

    return run_command


@pytest.mark.parametrize(
    ("version", "storage", "static_at_ms"),
    [(1, None, 0), (1, None, 2400), (2, StoragePlugin.SQLITE3, 2400), (2, StoragePlugin.MCAP, 2400)],
)
def test_a_drive_with_two_scanners_needs_no_option(tmp_path: Path, version: int, storage, static_at_ms: int) -> None:
    ros = made.Ros(version)
    path = ros.write(tmp_path / "a.bag", made.two_scanner_drive(ros, made.DURATION_MS, static_at_ms), storage)
    recording = open_recording(path)
    assert made.walls_stay(recording.scans(), 2 * made.SCANS)
    assert recording.overview().warnings == ()
    assert recording.info.poses == CHAINS
    assert all(sensor.moves for sensor in recording.overview().sensors.values())
    assert len(next(iter(open_stream(path))).origins) == 2


def test_an_import_keeps_the_poses_and_their_source(bag: Bag, tmp_path: Path) -> None:
    path = bag(*made.two_scanner_drive(ROS, made.DURATION_MS))
    imported = import_recording(path, tmp_path / "drive.mcap")
    assert f"poses: {CHAINS}" in str(imported.overview())
    again = import_recording(tmp_path / "drive.mcap", tmp_path / "again.mcap")
    assert again.info.poses == CHAINS
    for one, other in zip(again.scans(), open_recording(path).scans(), strict=True):
        assert (one.world_T_sensor.x, one.world_T_sensor.y) == (other.world_T_sensor.x, other.world_T_sensor.y)
        np.testing.assert_array_equal(one.ranges, other.ranges)


def jumping(odom: str) -> list[made.Message]:
    """A localisation that jumps every second."""
    return [ROS.transforms(k * 1000, ("map", odom, SE3.in_plane(SE2(0.5 * (k % 2))))) for k in range(3)]


@pytest.mark.parametrize(
    ("messages", "poses"),
    [
        pytest.param(
            [STATIC, *made.odometry(ROS)],
            "odom -> base_link -> front_laser; from /odom, /tf_static; longest gap 0.04 s",
            id="odometry joins the static transforms by its child frame",
        ),
        pytest.param(
            [STATIC, *made.poses(ROS, "/pose")],
            "world -> base_link -> front_laser; from /pose, /tf_static; longest gap 0.04 s",
            id="the only poses are the robot's",
        ),
        pytest.param(
            [STATIC, *made.odometry(ROS, child="odom")],
            "",
            id="odometry with one name for both frames is the robot's",
        ),
        pytest.param(
            [STATIC, *made.moving(ROS, "base_link", "odom", backwards=True)],
            "odom -> base_link -> front_laser; from /tf, /tf_static; longest gap 0.04 s",
            id="transforms of odom in the robot are read backwards",
        ),
        *(
            pytest.param(
                [
                    static((base, "front_laser", SE3.in_plane(made.FRONT.base_T_laser))),
                    *jumping(odom),
                    *made.moving(ROS, odom, base),
                ],
                f"{odom} -> {base} -> front_laser",
                id=f"{odom} is preferred to a map that jumps",
            )
            for odom, base in (("odom_combined", "base_link"), ("tb_odom", "tb_base_link"))
        ),
        *(
            pytest.param(
                [STATIC, static(("odom", "base_link", SE3())), *made.moving(ROS, world, "odom")],
                f"{world} -> odom -> base_link -> front_laser; from /tf, /tf_static",
                id=f"a static odom that moves in {world} is no world frame",
            )
            for world in ("map", "world")
        ),
        pytest.param(
            [STATIC, static(("map", "odom", SE3()), ("odom", "base_link", SE3())), *made.moving(ROS, "earth", "map")],
            "earth -> map -> odom -> base_link",
            id="a static map that moves in another frame is no world frame",
        ),
        pytest.param(
            [
                STATIC,
                ROS.transforms(10, *made.mounts(made.FRONT), topic="/robot1/tf_static"),
                *made.moving(ROS, "odom", "base_link"),
            ],
            "odom -> base_link -> front_laser",
            id="equal static transforms on two topics are no fault",
        ),
    ],
)
def test_the_chain_is_found_without_a_warning(bag: Bag, messages: list[made.Message], poses: str) -> None:
    recording = open_recording(bag(*FRONT, *messages))
    assert recording.info.poses.startswith(poses)
    assert made.walls_stay(recording.scans())
    assert recording.survey.moves
    assert recording.overview().warnings == ()
    assert not open_recording(recording.path, pose_topic="none").survey.moves


@pytest.mark.parametrize("named", [{}, {"pose_topic": "/camera/odom"}])
def test_odometry_of_a_camera_on_the_robot_places_the_laser(bag: Bag, named: dict[str, str]) -> None:
    camera = {at: made.robot_at(at) @ BASE_T_CAMERA for at in made.STAMPS_MS}
    poses = [ROS.odometry(at, pose, "/camera/odom", child="camera_link") for at, pose in camera.items()]
    recording = open_recording(bag(*FRONT, STATIC, CAMERA, *poses), **named)
    assert recording.info.poses.startswith("odom -> camera_link -> base_link -> front_laser; from /camera/odom")
    assert made.walls_stay(recording.scans())


def test_a_laser_that_pans_on_a_robot_at_rest_moves(bag: Bag) -> None:
    def pan_at(at_ms: float) -> SE2:
        return SE2(0.5, 0.1, 0.05 + 0.3 * np.sin(at_ms / 500.0))

    laser = made.Laser("pan", SE2())
    scans = [
        ROS.laser(at, made.ranges_at(laser, pan_at(at), (0.0, 3.0)), laser) for at in range(0, made.DURATION_MS, 100)
    ]
    stamps_ms = range(-20, made.DURATION_MS + 100, 20)
    links = [ROS.transforms(at, ("base_link", "pan_laser", SE3.in_plane(pan_at(at)))) for at in stamps_ms]
    recording = open_recording(bag(*scans, *links))
    assert made.walls_stay(recording.scans())
    assert recording.info.poses == "base_link -> pan_laser; from /tf; longest gap 0.02 s"


def test_two_robots_with_prefixed_frames_meet_in_the_map(bag: Bag) -> None:
    messages = []
    for name in ("a", "b"):
        laser = made.Laser(name, made.FRONT.base_T_laser)
        mounted = (f"{name}/base_link", f"{name}_laser", SE3.in_plane(laser.base_T_laser))
        messages += [
            static(("map", f"{name}/odom", SE3()), mounted),
            *made.moving(ROS, f"{name}/odom", f"{name}/base_link"),
            *made.scans_of(ROS, made.DURATION_MS, laser),
        ]
    recording = open_recording(bag(*messages))
    assert made.walls_stay(recording.scans(), 2 * made.SCANS)
    assert recording.info.poses.startswith("a_scan: map -> a/odom -> a/base_link -> a_laser; b_scan: map -> b/odom")
    only_a = open_recording(recording.path, topic="/a_scan")
    assert made.walls_stay(only_a.scans())
    assert only_a.info.poses.startswith("a/odom -> a/base_link -> a_laser")


# ---- sensors at rest


def test_a_robot_at_rest_needs_no_mount(bag: Bag) -> None:
    poses = [ROS.odometry(at, SE2(3.0, 1.0, 0.5)) for at in made.STAMPS_MS]
    recording = open_recording(bag(*FRONT, *poses))
    assert recording.overview().warnings == ()
    assert not recording.survey.moves
    assert recording.info.poses == "at rest"


def test_scanners_at_rest_share_a_grid_by_their_static_transforms(bag: Bag) -> None:
    recording = open_recording(bag(static(*made.mounts(made.FRONT, made.REAR)), *FRONT, *REAR))
    assert recording.overview().warnings == ()
    assert recording.info.poses.endswith("base_link -> rear_laser (mirrored); from /tf_static; " + NO_MOTION)
    assert recording.survey.poses["front_scan"] == pytest.approx(made.FRONT.base_T_laser)


def test_a_turning_wheel_is_no_world_frame(bag: Bag) -> None:
    wheel = [ROS.transforms(at, ("base_link", "wheel", SE3.in_plane(SE2(0.0, 0.2, at / 100)))) for at in made.STAMPS_MS]
    recording = open_recording(bag(*FRONT, STATIC, *wheel))
    assert not recording.survey.moves
    assert NO_MOTION in recording.info.poses


def test_odometry_at_rest_is_kept_and_the_motion_above_it_is_a_warning(bag: Bag, run) -> None:
    pytest.importorskip("kiss_icp")
    still = made.at_rest(ROS, "odom", "base_link")
    path = bag(*FRONT, STATIC, *still, *made.moving(ROS, "map", "odom"))
    recording = open_recording(path, strict=True)
    (warning,) = recording.overview().warnings
    assert "the sensors are at rest in 'odom', which moves in 'map' by the transforms on /tf: if they drive" in warning
    assert recording.info.poses.startswith("odom -> base_link -> front_laser; ")
    assert not recording.survey.moves
    assert not open_recording(path, pose_topic="none").overview().warnings
    mount = f"front_scan=odom:{made.FRONT.base_T_laser.x},{made.FRONT.base_T_laser.y},30deg"
    assert made.walls_stay(open_recording(path, mounts=[parse_mount(mount)]).scans())
    (command,) = commands_in(warning)
    run(command)
    assert open_recording("a-posed.mcap").survey.moves


def test_motion_that_is_not_recorded_cannot_be_refined(bag: Bag, tmp_path: Path) -> None:
    no_motion = "no motion to refine: --ego-motion kiss-icp takes the poses from the scans"
    with pytest.raises(RecordingError, match=no_motion):
        import_recording(bag(*FRONT), tmp_path / "a.mcap", ego_motion="refined")
    assert not (tmp_path / "a.mcap").exists()


# ---- mounts and the pose topic


def without_frame() -> list[made.Message]:
    """The scans with an empty frame."""
    scans = list(made.scans_of(ROS, made.DURATION_MS, made.FRONT))
    for *_, message in scans:
        message.header.frame_id = ""
    return scans


BASE_FOOTPRINT = [*FRONT, STATIC, *made.odometry(ROS, child="base_footprint")]
AMBIGUOUS = [*FRONT, *made.poses(ROS, "/ego", "/other")]


@pytest.mark.parametrize(
    ("messages", "message", "options", "poses"),
    [
        pytest.param(
            [*FRONT, *REAR, *made.odometry(ROS)],
            r"several sensors .*--mount front_scan=0,0,0deg --mount rear_scan=0,0,0deg",
            {"mounts": ["front_laser=0.3,0.1,30deg", "rear_scan=-0.3,0,180deg,mirrored"]},
            "odom -> base_link -> rear_scan (mirrored); from /odom, --mount",
            id="two sensors on the robot with odometry",
        ),
        pytest.param(
            [*FRONT, *made.odometry(ROS)],
            r"/odom has the poses of 'base_link', and the mount of sensor 'front_scan' .*--mount front_scan=0,0,0deg",
            {"mounts": ["front_scan=0.3,0.1,30deg"]},
            "odom -> base_link -> front_scan; from /odom, --mount",
            id="one sensor on the robot with odometry",
        ),
        pytest.param(
            BASE_FOOTPRINT,
            r"of 'base_footprint', and the mount of sensor 'front_scan'",
            {"mounts": ["front_scan=0.3,0.1,30deg"]},
            "odom -> base_footprint -> front_scan; from /odom, --mount",
            id="a mount is on the frame with recorded poses",
        ),
        pytest.param(
            [*without_frame(), *made.odometry(ROS)],
            "--mount front_scan=0,0,0deg",
            {"mounts": ["front_scan=0.3,0.1,30deg"]},
            "odom -> base_link -> front_scan",
            id="scans without a frame",
        ),
        pytest.param(
            [*FRONT, *made.moving(ROS, "map", "car")],
            r"transforms on /tf \(map -> car\) do not lead to frame 'front_laser' of sensor 'front_scan'.*"
            r"--mount front_scan=car:0,0,0deg`",
            {"mounts": ["front_laser=car:0.3,0.1,30deg"]},
            "map -> car -> front_laser",
            id="transforms that do not lead to the sensor",
        ),
        pytest.param(
            AMBIGUOUS,
            r"not recorded which of /ego, /other has the poses of the robot with sensor 'front_scan'.*"
            r"--pose-topic /ego --mount front_scan=0,0,0deg`",
            {"pose_topic": "/ego", "mounts": ["front_scan=0.3,0.1,30deg"]},
            "world -> base_link -> front_scan; from /ego, --mount",
            id="ambiguous poses",
        ),
    ],
)
def test_an_unknown_mount_or_pose_topic_is_an_error_until_it_is_given(
    bag: Bag, tmp_path: Path, messages: list[made.Message], message: str, options: dict, poses: str
) -> None:
    path = bag(*messages)
    with pytest.raises(RecordingError, match=message):
        open_stream(path)
    assert "its poses are not known" in str(open_recording(path).overview())
    given = options | {"mounts": [parse_mount(text) for text in options["mounts"]]}
    imported = import_recording(path, tmp_path / "posed.mcap", **given)
    assert poses in imported.info.poses
    assert made.walls_stay(imported.scans(), len(imported.survey.sensors) * made.SCANS)
    assert all(f"--mount {text}" in imported.info.command for text in options["mounts"])
    still = open_recording(path, pose_topic="none", topic="/front_scan")
    assert still.overview().warnings == ()
    assert not still.survey.moves


@pytest.mark.parametrize(
    ("messages", "options", "error", "message"),
    [
        pytest.param(
            [*FRONT, *made.moving(ROS, "odom", "base"), *made.poses(ROS, "/ego")],
            {},
            RecordingError,
            r"transforms on /tf \(odom -> base\) do not lead to frame '\w+' of sensor 'front_scan'; it is not recorded"
            r" whether /ego has the poses of the robot with sensor 'front_scan': name the topic",
            id="ambiguous poses, with the reason why the transforms are not used",
        ),
        *(
            pytest.param(
                [*FRONT, STATIC, ROS.odometry(0, SE2())],
                {"pose_topic": topic},
                RecordingError,
                f"no topic '{topic}' with poses; .*/odom",
                id=f"{topic} has no poses",
            )
            for topic in ("/odmo", "/front_scan")
        ),
        pytest.param(
            REAR,
            {"mounts": [parse_mount("rare_scan=0,0,0")]},
            ConfigurationError,
            r"--mount rare_scan=.*no sensor 'rare_scan'; did you mean 'rear_",
            id="a mount of an unknown sensor",
        ),
    ],
)
def test_other_pose_errors_are_one_line(bag: Bag, messages, options: dict, error: type[Exception], message) -> None:
    with pytest.raises(error, match=message):
        open_recording(bag(*messages), **options).check_poses()


def test_a_format_without_frames_has_no_pose_topic_and_no_mounts(tmp_path: Path) -> None:
    (tmp_path / "a.clf").write_text("# CARMEN\n")
    with pytest.raises(RecordingError, match=r"--pose-topic is for recordings with poses on separate topics"):
        open_recording(tmp_path / "a.clf", pose_topic="/odom")
    open_recording(tmp_path / "a.clf", pose_topic=None, mounts=())  # the defaults ask for nothing
    with pytest.raises(RecordingError, match=r"--mount is for recordings with frames in their scans"):
        open_recording(tmp_path / "a.clf", mounts=[parse_mount("scan=0,0,0")])


# ---- errors suggest commands that work


@pytest.mark.parametrize("with_odometry", [False, True])
def test_the_commands_in_the_error_for_several_lasers_import_them(bag: Bag, tmp_path: Path, run, with_odometry) -> None:
    path = bag(*FRONT, *REAR, *(made.odometry(ROS) if with_odometry else ()))
    refused = (
        r"several sensors \(front_scan, rear_scan\) with unknown mounts.*--topic /front_scan.*`, or --topic /rear_"
    )
    with pytest.raises(RecordingError, match=refused) as error:
        import_recording(path, tmp_path / "drive.mcap")
    assert not (tmp_path / "drive.mcap").exists()
    assert any("several sensors" in line for line in open_recording(path).overview().warnings)
    one, both = commands_in(error.value)
    run(both)
    posed = open_recording("a-posed.mcap").overview()
    assert (len(posed.sensors), posed.sensors["front_scan"].moves) == (2, with_odometry)
    run(one)
    assert open_recording("a-one.mcap").survey.moves == with_odometry


def test_a_suggested_command_has_each_mount_once_and_none_of_another_sensor(bag: Bag, tmp_path: Path) -> None:
    path = bag(*FRONT, *REAR, *made.moving(ROS, "odom", "base_link"))
    with pytest.raises(RecordingError, match="several sensors") as error:
        import_recording(path, tmp_path / "a.mcap", mounts=[parse_mount("rear_scan=-0.3,0,180deg,mirrored")])
    one, both = commands_in(error.value)
    assert "rear_scan" not in one
    assert [both.count(f"--mount {name}_scan=") for name in ("front", "rear")] == [1, 1]
    path = bag(*FRONT, STATIC, static(("front_laser", "base_link", SE3())), ROS.odometry(0, SE2()), name="b.bag")
    with pytest.raises(RecordingError, match="frames in a cycle") as error:
        import_recording(path, tmp_path / "b.mcap", mounts=[parse_mount("front_scan=base_link:1,0,0")])
    assert commands_in(error.value)[-1].count("--mount front_scan=") == 1


def test_motion_in_a_second_parent_is_an_error_with_a_command_that_works(bag: Bag, tmp_path: Path, run) -> None:
    pytest.importorskip("kiss_icp")
    later = [message for message in made.moving(ROS, "odom", "camera_link") if message[2] > CAMERA[2]]
    path = bag(*FRONT, STATIC, CAMERA, *later)
    refused = (
        r"is in the transforms on /tf \(odom -> camera_link\), which are not used because 'camera_link' has another"
    )
    with pytest.raises(RecordingError, match=refused) as error:
        import_recording(path, tmp_path / "a.mcap")
    assert any("two parents" in line for line in open_recording(path).overview().warnings)
    (command,) = commands_in(error.value)
    run(command)
    assert open_recording("a-posed.mcap").survey.moves
    assert not open_recording(path, pose_topic="none").survey.moves


def test_unusable_poses_do_not_hinder_an_import_with_poses_from_the_scans(bag: Bag, tmp_path: Path) -> None:
    pytest.importorskip("kiss_icp")
    path = bag(*FRONT, *made.poses(ROS, "/ego", "/other"))
    found = import_recording(path, tmp_path / "a.mcap", ego_motion="kiss-icp")
    assert found.info.poses.startswith("kiss-icp: scans of 'front_scan' matched")
    assert found.overview().warnings == ()
    assert "--pose-topic none" in found.info.command
    assert found.survey.moves
    with pytest.raises(RecordingError, match="not recorded which of /ego, /other has"):
        import_recording(path, tmp_path / "b.mcap", ego_motion="refined")


@pytest.mark.parametrize(("late_ms", "apart"), [(-900_000, r"897\.\d s before"), (1_000_000, r"997\.\d s after")])
def test_poses_with_another_clock_than_the_scans_are_refused(bag: Bag, tmp_path: Path, late_ms: int, apart) -> None:
    pytest.importorskip("kiss_icp")
    poses = [ROS.odometry(at + late_ms, made.robot_at(at)) for at in made.STAMPS_MS]
    received = [(topic, kind, at - late_ms * made.MS, message) for topic, kind, at, message in poses]
    path = bag(*FRONT, STATIC, *received)
    with pytest.raises(RecordingError, match=f"no pose on /odom at the time of a scan: their stamps are {apart}"):
        open_recording(path).overview()
    with pytest.raises(RecordingError, match="with one clock, or import this recording with --ego-motion kiss-icp"):
        import_recording(path, tmp_path / "a.mcap")
    if late_ms < 0:
        assert import_recording(path, tmp_path / "a.mcap", ego_motion="kiss-icp").survey.moves


# ---- several robots, several topics


def two_robots(bag: Bag, *topics: str) -> Path:
    """Two robots with the same frame names; the second one is ahead, and has its transforms on the second topic."""
    first, second = topics
    moving = made.moving(ROS, "odom", "base_link", topic=first)
    moving += made.moving(ROS, "odom", "base_link", topic=second, ahead_ms=2500)
    return bag(STATIC, *moving, *on_topic("/robot1/scan", FRONT), *on_topic("/robot2/scan", FRONT))


@pytest.mark.parametrize(
    ("first", "second"), [("/robot1/tf", "/robot2/tf"), ("/robot1/tf", "/a/tf"), ("/a/tf", "/b/tf")]
)
def test_a_robot_uses_the_transforms_in_the_namespace_of_its_scans_or_the_first(bag: Bag, first, second) -> None:
    recording = open_recording(two_robots(bag, first, second), topic="/robot1/scan")
    assert made.walls_stay(recording.scans())
    assert f"from {first}, /tf_static; longest gap 0.04 s" in recording.info.poses
    (warning,) = recording.overview().warnings
    several = f"transforms of frame 'base_link' are on several topics, {first}, {second}, perhaps of two robots"
    assert f"{several}: sensor 'robot1/scan' uses {first}" in warning
    with pytest.raises(RecordingError, match="on several topics"):
        list(open_recording(recording.path, topic="/robot1/scan", strict=True).scans())


def test_each_of_two_robots_has_its_own_transforms(bag: Bag) -> None:
    path = two_robots(bag, "/robot1/tf", "/robot2/tf")
    here, ahead = (made.robot_at(at) @ made.FRONT.base_T_laser for at in (0, 2500))
    second = open_recording(path, topic="/robot2/scan")
    assert "from /robot2/tf, /tf_static; longest gap 0.04 s" in second.info.poses
    assert same_pose(next(iter(second.scans())).world_T_sensor, ahead)
    both = open_recording(path)
    first = {scan.sensor: scan.world_T_sensor for scan in both.scans() if scan.stamp_ns == made.START_NS}
    assert same_pose(first["robot1/scan"], here)
    assert same_pose(first["robot2/scan"], ahead)
    assert sum("on several topics" in line for line in both.overview().warnings) == 2


def test_of_two_robots_that_record_odom_in_the_robot_the_right_one_is_read_backwards(bag: Bag) -> None:
    other = made.moving(ROS, "base_link", "odom", topic="/robot2/tf", ahead_ms=2500, backwards=True)
    own = made.moving(ROS, "base_link", "odom", topic="/robot1/tf", backwards=True)
    recording = open_recording(bag(*on_topic("/robot1/scan", FRONT), STATIC, *other, *own))
    assert recording.info.poses.startswith("odom -> base_link -> front_laser; from /robot1/tf, /tf_static")
    assert made.walls_stay(recording.scans())


def test_a_robot_at_rest_does_not_stop_another_one(bag: Bag) -> None:
    still = made.at_rest(ROS, "odom", "base_link", topic="/robot1/tf")
    moving = made.moving(ROS, "odom", "base_link", topic="/robot2/tf")
    path = bag(*on_topic("/robot2/scan", FRONT), STATIC, *still, *moving)
    assert made.walls_stay(open_recording(path).scans())
    assert not open_recording(path, pose_topic="none").survey.moves


def test_the_static_transforms_in_the_namespace_of_the_scans_are_used(bag: Bag) -> None:
    other = ROS.transforms(0, ("base_link", "front_laser", SE3.in_plane(SE2(5.0, 0.0, 1.0))), topic="/robot2/tf_static")
    own = ROS.transforms(10, *made.mounts(made.FRONT), topic="/robot1/tf_static")
    moving = made.moving(ROS, "odom", "base_link")
    recording = open_recording(bag(*on_topic("/robot1/scan", FRONT), other, own, *moving))
    assert made.walls_stay(recording.scans())
    (warning,) = recording.overview().warnings
    assert "frame 'front_laser' are on several topics, /robot2/tf_static, /robot1/tf_static" in warning


@pytest.mark.parametrize(
    ("messages", "message"),
    [
        pytest.param(
            [*made.moving(ROS, "odom", "base_link"), *made.at_rest(ROS, "odom", "base_link")],
            r"transforms on /tf of frame 'base_link' differ at one stamp: two sources may send them$",
            id="two sources of a transform",
        ),
        pytest.param(
            [
                ROS.transforms(at, ("map", "base_link", SE3.in_plane(SE2(0.5 * (at // 1000 % 2)) @ made.robot_at(at))))
                for at in made.STAMPS_MS
            ],
            "sensor 'front_scan': its pose jumps: 2 times in the whole recording, by up to 0.50 m and 0 deg",
            id="a localisation that jumps",
        ),
        pytest.param(
            [
                *made.moving(ROS, "odom", "base_link"),
                *on_topic("/filtered", FRONT),
                static(*made.mounts(made.REAR)),
                *REAR,
            ],
            "/front_scan and /filtered have scans in one frame, 'front_laser'.*--topic /front_scan`",
            id="two topics with scans in one frame",
        ),
    ],
)
def test_ambiguous_transforms_are_one_warning(bag: Bag, messages: list[made.Message], message: str) -> None:
    (warning,) = open_recording(bag(*FRONT, STATIC, *messages)).overview().warnings
    assert re.search(message, warning)


@pytest.mark.parametrize("turn_deg", [90, 180, 270])
def test_a_laser_that_is_mounted_turned_has_its_true_mount_as_the_remedy(bag: Bag, run, turn_deg: int) -> None:
    recorded = SE2(made.FRONT.base_T_laser.x, made.FRONT.base_T_laser.y, math.radians(30 - turn_deg))
    static = ROS.transforms(0, ("base_link", "front_laser", SE3.in_plane(recorded)), topic="/tf_static")
    drive = [
        ROS.transforms(at, ("odom", "base_link", SE3.in_plane(made.robot_at(at)))) for at in range(-40, 15_100, 40)
    ]
    path = bag(*made.scans_of(ROS, 15_000, made.FRONT), static, *drive)
    (warning,) = open_recording(path).overview().warnings
    assert (
        f"its poses disagree with its scans, and agree if it is turned by {turn_deg} deg: walls then move 0.0"
        in warning
    )
    assert "--mount front_scan=base_link:0.3,0.1,30deg`" in warning
    assert "refined" not in warning
    (command,) = commands_in(warning)
    run(command)
    assert open_recording("a-posed.mcap").overview().warnings == ()

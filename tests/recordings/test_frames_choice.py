"""Which of the recorded transforms tell how a sensor moves: those above a frame at rest, those of the right robot."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from gridtrack.cli import app
from gridtrack.common.errors import RecordingError
from gridtrack.common.geometry import SE2, same_pose
from gridtrack.recordings import open_recording, parse_mount
from gridtrack.recordings.frames.transform import SE3
from gridtrack.recordings.recording import Recording

from scenes import drive_bag as made

ROS = made.Ros(1)
SCANS = list(made.scans_of(ROS, 3000, made.FRONT))
STATIC = ROS.transforms(0, *made.mounts(made.FRONT), topic="/tf_static")
STAMPS_MS = range(-20, 3100, 20)
ODOM_AT_REST = ("odom", "base_link", SE3())


def walls_stay(recording: Recording) -> bool:
    off = [made.distance_to_walls(scan).max() for scan in recording.scans()]
    return len(off) > 20 and max(off) < 0.02


def driven(parent: str, child: str, topic: str = "/tf", ahead_ms: int = 0) -> list[made.Message]:
    """The place of a robot, at 50 Hz; of one that is `ahead_ms` of the robot with the scans."""
    places = {at: SE3.in_plane(made.robot_at(at + ahead_ms)) for at in STAMPS_MS}
    return [ROS.transforms(at, (parent, child, place), topic=topic) for at, place in places.items()]


@pytest.mark.parametrize("world", ["map", "world"])
def test_a_static_odom_is_no_world_where_it_moves_in_the_frame_above(tmp_path: Path, world: str) -> None:
    still = ROS.transforms(0, ODOM_AT_REST, topic="/tf_static")
    recording = open_recording(ROS.write(tmp_path / "a.bag", [*SCANS, STATIC, still, *driven(world, "odom")]))
    assert recording.info.poses.startswith(f"{world} -> odom -> base_link -> front_laser; from /tf, /tf_static")
    assert recording.survey.moves
    assert recording.overview().warnings == ()
    assert walls_stay(recording)
    assert not open_recording(recording.path, pose_topic="none").survey.moves


def test_a_static_map_is_no_world_where_it_moves_in_the_frame_above(tmp_path: Path) -> None:
    still = ROS.transforms(0, ("map", "odom", SE3()), ODOM_AT_REST, topic="/tf_static")
    recording = open_recording(ROS.write(tmp_path / "a.bag", [*SCANS, STATIC, still, *driven("earth", "map")]))
    assert recording.info.poses.startswith("earth -> map -> odom -> base_link")
    assert walls_stay(recording)


def test_odometry_at_rest_is_kept_and_the_motion_above_it_is_told(tmp_path: Path) -> None:
    still = [ROS.transforms(at, ODOM_AT_REST) for at in STAMPS_MS]
    path = ROS.write(tmp_path / "a.bag", [*SCANS, STATIC, *still, *driven("map", "odom")])
    recording = open_recording(path, strict=True)
    (warning,) = recording.overview().warnings
    assert "the sensors stand still in 'odom', which moves in 'map' by the transforms on /tf: where" in warning
    assert recording.info.poses.startswith("odom -> base_link -> front_laser; ")
    assert not recording.survey.moves
    assert not open_recording(path, pose_topic="none").overview().warnings
    place = f"odom:{made.FRONT.base_T_laser.x},{made.FRONT.base_T_laser.y},30deg"
    assert walls_stay(open_recording(path, mounts=[parse_mount(f"front_scan={place}")]))


def test_the_command_in_the_note_about_motion_above_odom_works(tmp_path: Path, monkeypatch) -> None:
    pytest.importorskip("kiss_icp")
    still = [ROS.transforms(at, ODOM_AT_REST) for at in STAMPS_MS]
    path = ROS.write(tmp_path / "a.bag", [*SCANS, STATIC, *still, *driven("map", "odom")])
    (command,) = re.findall(r"`gridtrack ([^`]*)`", open_recording(path).overview().warnings[0])
    monkeypatch.chdir(tmp_path)
    assert CliRunner().invoke(app, shlex.split(command), catch_exceptions=False).exit_code == 0
    assert open_recording("a-posed.mcap").survey.moves


def two_robots(folder: Path, *topics: str, shared: str = "/tf_static") -> Path:
    """Robots with the same frame names; the first, which has the scans, and then the second on the last topic."""
    static = ROS.transforms(0, *made.mounts(made.FRONT), topic=shared)
    first, second = topics
    messages = [*driven("odom", "base_link", first), *driven("odom", "base_link", second, ahead_ms=2500)]
    scans = [("/robot1/scan", *rest) for _, *rest in SCANS]
    others = [("/robot2/scan", *rest) for _, *rest in SCANS]
    return ROS.write(folder / "a.bag", [static, *messages, *scans, *others])


@pytest.mark.parametrize("second", ["/robot2/tf", "/a/tf"])
def test_of_two_robots_with_the_same_frames_the_transforms_beside_the_scans_are_used(
    tmp_path: Path, second: str
) -> None:
    path = two_robots(tmp_path, "/robot1/tf", second)
    recording = open_recording(path, topic="/robot1/scan")
    assert walls_stay(recording)
    assert "from /robot1/tf, /tf_static; longest gap 0.02 s" in recording.info.poses
    (warning,) = recording.overview().warnings
    told = (
        f"transforms of frame 'base_link' are on several topics, /robot1/tf, {second}, as of two robots: sensor"
        " 'robot1/scan' has those on /robot1/tf"
    )
    assert told in warning
    with pytest.raises(RecordingError, match="on several topics"):
        list(open_recording(path, topic="/robot1/scan", strict=True).scans())


def test_each_of_two_robots_has_its_own_transforms(tmp_path: Path) -> None:
    path = two_robots(tmp_path, "/robot1/tf", "/robot2/tf")
    recording = open_recording(path, topic="/robot2/scan")
    assert "from /robot2/tf, /tf_static; longest gap 0.02 s" in recording.info.poses
    here, ahead = (made.robot_at(at) @ made.FRONT.base_T_laser for at in (0, 2500))
    assert same_pose(next(iter(recording.scans())).world_T_sensor, ahead)
    both = open_recording(path)
    first = {scan.sensor: scan.world_T_sensor for scan in both.scans() if scan.stamp_ns == made.START_NS}
    assert same_pose(first["robot1/scan"], here)
    assert same_pose(first["robot2/scan"], ahead)
    assert sum("on several topics" in line for line in both.overview().warnings) == 2


def test_without_a_topic_beside_the_scans_the_first_one_is_used(tmp_path: Path) -> None:
    recording = open_recording(two_robots(tmp_path, "/a/tf", "/b/tf"), topic="/robot1/scan")
    assert walls_stay(recording)
    assert "from /a/tf, /tf_static" in recording.info.poses


def test_of_two_robots_that_record_odom_on_the_robot_one_is_followed_backwards(tmp_path: Path) -> None:
    messages = []
    for topic, ahead_ms in (("/robot2/tf", 2500), ("/robot1/tf", 0)):
        places = {at: SE3.in_plane(made.robot_at(at + ahead_ms).inverse()) for at in STAMPS_MS}
        messages += [ROS.transforms(at, ("base_link", "odom", place), topic=topic) for at, place in places.items()]
    scans = [("/robot1/scan", *rest) for _, *rest in SCANS]
    recording = open_recording(ROS.write(tmp_path / "a.bag", [*scans, STATIC, *messages]))
    assert recording.info.poses.startswith("odom -> base_link -> front_laser; from /robot1/tf, /tf_static")
    assert walls_stay(recording)


def test_a_robot_that_drives_beside_one_that_stands_is_not_made_to_move(tmp_path: Path) -> None:
    still = [ROS.transforms(at, ("odom", "base_link", SE3()), topic="/robot1/tf") for at in STAMPS_MS]
    scans = [("/robot2/scan", *rest) for _, *rest in SCANS]
    path = ROS.write(tmp_path / "a.bag", [*scans, STATIC, *still, *driven("odom", "base_link", "/robot2/tf")])
    assert walls_stay(open_recording(path))
    assert not open_recording(path, pose_topic="none").survey.moves


def test_the_static_transforms_beside_the_scans_are_used(tmp_path: Path) -> None:
    other = ROS.transforms(0, ("base_link", "front_laser", SE3.in_plane(SE2(5.0, 0.0, 1.0))), topic="/robot2/tf_static")
    own = ROS.transforms(10, *made.mounts(made.FRONT), topic="/robot1/tf_static")
    scans = [("/robot1/scan", *rest) for _, *rest in SCANS]
    recording = open_recording(ROS.write(tmp_path / "a.bag", [*scans, other, own, *driven("odom", "base_link")]))
    assert walls_stay(recording)
    (warning,) = recording.overview().warnings
    assert "frame 'front_laser' are on several topics, /robot2/tf_static, /robot1/tf_static" in warning


def test_equal_static_transforms_on_two_topics_are_no_fault(tmp_path: Path) -> None:
    again = ROS.transforms(10, *made.mounts(made.FRONT), topic="/robot1/tf_static")
    recording = open_recording(ROS.write(tmp_path / "a.bag", [*SCANS, STATIC, again, *driven("odom", "base_link")]))
    assert walls_stay(recording)
    assert recording.overview().warnings == ()

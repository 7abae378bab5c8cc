"""Transforms that are damaged or hostile: one line each, bounded memory, and the scans are read."""

from __future__ import annotations

import contextlib
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gridtrack.common.errors import GridtrackError, RecordingError
from gridtrack.common.geometry import SE2
from gridtrack.recordings import open_recording, parse_mount
from gridtrack.recordings.frames.trajectory import MAX_KEPT, NewestTransforms
from gridtrack.recordings.frames.transform import SE3
from gridtrack.recordings.frames.tree import MAX_FAULTS, MAX_TREE_FRAMES
from gridtrack.recordings.recording import Recording
from gridtrack.recordings.stream import open_stream

from scenes import drive_bag as made

ROS = made.Ros(1)
STATIC = ROS.transforms(0, *made.mounts(made.FRONT), topic="/tf_static")
DRIVE = [
    *made.scans_of(ROS, 3000, made.FRONT),
    STATIC,
    *(ROS.transforms(at, ("odom", "base_link", SE3.in_plane(made.robot_at(at)))) for at in range(-20, 3100, 20)),
]


def opened(tmp_path: Path, *more: made.Message, **options: object) -> Recording:
    return open_recording(ROS.write(tmp_path / "a.bag", [*DRIVE, *more]), **options)


def walls_stay(recording: Recording) -> bool:
    return max(made.distance_to_walls(scan).max() for scan in recording.scans()) < 0.02


def the_warning(recording: Recording) -> str:
    (warning,) = recording.overview().warnings
    assert "\n" not in warning
    return warning


def test_a_cycle_is_one_line(tmp_path: Path) -> None:
    links = [("a", "b", SE3()), ("b", "c", SE3()), ("c", "a", SE3()), ("a", "front_laser", SE3())]
    path = ROS.write(
        tmp_path / "a.bag", [*made.scans_of(ROS, 3000, made.FRONT), ROS.transforms(0, *links, topic="/tf_static")]
    )
    with pytest.raises(RecordingError, match=r"frames in a cycle \(a -> c -> b -> a\): take the poses.*kiss-icp"):
        open_stream(path)
    assert len(list(open_recording(path).scans())) == 30
    assert not open_recording(path, pose_topic="none").overview().warnings


def test_a_second_parent_is_told_and_not_used(tmp_path: Path) -> None:
    recording = opened(tmp_path, ROS.transforms(500, ("map", "front_laser", SE3((5.0, 0.0, 0.0)))))
    assert walls_stay(recording)
    told = "frame 'front_laser' has two parents, 'base_link' on /tf_static and 'map' on /tf: the first is used"
    assert told in the_warning(recording)
    with pytest.raises(RecordingError, match="two parents"):
        list(open_recording(recording.path, strict=True).scans())


@pytest.mark.parametrize("broken", [SE3((math.nan, 0.0, 0.0)), SE3(rotation=(0.0, 0.0, 0.0, 0.0)), SE3((1e300, 0, 0))])
def test_transforms_that_are_none_are_left_out(tmp_path: Path, broken: SE3) -> None:
    recording = opened(tmp_path, ROS.transforms(510, ("odom", "base_link", broken)))
    assert walls_stay(recording)
    assert "transforms on /tf of frame 'base_link' that are not finite or have no rotation" in the_warning(recording)


def test_frames_with_names_that_cannot_be_shown_are_left_out(tmp_path: Path) -> None:
    recording = opened(tmp_path, ROS.transforms(5, ("odom", "red\x1b[31m\nnext", SE3()), ("odom", "x" * 500, SE3())))
    assert walls_stay(recording)
    warnings = recording.overview().warnings
    assert len(warnings) == 2
    assert all(line.isprintable() for line in warnings)


def test_many_frames_and_many_faults_are_bounded(tmp_path: Path) -> None:
    names = [f"frame{k}" for k in range(3 * MAX_TREE_FRAMES)]
    many = ROS.transforms(4000, *(("odom", name, SE3()) for name in names))
    again = ROS.transforms(4010, *(("map", name, SE3()) for name in names))
    recording = opened(tmp_path, many, again)
    assert walls_stay(recording)
    warnings = recording.overview().warnings
    assert len(warnings) == MAX_FAULTS + 1
    assert any(f"more than {MAX_TREE_FRAMES} frames" in line for line in warnings)
    assert warnings[-1].endswith("more faults in the transforms")


@pytest.mark.parametrize("far_ms", [86_400_000, -86_400_000])
@pytest.mark.parametrize("at_ms", [-20, 1500])
def test_a_transform_stamped_a_day_off_is_left_out(tmp_path: Path, far_ms: int, at_ms: int) -> None:
    topic, kind, _, message = ROS.transforms(at_ms + far_ms, ("odom", "base_link", SE3((9.0, 9.0, 0.0))))
    recording = opened(tmp_path, (topic, kind, made.START_NS + at_ms * made.MS - 1, message))
    assert walls_stay(recording)
    assert recording.info.poses.endswith("longest gap 0.02 s")


def test_memory_of_transforms_is_bounded() -> None:
    trajectory = NewestTransforms()
    for k in range(3 * MAX_KEPT):
        trajectory.add(k, SE3())
    found = trajectory.at(3 * MAX_KEPT - 1)
    assert found is not None
    assert len(trajectory) <= 2 * MAX_KEPT


def test_a_tilted_scanner_is_left_out_and_told(tmp_path: Path) -> None:
    tilt = SE3.of((0.0, 0.0, 1.0), Rotation.from_euler("y", 30, degrees=True).as_quat())
    assert tilt is not None
    laser = made.Laser("tilt", SE2())
    more = [*made.scans_of(ROS, 3000, laser), ROS.transforms(0, ("base_link", "tilt_laser", tilt), topic="/tf_static")]
    recording = opened(tmp_path, *more)
    assert walls_stay(recording)
    told = "scans of sensor 'tilt_scan' tilted by more than 15 deg are left out (if its transforms are wrong,"
    assert told in the_warning(recording)
    assert set(recording.survey.sensors) == {"front_scan"}


def test_scans_that_change_their_frame_are_left_out(tmp_path: Path) -> None:
    other = ROS.laser(1250, np.full(181, 2.0, np.float32), made.FRONT, frame="elsewhere")
    recording = opened(tmp_path, other)
    assert walls_stay(recording)
    assert "topic '/front_scan': scans in another frame than the first scan are left out" in the_warning(recording)


def test_a_transform_that_cannot_be_decoded_is_left_out(tmp_path: Path) -> None:
    path = ROS.write(tmp_path / "a.bag", DRIVE)
    content = bytearray(path.read_bytes())
    at = content.index(b"base_link", content.index(b"odom", 2_000)) - 4
    content[at : at + 4] = (10**6).to_bytes(4, "little")
    path.write_bytes(content)
    recording = open_recording(path)
    assert len(list(recording.scans())) == 30
    assert any("a message of /tf cannot be decoded" in line for line in recording.warnings)


def test_scans_without_a_frame_need_a_mount_by_the_name_of_the_sensor(tmp_path: Path) -> None:
    scans = []
    for topic, kind, at, message in made.scans_of(ROS, 3000, made.FRONT):
        message.header.frame_id = ""
        scans.append((topic, kind, at, message))
    poses = [ROS.odometry(at, made.robot_at(at)) for at in range(0, 3100, 20)]
    path = ROS.write(tmp_path / "a.bag", [*scans, *poses])
    with pytest.raises(RecordingError, match="--mount front_scan=0,0,0deg"):
        open_stream(path)
    assert walls_stay(open_recording(path, mounts=[parse_mount("front_scan=0.3,0.1,30deg")]))


def test_static_transforms_that_change_are_told_and_the_first_is_used(tmp_path: Path) -> None:
    recording = opened(tmp_path, ROS.transforms(900, ("base_link", "front_laser", SE3()), topic="/tf_static"))
    assert walls_stay(recording)
    assert "static transforms on /tf_static of frame 'front_laser' change: the first is used" in the_warning(recording)


def test_transforms_of_one_frame_on_two_topics_are_told_and_those_on_the_first_used(tmp_path: Path) -> None:
    drive = [(f"/tf{k % 2}" if topic == "/tf" else topic, *rest) for k, (topic, *rest) in enumerate(DRIVE)]
    recording = open_recording(ROS.write(tmp_path / "a.bag", drive))
    assert walls_stay(recording)
    assert recording.info.poses.endswith("from /tf1, /tf_static; longest gap 0.04 s")
    assert "transforms of frame 'base_link' are on several topics, /tf1, /tf0" in the_warning(recording)


def test_a_file_that_is_cut_gives_the_scans_that_wait_for_their_poses(tmp_path: Path) -> None:
    late = [(topic, kind, at + (400 if topic == "/tf" else 0) * made.MS, message) for topic, kind, at, message in DRIVE]
    path = ROS.write(tmp_path / "a.bag", late)
    content = path.read_bytes()
    path.write_bytes(content[: content.rindex(b"front_laser")])
    recording = open_recording(path)
    before = [scan.stamp_ns for scan in recording.scans()]
    assert "cut off" in recording.damage
    assert len(before) >= 28


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_random_damage_of_a_drive_raises_only_our_errors(tmp_path: Path, data: st.DataObject) -> None:
    whole = tmp_path / "whole.bag"
    if not whole.exists():
        ROS.write(whole, made.two_scanner_drive(ROS, 300))
    content = bytearray(whole.read_bytes())
    for _ in range(data.draw(st.integers(1, 5))):
        content[data.draw(st.integers(4096, len(content) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path / "damaged.bag"
    path.write_bytes(content[: data.draw(st.integers(5000, len(content)))])
    with contextlib.suppress(GridtrackError):
        overview = open_recording(path).overview()
        assert all("\n" not in line for line in overview.warnings)

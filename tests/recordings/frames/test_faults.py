"""Transforms that are damaged, hostile or rare: one line each, bounded memory, and the scans are read."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gridtrack.common.errors import RecordingError
from gridtrack.common.geometry import SE2
from gridtrack.recordings import import_recording, open_recording, parse_mount
from gridtrack.recordings.frames.transform import SE3
from gridtrack.recordings.frames.tree import MAX_FAULTS, MAX_TREE_FRAMES
from gridtrack.recordings.recording import Recording
from gridtrack.recordings.stream import open_stream

from scenes import drive_bag as made

Bag = Callable[..., Path]
ROS = made.Ros(1)
WALL = np.linspace(2.0, 2.5, 181, dtype=np.float32)
FRONT = list(made.scans_of(ROS, made.DURATION_MS, made.FRONT))
STATIC = ROS.transforms(0, *made.mounts(made.FRONT), topic="/tf_static")
MOVING = made.moving(ROS, "odom", "base_link")
DRIVE = [*FRONT, STATIC, *MOVING]
NAN, NO_ROTATION, HUGE = SE3((math.nan, 0.0, 0.0)), SE3(rotation=(0.0, 0.0, 0.0, 0.0)), SE3((1e300, 0, 0))
TILTED = SE3((0.0, 0.0, 1.0), tuple(Rotation.from_euler("y", 30, degrees=True).as_quat().tolist()))
NOT_A_TRANSFORM = "transforms on /tf of frame 'base_link' that are not finite or have no rotation are left out"


def the_warning(recording: Recording) -> str:
    (warning,) = recording.overview().warnings
    assert "\n" not in warning
    return warning


@pytest.mark.parametrize(
    ("fault", "warning"),
    [
        pytest.param(
            [ROS.transforms(500, ("map", "front_laser", SE3((5.0, 0.0, 0.0))))],
            "frame 'front_laser' has two parents, 'base_link' on /tf_static and 'map' on /tf: the first is used",
            id="a second parent",
        ),
        *(
            pytest.param([ROS.transforms(510, ("odom", "base_link", broken))], NOT_A_TRANSFORM, id=name)
            for name, broken in (("NaN", NAN), ("no rotation", NO_ROTATION), ("too far away", HUGE))
        ),
        pytest.param(
            [ROS.transforms(900, ("base_link", "front_laser", SE3()), topic="/tf_static")],
            "static transforms on /tf_static of frame 'front_laser' change: the first is used",
            id="a static transform that changes",
        ),
        pytest.param(
            [ROS.laser(1250, WALL, made.FRONT, frame="elsewhere")],
            "scans on /front_scan in another frame than the first scan are left out: 1 of them",
            id="a scan in another frame",
        ),
        pytest.param(
            [
                *made.scans_of(ROS, made.DURATION_MS, made.Laser("tilt", SE2())),
                ROS.transforms(0, ("base_link", "tilt_laser", TILTED), topic="/tf_static"),
            ],
            "scans of sensor 'tilt_scan' tilted by more than 15 deg are left out (if its transforms are wrong,",
            id="a tilted scanner",
        ),
    ],
)
def test_a_fault_is_one_warning_and_an_error_with_strict(bag: Bag, fault: list[made.Message], warning: str) -> None:
    recording = open_recording(bag(*DRIVE, *fault))
    assert made.walls_stay(recording.scans())
    assert warning in the_warning(recording)
    assert set(recording.survey.sensors) == {"front_scan"}
    with pytest.raises(RecordingError) as error:
        list(open_recording(recording.path, strict=True).scans())
    assert warning in str(error.value)


def test_a_cycle_is_one_line(bag: Bag) -> None:
    links = [("a", "b", SE3()), ("b", "c", SE3()), ("c", "a", SE3()), ("a", "front_laser", SE3())]
    path = bag(*FRONT, ROS.transforms(0, *links, topic="/tf_static"))
    with pytest.raises(RecordingError, match=r"frames in a cycle \(a -> c -> b -> a\): use poses.*kiss-icp"):
        open_stream(path)
    assert len(list(open_recording(path).scans())) == made.SCANS
    assert not open_recording(path, pose_topic="none").overview().warnings


def test_frames_with_names_that_are_not_printable_are_left_out(bag: Bag) -> None:
    unprintable = ROS.transforms(5, ("odom", "red\x1b[31m\nnext", SE3()), ("odom", "x" * 500, SE3()))
    recording = open_recording(bag(*DRIVE, unprintable))
    assert made.walls_stay(recording.scans())
    warnings = recording.overview().warnings
    assert len(warnings) == 2
    assert all(line.isprintable() for line in warnings)


def test_many_frames_and_many_faults_are_bounded(bag: Bag) -> None:
    names = [f"frame{k}" for k in range(2 * MAX_TREE_FRAMES)]
    many = (ROS.transforms(at, *((parent, name, SE3()) for name in names)) for at, parent in ((1, "odom"), (2, "map")))
    recording = open_recording(bag(*DRIVE, *many))
    assert made.walls_stay(recording.scans())
    warnings = recording.overview().warnings
    assert len(warnings) == MAX_FAULTS + 1
    assert any(f"more than {MAX_TREE_FRAMES} frames" in line for line in warnings)
    assert warnings[-1].endswith("more faults in the transforms")


@pytest.mark.parametrize(("at_ms", "far_ms"), [(-40, 86_400_000), (1500, 86_400_000), (1500, -86_400_000)])
def test_a_transform_with_a_stamp_a_day_off_is_left_out(bag: Bag, far_ms: int, at_ms: int) -> None:
    topic, kind, _, message = ROS.transforms(at_ms + far_ms, ("odom", "base_link", SE3((9.0, 9.0, 0.0))))
    recording = open_recording(bag(*DRIVE, (topic, kind, made.START_NS + at_ms * made.MS - 1, message)))
    assert made.walls_stay(recording.scans())
    assert recording.info.poses.endswith("longest gap 0.04 s")


def test_a_recording_with_tilted_scans_alone_is_an_error_unless_its_mount_is_given(bag: Bag) -> None:
    path = bag(*FRONT, ROS.transforms(0, ("base_link", "front_laser", TILTED), topic="/tf_static"))
    with pytest.raises(RecordingError, match=r"no scan can be used: .*tilted by more than 15 deg.*--mount"):
        open_recording(path).overview()
    assert open_recording(path, mounts=[parse_mount("front_scan=0,0,0")]).overview().sensors


def test_a_transform_that_cannot_be_decoded_is_left_out(bag: Bag) -> None:
    path = bag(*DRIVE)
    content = bytearray(path.read_bytes())
    at = content.index(b"base_link", content.index(b"odom", 2_000)) - 4
    content[at : at + 4] = (10**6).to_bytes(4, "little")
    path.write_bytes(content)
    recording = open_recording(path)
    assert len(list(recording.scans())) == made.SCANS
    assert any("a message of /tf cannot be decoded" in line for line in recording.warnings)


def test_the_waiting_scans_of_a_cut_file_are_read(bag: Bag) -> None:
    path = bag(*FRONT, STATIC, *((*rest, at + 400 * made.MS, message) for *rest, at, message in MOVING))
    content = path.read_bytes()
    path.write_bytes(content[: content.rindex(b"front_laser")])
    recording = open_recording(path)
    assert len(list(recording.scans())) >= made.SCANS - 2
    assert "cut off" in recording.damage


# ---- gaps in the poses, and rare transforms


def test_a_gap_in_the_poses_is_a_warning_and_delays_no_scans(bag: Bag) -> None:
    scans = [ROS.laser(k * 100, WALL, made.FRONT) for k in range(100)]
    path = bag(*scans, ROS.odometry(0, SE2()), ROS.odometry(9000, SE2(9.0)))
    recording = open_recording(path, mounts=[parse_mount("front_scan=0,0,0")])
    found = [scan.world_T_sensor.x for scan in recording.scans()]
    assert (len(found), found[5], found[80], found[-1]) == (100, 0.0, 0.0, 9.0)
    assert recording.info.poses.endswith("longest gap 9.00 s")
    (warning,) = recording.warnings
    assert "without poses on /odom (odom -> base_link) within 1 s get the last one before them: 79 of them" in warning
    with pytest.raises(RecordingError, match="without poses on /odom"):
        list(open_recording(path, mounts=[parse_mount("front_scan=0,0,0")], strict=True).scans())


def test_scans_before_the_first_pose_get_the_first_one(bag: Bag) -> None:
    late = [ROS.odometry(at, made.robot_at(at)) for at in range(1500, 2600, 20)]
    recording = open_recording(bag(*FRONT, STATIC, *late))
    first_one = "without poses on /odom (odom -> base_link) within 1 s get the first one after them: 5 of them"
    assert first_one in the_warning(recording)
    first = made.robot_at(1500) @ made.FRONT.base_T_laser
    moved = first.inverse() @ next(iter(recording.scans())).world_T_sensor
    assert (moved.x, moved.y, moved.theta) == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)


def panned(bag: Bag, heading_deg: Mapping[int, float], topic: str = "/tf") -> Recording:
    """Scans of a robot at rest, one a second for 80 s, and the heading of its laser at some times, ms."""
    scans = [ROS.laser(at, WALL, made.FRONT) for at in range(0, 80_000, 1000)]
    rest = [ROS.transforms(at, ("odom", "base_link", SE3())) for at in range(0, 80_000, 1000)]
    joint = [
        ROS.transforms(at, ("base_link", "front_laser", SE3.in_plane(SE2(0.3, 0.0, math.radians(deg)))), topic=topic)
        for at, deg in heading_deg.items()
    ]
    return open_recording(bag(*rest, *joint, *scans))


def test_a_joint_that_is_recorded_every_fifteen_seconds_moves(bag: Bag) -> None:
    recording = panned(bag, {at: at / 1000 for at in range(0, 76_000, 15_000)})
    headings = [round(math.degrees(scan.world_T_sensor.theta)) for scan in recording.scans()]
    assert headings == [15 * (k // 15) for k in range(80)]
    assert "longest gap 15.00 s" in recording.info.poses
    rare = "without poses on /tf (base_link -> front_laser) within 1 s get the last one before them"
    assert any(rare in warning for warning in recording.warnings)


@pytest.mark.parametrize(
    ("heading_deg", "reason"),
    [
        ({0: 10.0}, "is recorded once"),
        ({0: 10.0, 15_000: 10.0, 60_000: 10.0}, "has a gap of 45.0 s"),
        ({0: 10.0, 30_000: 10.0}, "has a gap of 30.0 s"),
        ({0: 10.0, 30_000: 70.0}, "changes after a gap of 30.0 s"),
    ],
)
def test_a_joint_that_is_recorded_more_rarely_is_at_rest_with_a_warning(bag: Bag, heading_deg, reason: str) -> None:
    recording = panned(bag, heading_deg)
    assert {round(math.degrees(scan.world_T_sensor.theta)) for scan in recording.scans()} == {10}
    assert the_warning(recording).endswith(
        f"frame 'front_laser' is assumed to be at rest in 'base_link', but its transform on /tf {reason}: if it moves,"
        " such as a joint that pans or tilts, record it at least once a second"
    )


@pytest.mark.parametrize(("every_ms", "topic"), [(2000, "/tf"), (80_000, "/tf_static")])
def test_a_joint_that_is_recorded_often_or_as_static_is_no_warning(bag: Bag, every_ms: int, topic: str) -> None:
    recording = panned(bag, dict.fromkeys(range(0, 80_000, every_ms), 10.0), topic)
    assert recording.overview().warnings == ()


@pytest.mark.parametrize(
    "broken",
    [
        pytest.param([ROS.transforms(at, ("odom", "base_link", NAN)) for at in made.STAMPS_MS], id="transforms"),
        pytest.param([ROS.transforms(at, ("base_link", "odom", NAN)) for at in made.STAMPS_MS], id="backwards"),
        pytest.param([ROS.odometry(at, SE2(math.nan, 0.0, 0.0)) for at in made.STAMPS_MS], id="odometry"),
        pytest.param([ROS.pose(at, SE2(math.nan, 0.0, 0.0)) for at in made.STAMPS_MS], id="poses"),
    ],
)
def test_poses_that_are_recorded_and_all_unusable_are_refused_with_the_ways_on(
    bag: Bag, broken: list[made.Message], tmp_path: Path
) -> None:
    pytest.importorskip("kiss_icp")
    path = bag(*FRONT, STATIC, *broken)
    problem = open_recording(path).pose_problem
    assert "are not finite or have no rotation: use poses from the scans, with `gridtrack recording import" in problem
    assert "or, if the robot stands still, import the recording with --pose-topic none" in problem
    with pytest.raises(RecordingError, match="are not finite"):
        open_stream(path)
    assert not open_recording(path, pose_topic="none").pose_problem
    assert import_recording(path, tmp_path / "posed.mcap", ego_motion="kiss-icp").survey.moves


def test_unusable_transforms_of_a_frame_beside_the_sensors_do_not_matter(bag: Bag) -> None:
    gripper = [ROS.transforms(at, ("base_link", "gripper", NAN)) for at in made.STAMPS_MS]
    assert open_recording(bag(*FRONT, STATIC, *gripper)).pose_problem == ""


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("a_0.bag", "a_1.bag"),
        ("a_2024-01-01-10-00-00_0.bag", "a_2024-01-01-10-05-00_1.bag"),
        ("2024-01-01-10-00-00_0.bag", "2024-01-01-10-05-00_12.bag"),
    ],
)
def test_a_later_part_of_a_split_recording_has_the_static_transforms_of_the_first(
    bag: Bag, first: str, second: str
) -> None:
    """A recorder that splits writes latched transforms once, into the first part."""
    part = bag(*FRONT, *MOVING, name=second)
    assert "put the first part beside it" in " ".join(open_recording(part).overview().warnings)
    bag(STATIC, *MOVING, name=first)
    recording = open_recording(part)
    assert made.walls_stay(recording.scans())
    assert the_warning(recording).endswith(f"its static transforms are from {first}")


def test_a_number_at_the_end_of_a_name_is_no_split_recording_where_nothing_is_missing(bag: Bag) -> None:
    assert the_poses(bag(*DRIVE, name="lab_3.bag")) == the_poses(bag(*DRIVE)) != ""
    assert open_recording(bag(*FRONT, name="hall_3.bag")).overview().warnings == ()


def the_poses(path: Path) -> str:
    recording = open_recording(path)
    assert recording.overview().warnings == ()
    return recording.info.poses

"""Transforms by stamp: poses are interpolated, wherever the transforms are in the file, and despite damaged stamps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin

from gridtrack.common.geometry import SE2
from gridtrack.recordings import framed_recording, open_recording, parse_mount
from gridtrack.recordings.file_reading import Growth
from gridtrack.recordings.frames import trajectory
from gridtrack.recordings.frames.chains import Chain, Link
from gridtrack.recordings.frames.trajectory import FramedScan, ScansOnChains, Trajectory
from gridtrack.recordings.frames.transform import SE3
from gridtrack.recordings.frames.tree import FarStamps

from scenes import drive_bag as made

SECOND_NS = 10**9


def drive(ros: made.Ros, late_ms: int = 0) -> list[made.Message]:
    """A short drive; its transforms are received `late_ms` after their stamp."""
    moving = made.moving(ros, "odom", "base_link")
    late = [(topic, kind, at_ns + late_ms * made.MS, message) for topic, kind, at_ns, message in moving]
    static = ros.transforms(-20, *made.mounts(made.FRONT), topic="/tf_static")
    return [static, *late, *made.scans_of(ros, made.DURATION_MS, made.FRONT)]


def damaged_scan(ros: made.Ros, far_ms: int) -> made.Message:
    """A scan in the middle of the drive with a stamp far from its time of reception."""
    topic, kind, _, message = ros.laser(1250 + far_ms, np.full(181, 2.0, np.float32), made.FRONT)
    return topic, kind, made.START_NS + 1250 * made.MS, message


def test_the_pose_of_a_scan_is_interpolated(bag: Callable[..., Path]) -> None:
    ros = made.Ros(1)
    scans = [ros.laser(at, np.full(181, 2.0, np.float32), made.FRONT) for at in (0, 50, 100, 125, 300)]
    known = [(40, SE2(1.0, 2.0, 0.0)), (100, SE2(1.6, 2.0, 0.0)), (200, SE2(1.6, 2.0, 1.0))]
    path = bag(*scans, *(ros.odometry(at, pose) for at, pose in known))
    recording = open_recording(path, mounts=[parse_mount("front_scan=0,0,0")])
    poses = [scan.world_T_sensor for scan in recording.scans()]
    # before the first pose the first, then at 1/6, 1, and 1/4 of the way, after the last the last
    expected = [(1.0, 2.0, 0.0), (1.1, 2.0, 0.0), (1.6, 2.0, 0.0), (1.6, 2.0, 0.25), (1.6, 2.0, 1.0)]
    np.testing.assert_allclose([(p.x, p.y, p.theta) for p in poses], expected, atol=1e-9)
    assert recording.warnings == []


@pytest.mark.parametrize("late_ms", [-30_000, -1500, 1500, 60_000])
def test_transforms_anywhere_in_a_finished_file_are_interpolated(bag: Callable[..., Path], late_ms: int) -> None:
    recording = open_recording(bag(*drive(made.Ros(1), late_ms)))
    assert made.walls_stay(recording.scans())
    assert recording.overview().warnings == ()


@pytest.mark.parametrize("far_ms", [-86_400_000, 5_000, 86_400_000])
def test_a_scan_with_a_stamp_far_off_does_not_delay_the_poses_of_others(bag: Callable[..., Path], far_ms: int) -> None:
    ros = made.Ros(1)
    recording = open_recording(bag(*drive(ros, 500), damaged_scan(ros, far_ms)))
    assert made.walls_stay(recording.scans())


@pytest.mark.parametrize("far_ms", [-86_400_000, -5_000, 1_500, 9_000, 86_400_000])
def test_in_a_growing_file_a_scan_with_a_stamp_far_off_does_not_delay_poses(tmp_path: Path, far_ms: int) -> None:
    ros = made.Ros(2)
    messages = [*drive(ros, 500), damaged_scan(ros, far_ms)]
    (path,) = ros.write(tmp_path / "a", messages, StoragePlugin.MCAP).glob("*.mcap")
    assert made.walls_stay(open_recording(path, growth=Growth()).scans())


@pytest.mark.parametrize("growth", [None, Growth()])
def test_scans_far_apart_get_their_poses(tmp_path: Path, growth: Growth | None) -> None:
    """Five scans, one every 15 s, and transforms from 3 s on."""
    ros = made.Ros(2)
    ranges = {at: made.ranges_at(made.FRONT, made.robot_at(at), (9.0, 9.0)) for at in range(0, 60_100, 15_000)}
    scans = [ros.laser(at, ranges[at], made.FRONT) for at in ranges]
    moving = [
        ros.transforms(at, ("odom", "base_link", SE3.in_plane(made.robot_at(at)))) for at in range(3000, 60_200, 40)
    ]
    static = ros.transforms(-20, *made.mounts(made.FRONT), topic="/tf_static")
    (path,) = ros.write(tmp_path / "a", [static, *moving, *scans], StoragePlugin.MCAP).glob("*.mcap")
    _, *placed = open_recording(path, growth=growth).scans()
    assert made.walls_stay(placed, 4)


def test_more_transforms_than_the_limit_are_read_with_the_scans(bag: Callable[..., Path], monkeypatch) -> None:
    path = bag(*drive(made.Ros(1)))
    monkeypatch.setattr(framed_recording, "MAX_TRANSFORMS", 30)
    assert made.walls_stay(open_recording(path).scans())


@pytest.mark.parametrize("topic", ["/scan", "/other"])
@pytest.mark.parametrize("far_ns", [-86_400 * SECOND_NS, -SECOND_NS, 2 * SECOND_NS, 5 * SECOND_NS, 86_400 * SECOND_NS])
def test_scans_do_not_wait_behind_a_scan_with_a_stamp_far_off(scan, far_ns: int, topic: str) -> None:
    """Transforms are received half a second after their stamp."""
    chain = Chain("odom", (Link("base", "odom", "/tf", SE3(), moves=True),))
    placed = ScansOnChains({"/scan": chain, "/other": chain}, [].append)
    found = []
    for k in range(40):
        at_ns = k * SECOND_NS // 10
        found += placed.transform(("/tf", "base"), at_ns - SECOND_NS // 2, SE3((k / 10.0 - 0.5, 0.0, 0.0)))
        scans = {"/scan": at_ns, "/other": at_ns + 1} if k != 10 else {"/scan": at_ns, topic: at_ns + far_ns}
        for own_topic, stamp_ns in scans.items():
            found += placed.scan(FramedScan(own_topic, "base", replace(scan(k), stamp_ns=stamp_ns)))
    correct = [one for one in found if one.stamp_ns != SECOND_NS + far_ns]
    assert len(correct) > 60
    assert [one.world_T_sensor.x for one in correct] == pytest.approx([one.stamp_ns / 1e9 for one in correct], abs=1e-6)


def test_scans_after_a_common_gap_wait_for_their_transforms(scan) -> None:
    placed = ScansOnChains({"/scan": Chain("odom", (Link("base", "odom", "/tf", SE3(), moves=True),))}, [].append)
    found = []
    for at_s in (0, 1, 2, 3, 60, 61, 62):
        found += placed.scan(FramedScan("/scan", "base", replace(scan(0), stamp_ns=at_s * SECOND_NS)))
        found += placed.transform(("/tf", "base"), at_s * SECOND_NS, SE3((float(at_s), 0.0, 0.0)))
    assert [one.world_T_sensor.x for one in [*found, *placed.flush()]] == [0.0, 1.0, 2.0, 3.0, 60.0, 61.0, 62.0]


def test_all_transforms_agree_with_the_newest_ones() -> None:
    rng = np.random.default_rng(1)
    stamps = rng.integers(0, 2 * SECOND_NS, 300)
    in_order, whole = Trajectory(whole=False), Trajectory(whole=True)
    for k, stamp_ns in enumerate(np.concatenate([stamps, stamps[:50]]).tolist()):
        transform = SE3.in_plane(SE2(k / 10.0, 0.0, k / 100.0))
        in_order.add(stamp_ns, transform)
        whole.add(stamp_ns, transform)
    assert len(whole) == len(in_order)
    for stamp_ns in range(-SECOND_NS, 4 * SECOND_NS, SECOND_NS // 17):
        assert whole.at(stamp_ns) == in_order.at(stamp_ns)


def test_all_transforms_include_earlier_ones_after_the_clock_is_set_back() -> None:
    whole = Trajectory(whole=True)
    for x, stamps_s in ((1.0, range(100)), (2.0, range(50, 60)), (3.0, [*range(20), *range(200, 205)])):
        for stamp_s in stamps_s:
            whole.add(stamp_s * SECOND_NS, SE3((x, 0.0, 0.0)))
    found = {at_s: whole.at(at_s * SECOND_NS) for at_s in (5, 55, 80, 150, 202)}
    assert [place.transform.translation[0] for place in found.values() if place] == [1.0, 1.0, 1.0, 1.0, 3.0]
    assert [place.near for place in found.values() if place] == [True, True, True, False, True]


def test_two_damaged_stamps_do_not_restart_the_trajectory() -> None:
    whole = Trajectory(whole=True)
    for stamp_s in [*range(20), 5000, 5001, *range(20, 40)]:
        whole.add(stamp_s * SECOND_NS, SE3((float(stamp_s), 0.0, 0.0)))
    places = [whole.at(at_s * SECOND_NS) for at_s in range(40)]
    assert [place.transform.translation[0] for place in places if place] == list(range(40))
    assert all(place.near for place in places if place)


def test_a_first_stamp_far_off_is_left_out() -> None:
    whole = Trajectory(whole=True)
    for stamp_s in [5000, *range(20)]:
        whole.add(stamp_s * SECOND_NS, SE3((float(stamp_s), 0.0, 0.0)))
    found = whole.at(5000 * SECOND_NS)
    assert found is not None
    assert found.transform.translation[0] == 19.0


def test_memory_of_transforms_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trajectory, "MAX_KEPT", 1000)
    newest = Trajectory(whole=False)
    for k in range(2010):
        newest.add(k, SE3())
    assert newest.at(2000) is not None
    assert len(newest) <= 1010


@pytest.mark.parametrize(
    ("stamps_s", "judged"),
    [
        ((0, 15, 30, 31, 60, 90, 5000, 91), ["near", "held", "confirmed", "near", "near", "near", "held", "near"]),
        ((0, 1, 5000, 9000, 2, 3, 4), ["near", "near", "held", "confirmed", "held", "restarted", "near"]),
    ],
    ids=["stamps with gaps are correct", "stamps after two damaged ones are correct"],
)
def test_damaged_stamps_are_distinguished_from_gaps(stamps_s: tuple[int, ...], judged: list[str]) -> None:
    far = FarStamps()
    assert [far.judge(at_s * SECOND_NS) for at_s in stamps_s] == judged

"""Transforms that come late in the file, and scans with a damaged stamp: poses are interpolated all the same."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin

from gridtrack.common.geometry import SE2
from gridtrack.recordings import framed_recording, open_recording
from gridtrack.recordings.file_reading import Growth
from gridtrack.recordings.frames.chains import Chain, Link
from gridtrack.recordings.frames.trajectory import AllTransforms, FramedScan, NewestTransforms, ScansOnChains
from gridtrack.recordings.frames.transform import SE3
from gridtrack.recordings.recording import Recording

from scenes import drive_bag as made

ROS = made.Ros(1)
SECOND_NS = 10**9


def drive(ros: made.Ros, late_ns: int = 0, duration_ms: int = 6000) -> list[made.Message]:
    """A drive whose transforms are received `late_ns` after their stamp."""
    moving = [
        (topic, kind, at_ns + late_ns, message)
        for at in range(-20, duration_ms + 100, 20)
        for topic, kind, at_ns, message in [ros.transforms(at, ("odom", "base_link", SE3.in_plane(made.robot_at(at))))]
    ]
    static = ros.transforms(-20, *made.mounts(made.FRONT), topic="/tf_static")
    return [static, *moving, *made.scans_of(ros, duration_ms, made.FRONT)]


def damaged_scan(ros: made.Ros, at_ms: int, far_ms: int) -> made.Message:
    """A scan that is received at a time and stamped far from it."""
    topic, kind, _, message = ros.laser(at_ms + far_ms, np.full(181, 2.0, np.float32), made.FRONT)
    return topic, kind, made.START_NS + at_ms * made.MS, message


def walls_stay(recording: Recording, scans: int = 60) -> bool:
    off = [made.distance_to_walls(scan).max() for scan in recording.scans()]
    return len(off) == scans and max(off) < 0.02


@pytest.mark.parametrize("late_ms", [-30_000, -1500, 500, 1500, 60_000])
def test_transforms_anywhere_in_a_finished_file_are_interpolated(tmp_path: Path, late_ms: int) -> None:
    recording = open_recording(ROS.write(tmp_path / "a.bag", drive(ROS, late_ms * made.MS)))
    assert walls_stay(recording)
    assert recording.overview().warnings == ()


@pytest.mark.parametrize("far_ms", [-86_400_000, 5_000, 86_400_000])
def test_a_scan_stamped_far_off_does_not_make_the_poses_of_others_lag(tmp_path: Path, far_ms: int) -> None:
    messages = [*drive(ROS, 500 * made.MS), damaged_scan(ROS, 2050, far_ms)]
    recording = open_recording(ROS.write(tmp_path / "a.bag", messages))
    assert walls_stay(recording)


@pytest.mark.parametrize("far_ms", [-86_400_000, -5_000, 1_500, 5_000, 9_000, 86_400_000])
def test_a_scan_stamped_far_off_does_not_make_poses_lag_in_a_file_that_grows(tmp_path: Path, far_ms: int) -> None:
    ros = made.Ros(2)
    messages = [*drive(ros, 500 * made.MS), damaged_scan(ros, 2050, far_ms)]
    (path,) = ros.write(tmp_path / "a", messages, StoragePlugin.MCAP).glob("*.mcap")
    assert walls_stay(open_recording(path, growth=Growth()))


@pytest.mark.parametrize("topic", ["/scan", "/other"])
@pytest.mark.parametrize("far_ns", [-86_400 * SECOND_NS, -SECOND_NS, 2 * SECOND_NS, 5 * SECOND_NS, 86_400 * SECOND_NS])
def test_scans_do_not_wait_behind_one_stamped_far_off(scan, far_ns: int, topic: str) -> None:
    """Transforms come half a second after their stamp."""
    chain = Chain("odom", (Link("base", "odom", "/tf", SE3(), moves=True),))
    placed = ScansOnChains({"/scan": chain, "/other": chain}, [].append)
    found = []
    for k in range(40):
        at_ns = k * SECOND_NS // 10
        found += placed.transform(("/tf", "base"), at_ns - SECOND_NS // 2, SE3((k / 10.0 - 0.5, 0.0, 0.0)))
        scans = {"/scan": at_ns, "/other": at_ns + 1} if k != 10 else {"/scan": at_ns, topic: at_ns + far_ns}
        for of, stamp_ns in scans.items():
            found += placed.scan(FramedScan(of, "base", replace(scan(k), stamp_ns=stamp_ns)))
    correct = [one for one in found if one.stamp_ns != SECOND_NS + far_ns]
    assert len(correct) > 60
    assert [one.world_T_sensor.x for one in correct] == pytest.approx([one.stamp_ns / 1e9 for one in correct], abs=1e-6)


def test_scans_after_a_gap_in_all_of_them_wait_for_their_transforms(scan) -> None:
    placed = ScansOnChains({"/scan": Chain("odom", (Link("base", "odom", "/tf", SE3(), moves=True),))}, [].append)
    found = []
    for at_s in (0, 1, 2, 3, 60, 61, 62):
        found += placed.scan(FramedScan("/scan", "base", replace(scan(0), stamp_ns=at_s * SECOND_NS)))
        found += placed.transform(("/tf", "base"), at_s * SECOND_NS, SE3((float(at_s), 0.0, 0.0)))
    assert [one.world_T_sensor.x for one in [*found, *placed.flush()]] == [0.0, 1.0, 2.0, 3.0, 60.0, 61.0, 62.0]


@pytest.mark.parametrize("growth", [None, Growth()])
def test_scans_that_are_far_from_one_another_have_their_poses(tmp_path: Path, growth: Growth | None) -> None:
    ros = made.Ros(2)
    scans = [message for k, message in enumerate(made.scans_of(ros, 60_100, made.FRONT)) if k % 150 == 0]
    transforms = [message for message in drive(ros, duration_ms=60_100) if message[0].startswith("/tf")]
    (path,) = ros.write(tmp_path / "a", [*transforms[:1], *transforms[200:], *scans], StoragePlugin.MCAP).glob("*.mcap")
    off = [made.distance_to_walls(scan).max() for scan in open_recording(path, growth=growth).scans()]
    assert len(off) == 5
    assert max(off[1:]) < 0.02


def test_more_transforms_than_are_kept_are_read_with_the_scans(tmp_path: Path, monkeypatch) -> None:
    path = ROS.write(tmp_path / "a.bag", drive(ROS))
    monkeypatch.setattr(framed_recording, "MAX_TRANSFORMS", 100)
    assert walls_stay(open_recording(path))


def test_a_whole_trajectory_is_that_of_transforms_in_order() -> None:
    rng = np.random.default_rng(1)
    stamps = rng.integers(0, 2 * SECOND_NS, 300)
    in_order, whole = NewestTransforms(), AllTransforms()
    for k, stamp_ns in enumerate(np.concatenate([stamps, stamps[:50]]).tolist()):
        transform = SE3.in_plane(SE2(k / 10.0, 0.0, k / 100.0))
        in_order.add(stamp_ns, transform)
        whole.add(stamp_ns, transform)
    assert len(whole) == len(in_order)
    for stamp_ns in range(-SECOND_NS, 4 * SECOND_NS, SECOND_NS // 17):
        assert whole.at(stamp_ns) == in_order.at(stamp_ns)


def test_a_whole_trajectory_keeps_what_came_before_the_clock_was_set_back() -> None:
    whole = AllTransforms()
    for x, stamps_s in ((1.0, range(100)), (2.0, range(50, 60)), (3.0, [*range(20), *range(200, 205)])):
        for stamp_s in stamps_s:
            whole.add(stamp_s * SECOND_NS, SE3((x, 0.0, 0.0)))
    found = {at_s: whole.at(at_s * SECOND_NS) for at_s in (5, 55, 80, 150, 202)}
    assert [place.transform.translation[0] for place in found.values() if place] == [1.0, 1.0, 1.0, 1.0, 3.0]
    assert [place.near for place in found.values() if place] == [True, True, True, False, True]


def test_a_whole_trajectory_is_not_that_of_two_damaged_stamps() -> None:
    whole = AllTransforms()
    for stamp_s in [*range(20), 5000, 5001, *range(20, 40)]:
        whole.add(stamp_s * SECOND_NS, SE3((float(stamp_s), 0.0, 0.0)))
    places = [whole.at(at_s * SECOND_NS) for at_s in range(40)]
    assert [place.transform.translation[0] for place in places if place] == list(range(40))
    assert all(place.near for place in places if place)


def test_a_first_stamp_far_off_is_left_out_of_a_whole_trajectory() -> None:
    whole = AllTransforms()
    for stamp_s in [5000, *range(20)]:
        whole.add(stamp_s * SECOND_NS, SE3((float(stamp_s), 0.0, 0.0)))
    found = whole.at(5000 * SECOND_NS)
    assert found is not None
    assert found.transform.translation[0] == 19.0

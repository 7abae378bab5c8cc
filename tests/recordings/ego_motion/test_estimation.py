"""Poses from scans: exact to centimetres where walls surround the sensor, and told where they cannot be found."""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from gridtrack.cli import app
from gridtrack.common.errors import RecordingError
from gridtrack.common.geometry import SE2, same_pose, wrap_angle
from gridtrack.common.scan import Scan
from gridtrack.common.scene import UNLABELLED, Outline, Scene
from gridtrack.recordings import import_recording, open_recording
from gridtrack.recordings.ego_motion import MatchedTrajectory, MatchingSettings, PoseSource, matched_trajectory

from scenes.drives import CORRIDOR, FIELD, PERIOD_S, ROOM, around, drive, one_way, still, straight

SCANS = 120


def trajectory(scans: Sequence[Scan], source: PoseSource) -> MatchedTrajectory:
    return matched_trajectory(scans, source, MatchingSettings())


def without_poses(scans: Sequence[Scan]) -> list[Scan]:
    """The scans with the first one's true pose, as if no poses were recorded."""
    begin = scans[0].reference_T_sensor or SE2()
    return [replace(scan, world_T_sensor=begin) for scan in scans]


def largest_errors(scans: Sequence[Scan], poses: Sequence[SE2]) -> tuple[float, float]:
    """Of the position, metres, and of the heading, degrees, against the true poses."""
    off = [(scan.reference_T_sensor or SE2()).inverse() @ pose for scan, pose in zip(scans, poses, strict=True)]
    return max(math.hypot(o.x, o.y) for o in off), max(abs(math.degrees(wrap_angle(o.theta))) for o in off)


def outcomes(found: MatchedTrajectory) -> Counter[str]:
    return Counter(quality.outcome for quality in found.qualities)


def distance_driven(poses: Sequence[SE2]) -> float:
    return sum(math.hypot(b.x - a.x, b.y - a.y) for a, b in pairwise(poses))


def test_matching_removes_the_drift_of_odometry_in_a_room() -> None:
    scans = drive(ROOM, around, SCANS, odometry_noise=0.1)
    drifted = largest_errors(scans, [scan.world_T_sensor for scan in scans])
    position_m, heading_deg = largest_errors(scans, trajectory(scans, "refined").matched)
    assert drifted[0] > 0.3
    assert position_m < 0.03
    assert heading_deg < 0.5


def test_scans_alone_give_the_poses_in_a_room() -> None:
    scans = drive(ROOM, around, SCANS)
    found = trajectory(without_poses(scans), "kiss-icp")
    position_m, heading_deg = largest_errors(scans, found.matched)
    assert position_m < 0.03
    assert heading_deg < 0.5
    assert outcomes(found) == {"start": 1, "matched": SCANS - 1}
    assert 0.005 < float(np.median([q.residual_m for q in found.qualities])) < 0.03


def with_dark_walls(scans: Sequence[Scan]) -> list[Scan]:
    """The scans with every second sector without a return, others in each scan: they seem free, and walls to come."""
    rng, sector = np.random.default_rng(0), np.arange(len(scans[0].ranges)) // 30
    lost = [rng.permutation(sector[-1] + 1) % 2 > 0 for _ in scans]
    return [
        replace(one, ranges=np.where(of[sector], np.inf, one.ranges).astype(np.float32))
        for one, of in zip(scans, lost, strict=True)
    ]


def test_walls_that_return_nothing_now_and_then_are_matched_though_they_seem_to_move() -> None:
    scans = with_dark_walls(drive(ROOM, around, SCANS))
    found = trajectory(without_poses(scans), "kiss-icp")
    assert largest_errors(scans, found.matched)[0] < 0.05
    assert outcomes(found)["matched"] > 0.95 * SCANS


def test_stamps_that_come_in_bursts_do_not_throw_scans_alone_off() -> None:
    """Every second scan is stamped a millisecond before the next one, as by a program that logs with delays."""
    scans = without_poses(drive(ROOM, around, SCANS))
    late = [
        replace(scan, stamp_ns=scan.stamp_ns + (k % 2) * round((PERIOD_S - 0.001) * 1e9))
        for k, scan in enumerate(scans)
    ]
    found = trajectory(late, "kiss-icp")
    position_m, heading_deg = largest_errors(scans, found.matched)
    assert position_m < 0.05
    assert heading_deg < 0.5
    assert outcomes(found) == {"start": 1, "matched": SCANS - 1}


@pytest.mark.parametrize("source", ["refined", "kiss-icp"])
def test_a_crowd_that_walks_one_way_does_not_drag_the_pose(source: PoseSource) -> None:
    scans = drive(ROOM, around, SCANS, crowd=one_way, odometry_noise=0.1)
    found = trajectory(scans if source == "refined" else without_poses(scans), source)
    position_m, heading_deg = largest_errors(scans, found.matched)
    assert position_m < 0.06  # the crowd walks 14 m
    assert heading_deg < 0.6
    assert np.mean([q.inlier_share for q in found.qualities[20:]]) < 0.9  # its returns are not counted as inliers


def test_along_a_corridor_the_pose_is_that_of_odometry_and_across_it_is_matched() -> None:
    scans = drive(CORRIDOR, straight, SCANS, odometry_noise=0.1)
    found = trajectory(scans, "refined")
    assert outcomes(found) == {"start": 1, "partial": SCANS - 1}
    off = [(s.reference_T_sensor or SE2()).inverse() @ p for s, p in zip(scans, found.matched, strict=True)]
    assert max(abs(o.y) for o in off) < 0.05
    assert max(abs(math.degrees(o.theta)) for o in off) < 0.5
    odometry = [scan.world_T_sensor for scan in scans]
    assert largest_errors(scans, odometry)[1] > 3.0
    assert distance_driven(found.matched) == pytest.approx(distance_driven(odometry), rel=0.01)


def test_over_an_empty_field_the_poses_are_those_of_odometry() -> None:
    scans = drive(FIELD, straight, 30, odometry_noise=0.1)
    found = trajectory(scans, "refined")
    assert outcomes(found) == {"start": 1, "few-returns": 29}
    for scan, pose in zip(scans, found.matched, strict=True):
        assert same_pose(pose, scan.world_T_sensor)
    assert "96.7% of them, 2.9 s, use the recorded motion instead of the match" in found.describe("refined")


def test_scans_of_another_place_are_not_matched() -> None:
    scans = drive(ROOM, around, 30)
    elsewhere = np.random.default_rng(0).uniform(0.5, 9.0, (5, scans[0].ranges.size)).astype(np.float32)
    for k in range(5):
        scans[20 + k] = replace(scans[20 + k], ranges=elsewhere[k])
    found = trajectory(scans, "refined")
    assert {quality.outcome for quality in found.qualities[20:25]} == {"few-inliers"}
    assert {quality.outcome for quality in found.qualities[25:]} == {"matched"}
    assert largest_errors(scans, found.matched)[0] < 0.03


def test_scans_that_match_nothing_continue_the_last_motion_for_a_second_only() -> None:
    scans = [
        scan if k < 40 else replace(scan, ranges=np.full_like(scan.ranges, np.inf))
        for k, scan in enumerate(without_poses(drive(ROOM, straight, 80)))
    ]
    found = trajectory(scans, "kiss-icp")
    assert {quality.outcome for quality in found.qualities[40:]} == {"few-returns"}
    coasted = found.matched[-1].x - found.matched[39].x
    assert 0.6 < coasted < 1.1  # 0.8 m/s
    assert found.matched[-1] == found.matched[-20]


def test_a_scan_that_is_skewed_by_the_motion_is_straightened_by_its_beam_times() -> None:
    scans = drive(ROOM, around, SCANS, beam_s=0.9 * PERIOD_S / 541)
    straightened = largest_errors(scans, trajectory(scans, "refined").matched)
    skewed = largest_errors(scans, trajectory([replace(s, time_increment_s=0.0) for s in scans], "refined").matched)
    assert straightened[0] < 0.06
    assert skewed[0] > 2 * straightened[0]
    assert skewed[1] > 2 * straightened[1]


@pytest.mark.parametrize("static", [ROOM, FIELD], ids=["room", "field"])
def test_a_crowd_that_hides_the_walls_is_told_and_odometry_followed(static: tuple[Outline, ...]) -> None:
    scans = drive(static, around, SCANS, crowd=partial(one_way, people=40), odometry_noise=0.1)
    found = trajectory(scans, "refined")
    drifted, _ = largest_errors(scans, [scan.world_T_sensor for scan in scans])
    position_m, _ = largest_errors(scans, found.matched)
    assert position_m < drifted + 0.6  # the crowd walks 14 m, half of a metre of it before it is told
    assert sum(quality.failed for quality in found.qualities) > SCANS / 2


@pytest.mark.parametrize("crowded", [False, True])
def test_a_sensor_that_stands_is_given_no_jitter(write, tmp_path: Path, crowded: bool) -> None:
    source = write(drive(ROOM, still, 60, **({"crowd": one_way} if crowded else {})))
    imported = import_recording(source, tmp_path / "out.mcap", ego_motion="kiss-icp")
    assert not imported.survey.moves
    assert imported.info.poses.endswith("the sensor is at rest")


def test_an_import_says_where_the_poses_come_from_and_gives_the_same_bytes_again(write, tmp_path: Path) -> None:
    source = write([replace(s, reference_T_sensor=None) for s in drive(ROOM, around, 60, odometry_noise=0.1)])
    out = ["--out", str(tmp_path / "out.mcap"), "--overwrite"]
    arguments = ["recording", "import", str(source), *out, "--ego-motion", "refined"]
    runs = []
    for _ in range(2):
        done = CliRunner().invoke(app, arguments)
        assert done.exit_code == 0, done.output
        runs.append((tmp_path / "out.mcap").read_bytes())
    assert "poses: refined: scans of 'scan' matched; median residual 0.0" in done.output
    assert runs[0] == runs[1]
    imported = open_recording(tmp_path / "out.mcap")
    assert imported.info.command.endswith("--ego-motion refined")
    assert [s.pose_quality.outcome for s in imported.scans() if s.pose_quality] == ["start", *["matched"] * 59]


def test_a_second_sensor_keeps_its_place_on_the_first(write, tmp_path: Path) -> None:
    mount = SE2(-0.8, 0.1, math.pi)
    front = drive(ROOM, around, 40, odometry_noise=0.1, sensor="front")
    rear = drive(ROOM, around, 40, odometry_noise=0.1, sensor="rear", mount=mount)
    source = write(scan for pair in zip(front, rear, strict=True) for scan in pair)
    imported = list(import_recording(source, tmp_path / "out.mcap", ego_motion="refined").scans())
    ahead = [scan for scan in imported if scan.sensor == "front"]
    behind = [scan for scan in imported if scan.sensor == "rear"]
    assert all(scan.pose_quality is None for scan in behind)
    for one, other in zip(ahead, behind, strict=True):
        assert same_pose(one.world_T_sensor @ mount, other.world_T_sensor)


def test_where_truth_is_known_the_recorded_poses_become_the_reference(write, tmp_path: Path) -> None:
    scene = Scene(ROOM, UNLABELLED, ())
    made = [replace(s, scene=scene, reference_T_sensor=None) for s in drive(ROOM, around, 20)]
    imported = import_recording(write(made), tmp_path / "out.mcap", ego_motion="kiss-icp")
    for found, source in zip(imported.scans(), made, strict=True):
        assert found.reference_T_sensor is not None
        assert same_pose(found.reference_T_sensor, source.world_T_sensor)


def test_without_kiss_icp_the_extra_is_named(write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "kiss_icp.mapping", None)
    with pytest.raises(RecordingError, match=r"pip install 'gridtrack\[ego-motion\]'"):
        import_recording(write(drive(ROOM, still, 2)), tmp_path / "out.mcap", ego_motion="kiss-icp")
    assert not (tmp_path / "out.mcap").exists()

"""Poses from scans: exact to centimetres if walls surround the sensor, else with a note that they are not."""

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
from gridtrack.recordings.ego_motion import MatchedTrajectory, matched_trajectory

from scenes.drives import (
    BARE_STREET,
    CAR,
    CORRIDOR,
    FIELD,
    PERIOD_S,
    ROOM,
    STREET,
    around,
    away,
    car_in_front,
    drive,
    one_way,
    still,
    straight,
)

SCANS, LONGER = 60, 90


def true_pose(scan: Scan) -> SE2:
    return scan.reference_T_sensor or SE2()


def refined(scans: Sequence[Scan]) -> MatchedTrajectory:
    """With odometry."""
    return matched_trajectory(scans, "refined")


def alone(scans: Sequence[Scan]) -> MatchedTrajectory:
    """Without odometry: every scan has the first true pose."""
    first = true_pose(scans[0])
    return matched_trajectory([replace(scan, world_T_sensor=first) for scan in scans], "kiss-icp")


def errors(scans: Sequence[Scan], poses: Sequence[SE2]) -> list[SE2]:
    return [true_pose(scan).inverse() @ pose for scan, pose in zip(scans, poses, strict=True)]


def largest_errors(scans: Sequence[Scan], poses: Sequence[SE2]) -> tuple[float, float]:
    """Of the position, metres, and of the heading, degrees."""
    off = errors(scans, poses)
    return max(math.hypot(o.x, o.y) for o in off), max(abs(math.degrees(wrap_angle(o.theta))) for o in off)


def outcomes(found: MatchedTrajectory) -> Counter[str]:
    return Counter(quality.outcome for quality in found.qualities)


def distance_driven(poses: Sequence[SE2]) -> float:
    return sum(math.hypot(b.x - a.x, b.y - a.y) for a, b in pairwise(poses))


def test_matching_removes_the_drift_of_odometry_in_a_room() -> None:
    scans = drive(ROOM, around, SCANS, odometry_noise=0.1)
    drifted = largest_errors(scans, [scan.world_T_sensor for scan in scans])
    position_m, heading_deg = largest_errors(scans, refined(scans).matched)
    assert drifted[0] > 0.3
    assert position_m < 0.03
    assert heading_deg < 0.5


def test_scans_alone_give_the_poses_in_a_room() -> None:
    scans = drive(ROOM, around, SCANS)
    found = alone(scans)
    position_m, heading_deg = largest_errors(scans, found.matched)
    assert position_m < 0.03
    assert heading_deg < 0.5
    assert outcomes(found) == {"start": 1, "matched": SCANS - 1}
    assert 0.005 < float(np.median([q.residual_m for q in found.qualities])) < 0.03


def with_dark_walls(scans: Sequence[Scan]) -> list[Scan]:
    """The scans without returns in half of the sectors, which change from scan to scan: walls seem to come and go."""
    rng, sector = np.random.default_rng(0), np.arange(len(scans[0].ranges)) // 30
    lost = [rng.permutation(sector[-1] + 1) % 2 > 0 for _ in scans]
    return [
        replace(one, ranges=np.where(of[sector], np.inf, one.ranges).astype(np.float32))
        for one, of in zip(scans, lost, strict=True)
    ]


def test_walls_that_sometimes_return_nothing_are_matched_although_they_seem_to_move() -> None:
    scans = with_dark_walls(drive(ROOM, around, LONGER))
    found = alone(scans)
    assert largest_errors(scans, found.matched)[0] < 0.05
    assert outcomes(found)["matched"] > 0.95 * LONGER


def test_stamps_in_bursts_do_not_disturb_scans_alone() -> None:
    """Every second stamp is a millisecond before the next one, as of a program that logs with delays."""
    scans = drive(ROOM, around, SCANS)
    late = [
        replace(scan, stamp_ns=scan.stamp_ns + (k % 2) * round((PERIOD_S - 0.001) * 1e9))
        for k, scan in enumerate(scans)
    ]
    found = alone(late)
    position_m, heading_deg = largest_errors(scans, found.matched)
    assert position_m < 0.05
    assert heading_deg < 0.5
    assert outcomes(found) == {"start": 1, "matched": SCANS - 1}


@pytest.mark.parametrize("estimate", [refined, alone])
def test_a_crowd_that_walks_one_way_does_not_drag_the_pose(estimate) -> None:
    scans = drive(ROOM, around, SCANS, crowd=one_way, odometry_noise=0.1)
    found = estimate(scans)
    position_m, heading_deg = largest_errors(scans, found.matched)
    assert position_m < 0.06  # the crowd walks 7 m
    assert heading_deg < 0.6
    assert np.mean([q.inlier_share for q in found.qualities[20:]]) < 0.9  # its returns are not counted as inliers


def test_along_a_corridor_the_pose_follows_odometry_and_across_it_the_scans() -> None:
    scans = drive(CORRIDOR, straight, SCANS, odometry_noise=0.1)
    found = refined(scans)
    assert outcomes(found) == {"start": 1, "partial": SCANS - 1}
    off = errors(scans, found.matched)
    assert max(abs(o.y) for o in off) < 0.05
    assert max(abs(math.degrees(o.theta)) for o in off) < 0.5
    odometry = [scan.world_T_sensor for scan in scans]
    assert largest_errors(scans, odometry)[1] > 3.0
    assert distance_driven(found.matched) == pytest.approx(distance_driven(odometry), rel=0.01)


def test_on_an_empty_field_the_poses_are_odometry() -> None:
    scans = drive(FIELD, straight, 30, odometry_noise=0.1)
    found = refined(scans)
    assert outcomes(found) == {"start": 1, "few-returns": 29}
    for scan, pose in zip(scans, found.matched, strict=True):
        assert same_pose(pose, scan.world_T_sensor)
    assert "96.7% of them, 2.9 s, use the recorded motion instead of the match" in found.describe("refined")


def test_scans_of_another_place_are_not_matched() -> None:
    scans = drive(ROOM, around, 30)
    elsewhere = np.random.default_rng(0).uniform(0.5, 9.0, (5, scans[0].ranges.size)).astype(np.float32)
    for k in range(5):
        scans[20 + k] = replace(scans[20 + k], ranges=elsewhere[k])
    found = refined(scans)
    assert {quality.outcome for quality in found.qualities[20:25]} == {"few-inliers"}
    assert {quality.outcome for quality in found.qualities[25:]} == {"matched"}
    assert largest_errors(scans, found.matched)[0] < 0.03


def test_the_last_motion_continues_for_a_second_without_a_match() -> None:
    scans = [
        scan if k < 40 else replace(scan, ranges=np.full_like(scan.ranges, np.inf))
        for k, scan in enumerate(drive(ROOM, straight, 80))
    ]
    found = alone(scans)
    assert {quality.outcome for quality in found.qualities[40:]} == {"few-returns"}
    coasted = found.matched[-1].x - found.matched[39].x
    assert 0.6 < coasted < 1.1  # 0.8 m/s
    assert found.matched[-1] == found.matched[-20]


def test_beam_times_deskew_a_scan() -> None:
    scans = drive(ROOM, around, SCANS, beam_s=0.9 * PERIOD_S / 541)
    deskewed = largest_errors(scans, refined(scans).matched)
    skewed = largest_errors(scans, refined([replace(s, time_increment_s=0.0) for s in scans]).matched)
    assert deskewed[0] < 0.06
    assert skewed[0] > 2 * deskewed[0]
    assert skewed[1] > 2 * deskewed[1]


@pytest.mark.parametrize("static", [ROOM, FIELD], ids=["room", "field"])
def test_odometry_is_followed_if_a_crowd_hides_the_walls(static: tuple[Outline, ...]) -> None:
    scans = drive(static, around, SCANS, crowd=partial(one_way, people=40), odometry_noise=0.1)
    found = refined(scans)
    drifted, _ = largest_errors(scans, [scan.world_T_sensor for scan in scans])
    position_m, _ = largest_errors(scans, found.matched)
    assert position_m < drifted + 0.6  # the crowd walks 7 m, half a metre of it before the drift is noticed
    assert sum(quality.failed for quality in found.qualities) > SCANS / 2


# ---- along a street


def last_error_m(scans: Sequence[Scan], found: MatchedTrajectory) -> float:
    off = errors(scans, found.matched)[-1]
    return math.hypot(off.x, off.y)


def behind_a_car(street: tuple[Outline, ...], odometry_noise: float = 0.0) -> list[Scan]:
    return drive(street, away, LONGER, crowd=car_in_front, body=CAR, odometry_noise=odometry_noise)


def test_a_car_in_front_does_not_drag_the_pose() -> None:
    """Along a street only the car constrains the motion, once the last pillars are behind."""
    scans = behind_a_car(STREET)
    found = alone(scans)
    driven = away((LONGER - 1) * 0.1).x
    assert driven > 30.0
    assert last_error_m(scans, found) < 0.1 * driven
    assert [quality.outcome for quality in found.qualities[:20]] == ["start", *["matched"] * 19]
    assert found.qualities[-1].outcome == "partial"


def test_the_description_says_that_the_scans_do_not_constrain_the_motion() -> None:
    found = alone(behind_a_car(BARE_STREET))
    assert sum(quality.fell_back for quality in found.qualities) > 0.95 * (LONGER - 1)
    assert "s, use the motion before instead of the match or a part of it" in found.describe("kiss-icp")


def test_the_description_says_that_a_queue_beside_the_sensor_may_drag_the_pose() -> None:
    """Between bare houses a queue that sets off cannot be distinguished from a robot that slows down."""

    def queue(time_s: float) -> list[tuple[float, float]]:
        return [(away(max(time_s - 3.0, 0.0)).x + 6.0 * k, 3.5) for k in range(-4, 4)]

    scans = drive(BARE_STREET, straight, LONGER, crowd=queue, body=CAR)
    found = alone(scans)
    assert sum(found.by_objects) > 0.5 * LONGER
    assert "have a direction that only surfaces of less than 6 m constrain" in found.describe("kiss-icp")
    assert "only surfaces" not in found.describe("refined")
    assert last_error_m(scans, found) > 5.0


# ---- imports


@pytest.mark.parametrize("crowded", [False, True])
def test_a_sensor_at_rest_gets_no_jitter(write, tmp_path: Path, crowded: bool) -> None:
    source = write(drive(ROOM, still, 40, **({"crowd": one_way} if crowded else {})))
    imported = import_recording(source, tmp_path / "out.mcap", ego_motion="kiss-icp")
    assert not imported.survey.moves
    assert imported.info.poses.endswith("the sensor is at rest")


def test_an_import_names_the_source_of_its_poses_and_gives_the_same_bytes_again(write, tmp_path: Path) -> None:
    source = write([replace(s, reference_T_sensor=None) for s in drive(ROOM, around, 30, odometry_noise=0.1)])
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
    assert [s.pose_quality.outcome for s in imported.scans() if s.pose_quality] == ["start", *["matched"] * 29]


def test_a_second_sensor_keeps_its_mount(write, tmp_path: Path) -> None:
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


def test_with_truth_the_recorded_poses_become_the_reference(write, tmp_path: Path) -> None:
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

"""Poses that drift from what the scans say are told, with how far; exact ones, and what nobody can see, are not."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from gridtrack.common.geometry import SE2
from gridtrack.common.scan import Scan
from gridtrack.recordings import import_recording, open_recording
from gridtrack.recordings.pose_checks import DRIFT_LIMIT_M, ENOUGH_PAIRS, PoseDrift

DRIVES = Path(__file__).parents[2] / "data" / "drives"
SECOND_NS = 10**9
ANGLES = np.radians(np.arange(-180.0, 180.0))
ROOM = ((-6.0, 6.0), (-4.0, 4.0))
"""x and y of the walls of a room, metres."""


def scan_at(stamp_s: float, true: SE2, pose: SE2, walls: tuple[tuple[float, float], ...] = ROOM, noise_m: float = 0.01):
    """What a laser at `true` between walls x = const and y = const measures, with `pose` as its recorded pose."""
    directions = true.theta + ANGLES
    ranges = np.full(len(ANGLES), np.inf)
    for origin, along, places in zip((true.x, true.y), (np.cos(directions), np.sin(directions)), walls, strict=True):
        for place in places:
            with np.errstate(divide="ignore"):
                reach = (place - origin) / along
            ranges = np.where(reach > 0.0, np.minimum(ranges, reach), ranges)
    random = np.random.default_rng(round(stamp_s * 1000))
    measured = (ranges + random.normal(0.0, noise_m, len(ranges))).astype(np.float32)
    measured[ranges > 20.0] = np.inf
    return scan_of(stamp_s, measured, pose)


def scan_of(stamp_s: float, ranges: np.ndarray, pose: SE2) -> Scan:
    return Scan(round(stamp_s * SECOND_NS) + 1, ranges, -math.pi, math.radians(1.0), 0.1, 20.0, world_T_sensor=pose)


def drift_of(error: SE2, walls=ROOM, seconds: float = 30.0, speed: float = 0.3) -> PoseDrift:
    """Of a laser that drives along x and back; its recorded poses drift by `error` in each second, its own frame."""
    drift, true, pose, period_s = PoseDrift(), SE2(-3.0, 0.5, 0.1), SE2(-3.0, 0.5, 0.1), 0.2
    for k in range(round(seconds / period_s)):
        drift.add(scan_at(k * period_s, true, pose, walls))
        ahead = speed if (k * period_s) % 30.0 < 15.0 else -speed
        step = SE2(ahead * period_s, 0.0, 0.0)
        true = true @ step
        pose = pose @ step @ SE2(error.x * period_s, error.y * period_s, error.theta * period_s)
    return drift


def test_exact_poses_leave_the_noise_of_the_match():
    drift = drift_of(SE2())
    assert len(drift.displacements_m) >= ENOUGH_PAIRS
    assert drift.median_m < 0.01
    assert drift.problem("...") == ""


def test_a_turn_displaces_walls_by_its_angle_times_their_distance():
    """Half of the returns lie on walls some 4 m away, whose displacement across is the angle times the way along it."""
    small, large = drift_of(SE2(theta=0.02)).median_m, drift_of(SE2(theta=0.04)).median_m
    assert large == pytest.approx(2 * small, rel=0.1)
    assert 0.04 * 1.0 < large < 0.04 * 5.0


def test_a_shift_displaces_the_walls_that_it_is_across():
    """Across the long walls, which have about two thirds of the beams: 0.1 m for these and none for the others."""
    assert drift_of(SE2(y=0.1)).median_m == pytest.approx(0.1 * math.sqrt(0.64), rel=0.1)


def test_along_a_bare_corridor_nobody_sees_how_far_it_went():
    """Of a shift along the robot, which drives at 0.1 rad to the walls, only the part across them is seen."""
    corridor = ((-100.0, 100.0), (-1.0, 1.5))
    assert drift_of(SE2(x=0.2), corridor).median_m == pytest.approx(0.2 * math.sin(0.1), rel=0.1)


def test_a_sensor_that_stands_and_a_short_drive_say_nothing():
    assert drift_of(SE2(), speed=0.0).median_m is None
    few = drift_of(SE2(theta=0.1), seconds=5.0)
    assert 0 < len(few.displacements_m) < ENOUGH_PAIRS
    assert (few.median_m, few.problem("...")) == (None, "")


def test_scans_without_returns_are_no_pair():
    drift = PoseDrift()
    for k in range(200):
        drift.add(scan_of(0.2 * k, np.full(360, np.inf, np.float32), SE2(0.1 * k, 0.0, 0.0)))
    assert len(drift.displacements_m) == 0


def test_scans_without_walls_are_no_pair():
    """Single returns far from one another, as of bushes: they have no direction to be displaced across."""
    drift, ranges = PoseDrift(), np.where(np.arange(360) % 9 == 0, 8.0 + np.arange(360) % 5, np.inf)
    for k in range(100):
        drift.add(scan_of(0.2 * k, ranges.astype(np.float32), SE2(0.06 * k, 0.0, 0.0)))
    assert len(drift.displacements_m) == 0


@pytest.mark.parametrize("far_m", [1e9, 1e200])
def test_poses_that_jump_far_are_no_pair(far_m):
    drift = PoseDrift()
    for k in range(100):
        drift.add(scan_at(0.2 * k, SE2(), SE2(far_m * (-1.0) ** (k // 5), 0.0, 0.0)))
    assert len(drift.displacements_m) == 0


def test_a_long_drive_has_not_many_more_pairs():
    assert len(drift_of(SE2(), seconds=600.0).displacements_m) < 130


@pytest.mark.parametrize("name", ["robot-201", "car-202"])
def test_odometry_of_the_drives_is_told_with_the_command_that_mends_it_and_true_poses_are_not(name):
    true, odometry = (open_recording(DRIVES / f"{name}{which}.tracks") for which in ("", "-odometry"))
    for recording in (true, odometry):
        recording.survey  # noqa: B018 - its warnings
    assert true.warnings == []
    (warning,) = odometry.warnings
    assert "its poses disagree with its scans: by them a wall moves 0." in warning
    assert f"{name}-odometry-posed.mcap --ego-motion refined`" in warning
    drift_m = odometry.overview().sensors["scan"].pose_drift_m
    assert drift_m > DRIFT_LIMIT_M > 4 * true.overview().sensors["scan"].pose_drift_m
    assert f"by its poses a wall moves {drift_m:.3f} m in a second" in str(odometry.overview())


def test_a_recording_with_refined_poses_does_not_repeat_what_is_mended(tmp_path):
    pytest.importorskip("kiss_icp")
    source = DRIVES / "robot-201-odometry.tracks"
    mended = import_recording(source, tmp_path / "mended.mcap", ego_motion="refined")
    drift_m = mended.overview().sensors["scan"].pose_drift_m
    assert mended.warnings == []
    assert 0.0 < drift_m < DRIFT_LIMIT_M / 2

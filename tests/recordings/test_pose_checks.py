"""Jumps of poses, and poses that drift from the scans, are warnings; exact poses and fast motion are not."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gridtrack.common.geometry import SE2
from gridtrack.common.scan import Scan
from gridtrack.recordings import import_recording, open_recording, packaged_recording
from gridtrack.recordings.pose_checks import DRIFT_LIMIT_M, ENOUGH_PAIRS, PoseDrift, PoseJumps

DRIVES = Path(__file__).parents[2] / "data" / "drives"
SECOND_NS = 10**9
ANGLES = np.radians(np.arange(-180.0, 180.0))
ROOM = ((-6.0, 6.0), (-4.0, 4.0))
"""x and y of the walls of a room, metres."""
PERIOD_S = 0.2


def jumps_of(poses: list[SE2], stamps_s: list[float] | None = None) -> PoseJumps:
    jumps = PoseJumps()
    for k, pose in enumerate(poses):
        jumps.add(round((stamps_s[k] if stamps_s else 0.1 * k) * SECOND_NS) + 1, pose)
    return jumps


def test_a_drive_has_no_jumps() -> None:
    accelerating = [SE2(0.5 * 5.0 * (0.1 * k) ** 2, 0.0, 0.0) for k in range(100)]
    stopping = [*accelerating, *([accelerating[-1]] * 20)]
    turning = [SE2(0.0, 0.0, math.sin(0.1 * k) * 2.0) for k in range(100)]
    for poses in (accelerating, stopping, turning):
        assert jumps_of(poses).count == 0


def test_irregular_stamps_and_gaps_are_no_jumps() -> None:
    random = np.random.default_rng(5)
    times = np.arange(200) * 0.1
    stamps = np.sort(times + random.uniform(-0.049, 0.049, 200))
    stamps[100:] += 20.0
    poses = [SE2(1.5 * t + (30.0 if k >= 100 else 0.0), 0.0, 0.0) for k, t in enumerate(times)]
    assert jumps_of(poses, list(stamps)).count == 0


def test_jumps_are_counted_with_the_largest() -> None:
    jumped = [(0.6 * (k >= 30), 0.4 * (k >= 60), 1.0 * (k >= 80)) for k in range(100)]
    poses = [SE2(0.05 * k + x, y, theta) for k, (x, y, theta) in enumerate(jumped)]
    jumps = jumps_of(poses)
    assert jumps.count == 3
    np.testing.assert_allclose((jumps.largest_m, jumps.largest_rad), (0.6, 1.0), atol=1e-9)
    warning = "its pose jumps: 3 times in the whole recording, by up to 0.60 m and 57 deg, first 3.0 s after the first"
    assert warning in jumps.warning(1)
    assert jumps_of(poses[:20]).warning(1) == ""


# ---- drift


def scan_of(stamp_s: float, ranges: np.ndarray, pose: SE2) -> Scan:
    return Scan(round(stamp_s * SECOND_NS) + 1, ranges, -math.pi, math.radians(1.0), 0.1, 20.0, world_T_sensor=pose)


def scan_at(stamp_s: float, true: SE2, pose: SE2, walls: tuple[tuple[float, float], ...] = ROOM) -> Scan:
    """A scan at `true` between walls x = const and y = const, with the recorded pose `pose`."""
    directions = true.theta + ANGLES
    ranges = np.full(len(ANGLES), np.inf)
    for origin, along, places in zip((true.x, true.y), (np.cos(directions), np.sin(directions)), walls, strict=True):
        for place in places:
            with np.errstate(divide="ignore"):
                reach = (place - origin) / along
            ranges = np.where(reach > 0.0, np.minimum(ranges, reach), ranges)
    noise = np.random.default_rng(round(stamp_s * 1000)).normal(0.0, 0.01, len(ranges))
    measured = (ranges + noise).astype(np.float32)
    measured[ranges > 20.0] = np.inf
    return scan_of(stamp_s, measured, pose)


def drifting(error: SE2, walls=ROOM, seconds: float = 15.0, speed: float = 0.3) -> list[Scan]:
    """Scans of a laser that drives along x and back. Its poses drift by `error` per second, sensor frame."""
    scans, true, pose = [], SE2(-3.0, 0.5, 0.1), SE2(-3.0, 0.5, 0.1)
    for k in range(round(seconds / PERIOD_S)):
        scans.append(scan_at(k * PERIOD_S, true, pose, walls))
        step = SE2((speed if (k * PERIOD_S) % 30.0 < 15.0 else -speed) * PERIOD_S, 0.0, 0.0)
        true = true @ step
        pose = pose @ step @ SE2(error.x * PERIOD_S, error.y * PERIOD_S, error.theta * PERIOD_S)
    return scans


def drift_of(scans: list[Scan]) -> PoseDrift:
    drift = PoseDrift()
    for scan in scans:
        drift.add(scan)
    return drift


def test_exact_poses_leave_the_noise_of_the_match() -> None:
    drift = drift_of(drifting(SE2()))
    assert len(drift.displacements_m) >= ENOUGH_PAIRS
    assert drift.median_m is not None
    assert drift.median_m < 0.01
    assert drift.problem("...") == ""


def test_a_turn_displaces_walls_by_its_angle_times_their_distance() -> None:
    """Half of the returns are on walls some 4 m away; their displacement is the angle times the distance along them."""
    small, large = (drift_of(drifting(SE2(theta=theta))).median_m for theta in (0.02, 0.04))
    assert large == pytest.approx(2 * small, rel=0.1)
    assert 0.04 * 1.0 < large < 0.04 * 5.0


@pytest.mark.parametrize(
    ("error", "walls", "displacement_m"),
    [
        # 0.1 m across the long walls, which have about two thirds of the beams, and none across the others
        pytest.param(SE2(y=0.1), ROOM, 0.1 * math.sqrt(0.64), id="across the walls"),
        # the laser drives at 0.1 rad to the walls of a bare corridor
        pytest.param(SE2(x=0.2), ((-100.0, 100.0), (-1.0, 1.5)), 0.2 * math.sin(0.1), id="along a corridor"),
    ],
)
def test_a_shift_is_visible_across_walls_only(error: SE2, walls, displacement_m: float) -> None:
    assert drift_of(drifting(error, walls)).median_m == pytest.approx(displacement_m, rel=0.1)


def test_a_sensor_at_rest_and_a_short_drive_have_no_drift() -> None:
    assert drift_of(drifting(SE2(), speed=0.0)).median_m is None
    few = drift_of(drifting(SE2(theta=0.1), seconds=5.0))
    assert 0 < len(few.displacements_m) < ENOUGH_PAIRS
    assert (few.median_m, few.problem("...")) == (None, "")


def unrest_of(recorded: list[Scan]) -> str:
    """The lines about these scans without their poses."""
    rest = PoseDrift(at_rest=True)
    for scan in recorded:
        rest.add(replace(scan, world_T_sensor=SE2()))
    return rest.unrest("COMMAND")


@pytest.mark.parametrize(
    ("motion", "by"),
    [
        ({"speed": 0.0}, None),
        ({"speed": 0.01}, None),
        ({"speed": 0.2}, "by 0.1"),
        ({"speed": 0.0, "error": SE2(theta=0.03)}, None),
        ({"speed": 3.0}, "by 0.3"),
        ({"speed": 0.2, "seconds": 7.0}, None),
    ],
)
def test_a_moving_sensor_without_recorded_motion_is_a_warning(motion: dict[str, Any], by: str | None) -> None:
    """The errors of `drifting` are of the recorded poses, which are left out; seven seconds are too few pairs."""
    reported = unrest_of(drifting(**{"error": SE2(), **motion}))
    assert (by is None) == (reported == "")
    assert (reported if by is None else f"it moves: in a quarter of 11 pairs of scans the walls move {by}") in reported


def test_a_robot_that_stands_for_half_of_the_time_is_recognised() -> None:
    driven, stood = drifting(SE2(), speed=0.3), drifting(SE2(), speed=0.0)
    assert "but it moves" in unrest_of([*stood, *(replace(s, stamp_ns=s.stamp_ns + 15 * SECOND_NS) for s in driven)])


def test_people_who_pass_a_sensor_at_rest_are_no_motion() -> None:
    assert open_recording(packaged_recording("leg_tracker")).overview().warnings == ()


SINGLE_RETURNS = np.where(np.arange(360) % 9 == 0, 8.0 + np.arange(360) % 5, np.inf).astype(np.float32)
"""As of bushes: far from one another, so that they have no normals."""


@pytest.mark.parametrize(
    "scans",
    [
        pytest.param(
            [scan_of(0.2 * k, np.full(360, np.inf, np.float32), SE2(0.1 * k)) for k in range(100)], id="no returns"
        ),
        pytest.param([scan_of(0.2 * k, SINGLE_RETURNS, SE2(0.06 * k)) for k in range(100)], id="no walls"),
        *(
            pytest.param(
                [scan_at(0.2 * k, SE2(), SE2(far_m * (-1.0) ** (k // 5))) for k in range(60)],
                id=f"jumps of {far_m:g} m",
            )
            for far_m in (1e9, 1e200)
        ),
    ],
)
def test_scans_that_cannot_be_matched_are_no_pair(scans: list[Scan]) -> None:
    assert len(drift_of(scans).displacements_m) == 0


def test_a_long_drive_has_few_more_pairs() -> None:
    assert len(drift_of(drifting(SE2(), seconds=300.0)).displacements_m) < 110


def test_odometry_of_a_drive_is_a_warning_with_a_command_and_true_poses_are_not() -> None:
    true, odometry = (open_recording(DRIVES / f"robot-201{which}.tracks") for which in ("", "-odometry"))
    true_m, drift_m = (recording.overview().sensors["scan"].pose_drift_m for recording in (true, odometry))
    assert true.warnings == []
    (warning,) = odometry.warnings
    assert "its poses disagree with its scans: by them a wall moves 0." in warning
    assert "robot-201-odometry-posed.mcap --ego-motion refined`" in warning
    assert drift_m > DRIFT_LIMIT_M > 4 * true_m
    assert f"by its poses a wall moves {drift_m:.3f} m in a second" in str(odometry.overview())


def test_refined_poses_drift_no_more_and_are_no_warning(write, tmp_path: Path) -> None:
    pytest.importorskip("kiss_icp")
    source = write(drifting(SE2(y=0.1)))
    assert "its poses disagree with its scans" in open_recording(source).overview().warnings[0]
    refined = import_recording(source, tmp_path / "refined.mcap", ego_motion="refined")
    drift_m = refined.overview().sensors["scan"].pose_drift_m
    assert refined.warnings == []
    assert 0.0 < drift_m < DRIFT_LIMIT_M / 2

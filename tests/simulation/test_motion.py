"""Motion: smoothing does not shift paths, headings do not flip, and wheel odometry has the stated errors."""

from __future__ import annotations

import numpy as np
import pytest

from gridtrack.simulation.motion import WheelOdometry, headings, smoothed, trailing_headings, unbroken_tracks

EXACT = {"wheel_std": 0.0, "turn_std": 0.0, "diameter_std": 0.0}


def test_smoothing_keeps_constants_and_averages_jitter() -> None:
    assert smoothed(np.full((30, 2), 7.0), 4.0) == pytest.approx(7.0)
    assert smoothed(np.full((1, 2), 7.0), 4.0) == pytest.approx(7.0)
    jitter = np.random.default_rng(0).normal(0.0, 1.0, (2000, 1))
    # the standard deviation of white noise under a Gaussian of s steps falls by sqrt(2 s sqrt(pi))
    assert smoothed(jitter, 4.0).std() == pytest.approx(1.0 / np.sqrt(2.0 * 4.0 * np.sqrt(np.pi)), rel=0.1)


def test_a_straight_path_stays_straight_away_from_its_ends() -> None:
    line = np.column_stack([np.arange(60.0), np.arange(60.0) * -2.0])
    assert smoothed(line, 3.0)[15:45] == pytest.approx(line[15:45])


def test_the_heading_follows_the_motion_and_is_kept_at_rest() -> None:
    there = np.column_stack([np.zeros(40), np.linspace(0.0, 6.0, 40)])
    path = np.concatenate([np.zeros((20, 2)), there, np.repeat(there[-1:], 40, axis=0)])
    assert headings(path, 0.125, 2.0) == pytest.approx(np.pi / 2)


def test_a_body_that_never_moves_has_the_resting_heading() -> None:
    assert headings(np.zeros((5, 2)), 0.125, 2.0, resting=1.0) == pytest.approx(1.0)
    assert headings(np.zeros((1, 2)), 0.125, 2.0, resting=1.0) == pytest.approx(1.0)


def test_the_heading_on_a_circle_has_no_jump() -> None:
    angle = np.linspace(0.0, 4.0 * np.pi, 400)
    turned = headings(np.column_stack([np.cos(angle), np.sin(angle)]) * 5.0, 0.125, 2.0)
    assert np.abs(np.diff(turned)).max() < 0.05
    assert turned[-20] - turned[20] == pytest.approx(angle[-20] - angle[20], abs=0.01)


def test_the_rear_of_a_vehicle_follows_its_front_and_a_vehicle_at_rest_does_not_turn() -> None:
    straight = np.column_stack([np.linspace(0.0, 20.0, 5000), np.zeros(5000)])
    found = trailing_headings(np.concatenate([straight, np.repeat(straight[-1:], 20, axis=0)]), 3.0, 0.5)
    # tractrix of a straight pull: tan(heading / 2) falls exponentially with distance over wheelbase
    assert np.tan(found[4999] / 2.0) == pytest.approx(np.tan(0.25) * np.exp(-20.0 / 3.0), rel=0.05)
    assert found[4999:] == pytest.approx(found[4999], abs=1e-12)


def test_gaps_split_tracks() -> None:
    user, step = np.array([0, 0, 0, 1, 1, 2]), np.array([3, 4, 6, 7, 8, 9])
    assert unbroken_tracks(user, step) == [slice(0, 2), slice(2, 3), slice(3, 5), slice(5, 6)]
    assert unbroken_tracks(np.array([], int), np.array([], int)) == []


# ---- wheel odometry


def path(steps: int, metres: float, radians: float) -> np.ndarray:
    """Poses (steps + 1, 3) on an arc from (3, -2, 0.5): metres ahead and radians to the left per step."""
    poses = [np.array([3.0, -2.0, 0.5])]
    for _ in range(steps):
        x, y, theta = poses[-1]
        ahead = theta + radians / 2.0
        poses.append(np.array([x + metres * np.cos(ahead), y + metres * np.sin(ahead), theta + radians]))
    return np.array(poses)


def ends(odometry: dict[str, float], poses: np.ndarray, seeds: int = 200) -> np.ndarray:
    """The error of the last pose, in its own frame: ahead, to the left, heading (seeds, 3)."""
    found = np.array([WheelOdometry(seed=seed, **odometry).recorded(poses)[-1] for seed in range(seeds)])
    x, y = (found[:, :2] - poses[-1, :2]).T
    c, s = np.cos(poses[-1, 2]), np.sin(poses[-1, 2])
    return np.column_stack([c * x + s * y, c * y - s * x, found[:, 2] - poses[-1, 2]])


def test_odometry_without_errors_is_exact() -> None:
    poses = path(200, 0.3, 0.05)
    assert WheelOdometry(seed=1, **EXACT).recorded(poses) == pytest.approx(poses, abs=1e-9)


def test_odometry_starts_at_the_true_pose_and_does_not_drift_at_rest() -> None:
    poses = np.concatenate([path(20, 0.3, 0.05), np.repeat(path(20, 0.3, 0.05)[-1:], 50, axis=0)])
    found = WheelOdometry(seed=1).recorded(poses)
    assert found[0] == pytest.approx(poses[0])
    assert np.ptp(found[20:], axis=0) == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)
    assert np.abs(found[20] - poses[20]).max() > 1e-4


def test_the_same_seed_gives_the_same_errors() -> None:
    poses = path(50, 0.3, 0.05)
    first, again, other = (WheelOdometry(seed=seed).recorded(poses) for seed in (4, 4, 5))
    assert (first == again).all()
    assert (first != other).any()


def test_both_wheels_slip_independently() -> None:
    """25 m at 0.01 m per root metre are 0.05 m per wheel: sqrt(1/2) of it ahead, sqrt(2) of it over the track width."""
    narrow, wide = (
        ends(EXACT | {"wheel_std": 0.01, "track_width_m": width_m}, path(100, 0.25, 0.0)) for width_m in (0.5, 10.0)
    )
    assert narrow[:, 2].std() == pytest.approx(0.05 * np.sqrt(2.0) / 0.5, rel=0.15)
    assert wide[:, 0].std() == pytest.approx(0.05 * np.sqrt(0.5), rel=0.15)


def test_a_turn_on_the_spot_adds_to_the_heading_error() -> None:
    error = ends(EXACT | {"turn_std": 0.05}, path(100, 0.0, 0.04))
    assert error[:, 2].std() == pytest.approx(0.05 * 2.0, rel=0.15)
    assert np.abs(error[:, :2]).max() < 1e-9


def test_unequal_wheels_bend_a_straight_path_evenly() -> None:
    error = ends(EXACT | {"diameter_std": 0.002, "track_width_m": 0.4}, path(100, 0.1, 0.0))
    assert error[:, 2].std() == pytest.approx(10.0 * 0.002 / 0.4, rel=0.15)
    poses = path(100, 0.1, 0.0)
    heading = WheelOdometry(seed=3, **EXACT | {"diameter_std": 0.002}).recorded(poses)[:, 2]
    assert np.diff(heading) == pytest.approx(np.diff(heading)[0], rel=1e-6)


def test_the_errors_do_not_depend_on_how_often_the_pose_is_recorded() -> None:
    often, seldom = (ends({}, path(steps, 10.0 / steps, 1.0 / steps)).std(axis=0) for steps in (20, 200))
    assert often == pytest.approx(seldom, rel=0.25)

"""Simulated wheel odometry: exact at rest, with the stated errors in motion, and the same for the same seed."""

from __future__ import annotations

import numpy as np
import pytest

from gridtrack.simulation.motion import WheelOdometry

EXACT = {"wheel_std": 0.0, "turn_std": 0.0, "diameter_std": 0.0}


def path(steps: int, metres: float, radians: float) -> np.ndarray:
    """Poses (steps + 1, 3) on an arc: so many metres ahead and radians to the left a step, from (3, -2, 0.5) on."""
    poses = [np.array([3.0, -2.0, 0.5])]
    for _ in range(steps):
        x, y, theta = poses[-1]
        ahead = theta + radians / 2.0
        poses.append(np.array([x + metres * np.cos(ahead), y + metres * np.sin(ahead), theta + radians]))
    return np.array(poses)


def ends(odometry: dict[str, float], poses: np.ndarray, seeds: int = 300) -> np.ndarray:
    """The error of the last pose, in its own frame: ahead, to the left, heading (seeds, 3)."""
    found = np.array([WheelOdometry(seed=seed, **odometry).recorded(poses)[-1] for seed in range(seeds)])
    x, y = (found[:, :2] - poses[-1, :2]).T
    c, s = np.cos(poses[-1, 2]), np.sin(poses[-1, 2])
    return np.column_stack([c * x + s * y, c * y - s * x, found[:, 2] - poses[-1, 2]])


def test_without_errors_the_recorded_poses_are_the_true_ones() -> None:
    poses = path(200, 0.3, 0.05)
    assert WheelOdometry(seed=1, **EXACT).recorded(poses) == pytest.approx(poses, abs=1e-9)


def test_it_starts_at_the_true_pose_and_does_not_drift_at_rest() -> None:
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
    """Over 25 m, each wheel with 0.01 m a root metre: 0.05 m each, so sqrt(1/2) of it ahead and sqrt(2) of it a track
    width in heading."""
    narrow, wide = (
        ends(EXACT | {"wheel_std": 0.01, "track_width_m": width_m}, path(100, 0.25, 0.0)) for width_m in (0.5, 10.0)
    )
    assert narrow[:, 2].std() == pytest.approx(0.05 * np.sqrt(2.0) / 0.5, rel=0.15)
    assert wide[:, 0].std() == pytest.approx(0.05 * np.sqrt(0.5), rel=0.15)


def test_a_turn_adds_to_the_heading_error_also_where_it_is_on_the_spot() -> None:
    error = ends(EXACT | {"turn_std": 0.05}, path(100, 0.0, 0.04))
    assert error[:, 2].std() == pytest.approx(0.05 * 2.0, rel=0.15)
    assert np.abs(error[:, :2]).max() < 1e-9


def test_unequal_wheels_bend_a_straight_path_by_the_same_angle_each_metre() -> None:
    error = ends(EXACT | {"diameter_std": 0.002, "track_width_m": 0.4}, path(100, 0.1, 0.0))
    assert error[:, 2].std() == pytest.approx(10.0 * 0.002 / 0.4, rel=0.15)
    poses = path(100, 0.1, 0.0)
    heading = WheelOdometry(seed=3, **EXACT | {"diameter_std": 0.002}).recorded(poses)[:, 2]
    assert np.diff(heading) == pytest.approx(np.diff(heading)[0], rel=1e-6)


def test_the_errors_do_not_depend_on_how_often_the_pose_is_recorded() -> None:
    often, seldom = (ends({}, path(steps, 10.0 / steps, 1.0 / steps)).std(axis=0) for steps in (20, 200))
    assert often == pytest.approx(seldom, rel=0.25)

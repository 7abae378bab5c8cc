"""Planar poses form a group, and transform points like the matrices of that group."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from gridtrack.common.geometry import SE2, wrap_angle

coordinates = st.floats(-1e3, 1e3)
poses = st.builds(SE2, coordinates, coordinates, st.floats(-10.0, 10.0))


def matrix(pose: SE2) -> np.ndarray:
    """The pose as a homogeneous matrix, written down independently."""
    c, s = math.cos(pose.theta), math.sin(pose.theta)
    return np.array([[c, -s, pose.x], [s, c, pose.y], [0.0, 0.0, 1.0]])


@given(poses, poses)
def test_chaining_poses_is_multiplying_their_matrices(a: SE2, b: SE2) -> None:
    np.testing.assert_allclose(matrix(a @ b), matrix(a) @ matrix(b), atol=1e-9)


@given(poses)
def test_a_pose_and_its_inverse_cancel(pose: SE2) -> None:
    np.testing.assert_allclose(matrix(pose @ pose.inverse()), np.eye(3), atol=1e-9)
    np.testing.assert_allclose(matrix(pose.inverse()), np.linalg.inv(matrix(pose)), atol=1e-9)


@given(poses, st.lists(st.tuples(coordinates, coordinates), min_size=1, max_size=5))
def test_points_move_as_homogeneous_coordinates_do(pose: SE2, points: list[tuple[float, float]]) -> None:
    moved = matrix(pose) @ np.vstack([np.array(points).T, np.ones(len(points))])
    np.testing.assert_allclose(pose.apply(np.array(points)), moved[:2].T, atol=1e-9)


def test_a_quarter_turn_carries_x_to_y() -> None:
    np.testing.assert_allclose(SE2(1.0, 2.0, math.pi / 2).apply(np.array([[3.0, 0.0]])), [[1.0, 5.0]], atol=1e-12)


@given(st.floats(-1e4, 1e4))
def test_a_wrapped_angle_is_the_same_direction_within_half_a_turn(theta: float) -> None:
    wrapped = wrap_angle(theta)
    assert -math.pi <= wrapped < math.pi
    assert abs(math.remainder(wrapped - theta, 2.0 * math.pi)) < 1e-8

"""Rigid transforms agree with scipy's, which are independent of ours."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation, Slerp

from gridtrack.common.geometry import SE2
from gridtrack.recordings.frames.transform import SE3, interpolated

RANDOM = np.random.default_rng(3)


def random_transform() -> SE3:
    made = SE3.of(RANDOM.uniform(-5, 5, 3), RANDOM.normal(size=4))
    assert made is not None
    return made


def of_scipy(transform: SE3) -> RigidTransform:
    return RigidTransform.from_components(transform.translation, Rotation.from_quat(transform.rotation))


@pytest.mark.parametrize("_", range(20))
def test_chained_transforms_agree_with_scipy(_: int) -> None:
    a, b = random_transform(), random_transform()
    expected = (of_scipy(a) * of_scipy(b)).as_matrix()
    np.testing.assert_allclose(of_scipy(a @ b).as_matrix(), expected, atol=1e-12)


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_rotations_are_interpolated_as_by_scipy(share: float) -> None:
    for a, b in ((random_transform(), random_transform()) for _ in range(20)):
        slerp = Slerp([0.0, 1.0], Rotation.concatenate([of_scipy(a).rotation, of_scipy(b).rotation]))
        found = Rotation.from_quat(interpolated(a, b, share).rotation)
        np.testing.assert_allclose(found.as_matrix(), slerp(share).as_matrix(), atol=1e-9)


@pytest.mark.parametrize(
    ("roll", "pitch", "mirrored", "tilt"),
    [(0, 0, False, 0), (180, 0, True, 0), (0, 180, True, 0), (20, 0, False, 20), (170, 0, True, 10), (0, 90, None, 90)],
)
def test_roll_and_pitch_are_a_mirrored_or_a_tilted_placement(roll, pitch, mirrored, tilt) -> None:
    turn = Rotation.from_euler("ZYX", [30, pitch, roll], degrees=True)
    transform = SE3.of((1.0, 2.0, 3.0), turn.as_quat())
    assert transform is not None
    placement = transform.placement()
    assert mirrored in (None, placement.mirrored)
    assert math.degrees(placement.tilt_rad) == pytest.approx(tilt, abs=1e-5)
    assert (placement.pose.x, placement.pose.y) == (1.0, 2.0)
    if pitch == 0:
        assert math.degrees(placement.pose.theta) == pytest.approx(30.0)


def test_a_mirrored_placement_in_the_plane_is_read_back() -> None:
    for mirrored in (False, True):
        placement = SE3.in_plane(SE2(1.0, -2.0, 0.7), mirrored).placement()
        assert (placement.pose.x, placement.pose.y, placement.mirrored) == (1.0, -2.0, mirrored)
        assert placement.pose.theta == pytest.approx(0.7)


@pytest.mark.parametrize(
    ("translation", "rotation"),
    [
        ((math.nan, 0, 0), (0, 0, 0, 1)),
        ((0, math.inf, 0), (0, 0, 0, 1)),
        ((0, 0, 1e12), (0, 0, 0, 1)),
        ((0, 0, 0), (0, 0, 0, 0)),
        ((0, 0, 0), (0, 0, math.nan, 1)),
    ],
)
def test_numbers_that_are_no_transform_are_refused(translation, rotation) -> None:
    assert SE3.of(translation, rotation) is None


def test_transforms_are_the_same_to_a_millimetre_and_a_milliradian() -> None:
    one = SE3.in_plane(SE2(1.0, 2.0, 0.5))
    assert one.is_same(SE3.in_plane(SE2(1.0005, 2.0, 0.5005)))
    assert not one.is_same(SE3.in_plane(SE2(1.0, 2.002, 0.5)))
    assert not one.is_same(SE3.in_plane(SE2(1.0, 2.0, 0.502)))

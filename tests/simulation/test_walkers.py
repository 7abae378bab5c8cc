"""Walkers: two legs with stance and swing, and the cross-section of a person at any height."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gridtrack.simulation.bodies import Walker, feet, foot_offset, outlines_of, step_length_m

RATE_HZ = 50.0


def straight(speed: float, seconds: float = 6.0) -> tuple[np.ndarray, np.ndarray]:
    """A path along a line at 30 degrees."""
    s = np.arange(round(seconds * RATE_HZ)) / RATE_HZ * speed
    direction = np.radians(30.0)
    return np.outer(s, [np.cos(direction), np.sin(direction)]), np.full(len(s), direction)


@settings(max_examples=40)
@given(st.floats(0.4, 2.0), st.floats(1.0, 2.1))
def test_a_foot_on_the_ground_does_not_move_and_one_always_is(speed: float, height_m: float) -> None:
    position, heading = straight(speed)
    left, right = feet(position, heading, RATE_HZ, height_m, 0.3)
    middle = slice(50, -50)
    along = np.hypot(*position.T)[middle]
    velocity = [np.abs(np.gradient(along + foot[middle, 0], 1.0 / RATE_HZ)) for foot in (left, right)]
    assert np.minimum(*velocity).max() < 0.05 * speed
    assert max(v.max() for v in velocity) > 2.0 * speed
    assert abs(left[:, 1]).max() < 1e-6


def test_steps_have_human_length_and_frequency() -> None:
    length_m = float(step_length_m(np.array([1.35]), 1.75)[0])
    assert length_m == pytest.approx(0.7, abs=0.01)
    slow, fast = step_length_m(np.array([0.6, 1.9]), 1.75)
    assert slow < length_m < fast
    assert 1.0 < 0.6 / slow < 1.35 / length_m < 1.9 / fast < 2.6


def test_the_gait_is_continuous_and_repeats() -> None:
    phase = np.linspace(0.0, 2.0, 20001)
    offset = foot_offset(phase)
    assert abs(np.diff(offset)).max() < 5e-4
    np.testing.assert_allclose(offset[:10000], offset[10000:20000], atol=1e-9)
    assert abs(offset).max() < 0.32


def test_the_feet_of_a_standing_person_are_side_by_side() -> None:
    left, right = feet(np.zeros((40, 2)), np.zeros(40), RATE_HZ, 1.7, 0.2)
    assert abs(left).max() == abs(right).max() == 0.0


def outlines(walker: Walker, plane_m: float, speed: float = 1.2) -> list[tuple[np.ndarray, ...]]:
    position, heading = straight(speed)
    return list(outlines_of(walker, plane_m, (0.25, 0.45), position, heading, RATE_HZ))


def test_the_cross_section_is_two_legs_below_the_hip_and_a_torso_above() -> None:
    shins = outlines(Walker(), 0.25)
    assert {len(parts) for parts in shins} == {2}
    across = np.ptp(shins[0][0][:, 1])
    assert 0.08 < across < 0.16
    apart = [parts[0].mean(axis=0)[0] - parts[1].mean(axis=0)[0] for parts in shins]
    assert max(apart) > 0.3
    assert min(apart) < -0.3
    assert {len(parts) for parts in outlines(Walker(), 0.95)} == {3}  # with both arms
    assert {len(parts) for parts in outlines(Walker(), 1.3)} == {1}
    assert np.ptp(outlines(Walker(), 1.3)[0][0][:, 1]) == pytest.approx(0.45)


@pytest.mark.parametrize(
    ("companion", "plane_m", "parts"),
    [("bag", 0.4, 3), ("trolley", 0.3, 3), ("stroller", 0.2, 6), ("stroller", 0.5, 3), ("wheelchair", 0.3, 4)],
)
def test_the_companion_of_a_person_is_beside_the_legs(companion: str, plane_m: float, parts: int) -> None:
    walker = Walker.model_validate({"companion": companion})
    assert {len(found) for found in outlines(walker, plane_m)} == {parts}

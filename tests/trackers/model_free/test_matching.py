"""Scan matching and shapes, with bodies of known motion."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gridtrack.trackers.model_free.estimators import is_positive_definite
from gridtrack.trackers.model_free.matching import UNKNOWN, Match, Outlines, Pairs, match
from gridtrack.trackers.model_free.shape import MAX_POINTS, Shape, rotation, to_body, to_grid

SURFACE_M = 0.1
L_SHAPE = np.concatenate(
    [
        np.stack([np.arange(-2.0, 2.01, 0.1), np.full(41, -0.9)], 1),
        np.stack([np.full(18, 2.0), np.arange(-0.8, 0.91, 0.1)], 1),
    ]
)
"""The side and the front of a car of 4 x 1.8 m, points (N, 2) in metres."""
WALL = np.stack([np.arange(-4.0, 4.01, 0.1), np.zeros(81)], 1)


def placed(offsets, pose):
    return np.asarray(pose[:2]) + offsets @ rotation(pose[2]).T


def nowhere(count):
    """A mask without points."""
    return np.zeros(count, bool)


def outline(points, cut=None):
    """An outline of weight 1, by default without cut-off points."""
    return Outlines.of([points], [np.ones(len(points))], [nowhere(len(points)) if cut is None else cut])


def matched(points, offsets, *starts, turns=True, unsure_m=0.4, cut=None, seen=None) -> Match:
    """The match from start poses, by default zero, with the boundary `offsets` by default not in view."""
    starts = np.array([starts or [(0.0, 0.0, 0.0)]], float)
    pairs = Pairs(np.zeros((1, 2), int), starts, np.array([unsure_m]), np.ones(1, bool), np.array([turns]))
    seen = nowhere(len(offsets)) if seen is None else seen
    return match(outline(offsets, cut), seen, outline(points), pairs, SURFACE_M).of(0)


@settings(max_examples=40)
@given(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(-0.15, 0.15))
def test_the_pose_of_a_corner_is_found(x, y, turn):
    found = matched(placed(L_SHAPE, (x, y, turn)), L_SHAPE)
    assert found.pose == pytest.approx([x, y, turn], abs=0.03)
    assert found.residual < 0.5


def test_the_best_of_several_starts_is_taken():
    nothing = 3 * (math.nan,)
    found = matched(placed(L_SHAPE, (5.0, 0.0, 0.0)), L_SHAPE, (30.0, 0.0, 0.0), (5.1, 0.1, 0.0), nothing)
    assert found.pose == pytest.approx([5.0, 0.0, 0.0], abs=0.03)


def test_pairs_are_matched_independently():
    poses = np.array([[0.2, 0.1, 0.05], [-0.1, 0.2, 0.0]])
    one, other = L_SHAPE, WALL[:30]
    boundaries = Outlines.of([one, other], [np.ones(59), np.ones(30)], [nowhere(59), nowhere(30)])
    shown = [placed(other, poses[1]), placed(one, poses[0])]
    returns = Outlines.of(shown, [np.ones(30), np.ones(59)], [nowhere(30), nowhere(59)])
    numbers = np.array([[0, 1], [1, 0], [0, 0]])
    pairs = Pairs(numbers, np.zeros((3, 1, 3)), np.full(3, 0.4), np.ones(3, bool), np.array([True, False, True]))
    found = match(boundaries, nowhere(89), returns, pairs, SURFACE_M)
    for pair, (b, r) in enumerate(numbers):
        alone = matched(shown[r], (one, other)[b], turns=pair != 1)
        for together, by_itself in zip(found.of(pair), alone, strict=True):
            assert together == pytest.approx(by_itself)


@pytest.mark.parametrize("degrees", [0, 30])
def test_a_wall_gives_no_information_along_itself(degrees):
    turn = math.radians(degrees)
    across = rotation(turn)[:, 1]
    found = matched(placed(WALL[25:56], (*(0.2 * across), turn)), WALL, (0.0, 0.0, turn))
    spread = rotation(turn).T @ found.covariance[:2, :2] @ rotation(turn)
    assert found.pose[:2] @ across == pytest.approx(0.2, abs=0.02)
    assert math.sqrt(spread[0, 0]) > 1.0
    assert math.sqrt(spread[1, 1]) < 0.05


def test_a_wall_of_cells_gives_no_information_along_itself():
    """The points are two surface widths apart: the pattern of the grid is not a feature of the wall."""
    cells = WALL[::2]
    found = matched(cells[12:28], cells, unsure_m=0.1)
    assert math.sqrt(found.covariance[0, 0]) > 0.5
    assert math.sqrt(found.covariance[1, 1]) < 0.05


def test_a_boundary_in_view_without_returns_moves_the_pose():
    """A bar has moved by 0.3 m: its rear is in view without returns, its front is hidden."""
    bar = np.stack([np.arange(0.0, 2.05, 0.1), np.zeros(21)], 1)
    front = np.zeros(21, bool)
    front[-4:] = True
    returns = bar[3:]
    moved, held = (
        matched(returns, bar, unsure_m=0.3, cut=front, turns=False, seen=seen) for seen in (~front, nowhere(21))
    )
    assert moved.pose[0] == pytest.approx(0.3, abs=0.1)
    assert math.sqrt(moved.covariance[0, 0]) < 0.1
    assert held.pose[0] < 0.1


def test_a_pair_without_observable_heading_keeps_it_with_unknown_variance():
    found = matched(
        np.array([[0.1, 0.0], [0.3, 0.0]]), np.array([[0.0, 0.0], [0.2, 0.0]]), (0.0, 0.0, 0.4), turns=False
    )
    assert found.pose[2] == 0.4
    assert found.covariance[2, 2] == pytest.approx(UNKNOWN[2])


@pytest.mark.parametrize("heading", np.linspace(-3.0, 3.0, 60))
def test_the_turn_of_a_long_body_about_its_only_match_is_unknown(heading):
    """A return matches the end of the body, 12 m from its origin. The covariance of such a pose was once negative."""
    end, behind = np.array([[12.0, 0.0]]), np.stack([np.full(12, 13.0), np.arange(1.0, 2.15, 0.1)], 1)
    returns = placed(np.concatenate([end, behind]), (0.0, 0.0, heading))
    found = matched(returns, np.concatenate([end, -behind]), (0.03, 0.02, heading))
    assert is_positive_definite(found.covariance)
    shares = np.linalg.eigvalsh(found.covariance / np.sqrt(np.outer(UNKNOWN, UNKNOWN)))
    assert shares.max() < 2.01, "no direction is less known than one without a measurement, but for the rounding"


def test_a_car_that_comes_further_into_view_has_not_moved():
    """Its centre moves by more than a metre."""
    front = L_SHAPE[30:]
    found = matched(L_SHAPE, front, unsure_m=0.1)
    assert np.hypot(*found.pose[:2]) < 0.1
    assert abs(found.pose[2]) < 0.1


def test_outliers_do_not_move_a_body():
    other = np.stack([np.zeros(6), np.linspace(1.5, 2.0, 6)], 1)
    found = matched(np.concatenate([placed(L_SHAPE, (0.2, 0.1, 0.0)), other]), L_SHAPE)
    assert found.pose == pytest.approx([0.2, 0.1, 0.0], abs=0.03)


def test_a_body_without_returns_is_not_measured():
    found = matched(L_SHAPE + 50.0, L_SHAPE)
    assert found.residual == pytest.approx(9.0)
    assert np.diag(found.covariance) == pytest.approx(UNKNOWN)


@pytest.mark.parametrize(("unsure_m", "held_at"), [(0.1, 0.15), (0.3, 0.02)])
def test_a_cut_off_end_does_not_hold_a_sliding_wall(unsure_m, held_at):
    """A wall has moved by 0.3 m behind a fixed window: the visible ends are the occluder's."""
    window = WALL[25:56]
    ends = np.zeros(len(window), bool)
    ends[[*range(4), *range(-4, 0)]] = True
    free, held = (matched(window, window, (0.3, 0.0, 0.0), unsure_m=unsure_m, cut=cut) for cut in (ends, None))
    assert abs(held.pose[0]) < held_at
    assert math.sqrt(held.covariance[0, 0]) < 0.05
    assert math.sqrt(free.covariance[0, 0]) > 0.2
    assert math.sqrt(free.covariance[1, 1]) < 0.05
    assert with_prediction(free, 0.3, 0.1) > 0.25
    assert with_prediction(held, 0.3, 0.1) < 0.2


def with_prediction(found, x, deviation):
    """The x coordinate of a body after the update of a prediction with a match."""
    trust = deviation**2 / (deviation**2 + found.covariance[0, 0])
    return x + trust * (found.pose[0] - x)


def test_a_pair_that_is_not_extended_uses_every_end():
    window = WALL[25:56]
    everywhere = np.ones(len(window), bool)
    pairs = Pairs(np.zeros((1, 2), int), np.array([[[0.2, 0.0, 0.0]]]), np.array([0.3]), nowhere(1), nowhere(1))
    found = match(outline(window, everywhere), nowhere(31), outline(window, everywhere), pairs, SURFACE_M)
    assert found.of(0).pose[0] == pytest.approx(0.0, abs=0.02)


# Shape


def test_a_boundary_point_is_cut_off_until_a_return_there_is_not_cut_off():
    place = np.array([[0.0, 0.0]])
    shape = Shape.of(place, np.ones(1, bool), 0.1)
    assert shape.cut.tolist() == [True]
    shape.update(place, np.ones(1, bool), nowhere(1), np.ones(1, bool), 0.1, gain=0.1)
    assert shape.cut.tolist() == [True]
    shape.update(np.repeat(place, 2, axis=0), np.array([True, False]), nowhere(2), np.ones(1, bool), 0.1, gain=0.1)
    assert shape.cut.tolist() == [False]


def test_the_weight_of_a_boundary_point_is_its_rate_of_matches():
    shape = Shape.of(np.array([[0.0, 0.0], [1.0, 0.0]]), nowhere(2), 0.1)
    for step in range(400):
        found = np.array([[0.0, 0.0]]) if step % 2 else np.array([[0.0, 0.0], [1.0, 0.0]])
        shape.update(found, *2 * [nowhere(len(found))], np.ones(2, bool), 0.1, gain=0.01)
    assert shape.weights == pytest.approx([1.0, 0.5], abs=0.01)


def test_a_hidden_side_decays_more_slowly_than_one_in_view_without_returns():
    shape = Shape.of(np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]), nowhere(3), 0.1)
    for _ in range(12):
        shape.update(np.array([[0.0, 0.0]]), *2 * [nowhere(1)], np.array([True, True, False]), 0.1, gain=0.1)
    assert shape.weights[0] == pytest.approx(1.0)
    assert shape.weights[1] < 0.2
    assert shape.weights[2] > 0.6
    for _ in range(12):
        shape.update(np.array([[0.0, 0.0]]), *2 * [nowhere(1)], np.ones(len(shape.weights), bool), 0.1, gain=0.1)
    assert len(shape.weights) == 2, "points of a short time are dropped"


@pytest.mark.parametrize("gain", [0.4, 0.02])
def test_a_new_point_is_kept_for_some_frames_with_any_memory(gain):
    shape = Shape.of(np.array([[0.0, 0.0]]), nowhere(1), 0.1)
    for _ in range(100):
        shape.update(np.array([[0.0, 0.0]]), *2 * [nowhere(1)], np.ones(1, bool), 0.1, gain)
    shape.update(np.array([[0.0, 0.0], [1.0, 0.0]]), *2 * [nowhere(2)], np.ones(1, bool), 0.1, gain)
    assert shape.weights[1] == pytest.approx(gain)
    shape.update(np.array([[0.0, 0.0]]), *2 * [nowhere(1)], np.ones(2, bool), 0.1, gain)
    assert (len(shape.weights) == 2) == (gain < 0.4)


def test_a_revealed_point_starts_with_the_revealed_weight():
    """A newly visible rear of a car is not an outlier."""
    shape = Shape.of(np.array([[0.0, 0.0]]), nowhere(1), 0.1)
    for _ in range(30):
        shape.update(np.array([[0.0, 0.0]]), *2 * [nowhere(1)], np.ones(1, bool), 0.1, gain=0.1)
    found = np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0]])
    shape.update(found, nowhere(3), np.array([True, True, False]), np.ones(1, bool), 0.1, gain=0.1)
    assert shape.weights == pytest.approx([1.0, 0.55, 0.1])


@given(st.integers(1, 40))
def test_a_shape_has_at_most_the_maximum_number_of_points(frames):
    random = np.random.default_rng(0)
    shape = Shape.of(random.uniform(-9, 9, (20, 2)), nowhere(20), 0.1)
    for _ in range(frames):
        shape.update(random.uniform(-9, 9, (20, 2)), *2 * [nowhere(20)], nowhere(len(shape.weights)), 0.1, gain=0.1)
    assert len(shape.offsets) == len(shape.weights) <= MAX_POINTS


@given(st.floats(-5, 5), st.floats(-5, 5), st.floats(-3.1, 3.1))
def test_to_grid_and_to_body_are_inverse(x, y, turn):
    pose = np.array([x, y, turn])
    shape = Shape.of(L_SHAPE, nowhere(len(L_SHAPE)), 0.01)
    assert to_body(to_grid(shape.offsets, pose), pose) == pytest.approx(shape.offsets, abs=1e-9)

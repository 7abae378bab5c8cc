"""Each stage of the model-free pipeline against a hand-computed case or an independent implementation."""

from __future__ import annotations

import math
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

pytest.importorskip("filterpy")
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame
from gridtrack.trackers.model_free.association import assign, share_out, squared_mahalanobis
from gridtrack.trackers.model_free.background import (
    PRIOR_FRAMES,
    Background,
    explained_cells,
    fit_background,
)
from gridtrack.trackers.model_free.dwell import NOT_OCCUPIED, PRIOR_RETURNS, fit_dwell, next_ages, staying
from gridtrack.trackers.model_free.estimation import ConstantVelocityKalman, MotionNoise, motion_model
from gridtrack.trackers.model_free.rasterise import draw, draw_points, noisy_or, splat
from gridtrack.trackers.model_free.segmentation import Cluster, segment
from gridtrack.trackers.model_free.tracks import MAX_POINTS, Shape, existence_when_detected, existence_when_missed


def frame_of(visible, occupied):
    nothing = np.empty((0, 2), np.float32)
    return GridFrame(0, visible, occupied, SE2(), np.zeros((1, 2), np.float32), nothing, np.empty(0, np.uint8))


# Background


def test_background_is_the_occupied_share_of_each_cell_drawn_to_the_base_rate():
    visible, occupied = np.zeros((5, 5), bool), np.zeros((5, 5), bool)
    visible[:2] = True
    occupied[0, 0] = True
    empty = np.zeros((5, 5), bool)
    background = fit_background([frame_of(visible, occupied)] * 3 + [frame_of(visible, empty)], (5, 5))
    base_rate = 3 / 40  # three occupied among ten visible cells in four frames
    assert background[0, 0] == pytest.approx((3 + PRIOR_FRAMES * base_rate) / (4 + PRIOR_FRAMES))
    assert background[1, 4] == pytest.approx(PRIOR_FRAMES * base_rate / (4 + PRIOR_FRAMES))
    assert background[4, 4] == pytest.approx(base_rate)


def test_background_explains_the_returns_of_a_wall_and_of_its_eight_neighbours():
    background = np.zeros((5, 5), np.float32)
    background[0, 1] = 0.4
    expected = np.zeros((5, 5), bool)
    expected[:2, :3] = True
    assert np.array_equal(explained_cells(background, 0.3), expected)


def background_of(fitted, **settings):
    given = {"explained_above": 0.3, "unforeseen_share": 0.5, "return_s": 2.0, "sink_above": 0.3, "sink_s": 5.0}
    return Background(np.asarray(fitted, np.float32), 0.1, **given | settings)


def test_forecast_keeps_walls_and_the_base_rate_of_what_was_never_seen():
    background = background_of([[0.9, 0.1], [0.31, 0.0]])
    assert background.probabilities(1) == pytest.approx(np.array([[[0.9, 0.1], [0.31, 0.0]]] * 2))


def test_a_cell_seen_empty_comes_back_to_its_base_rate_ahead_in_time_and_while_it_is_hidden():
    background = background_of([[0.1]], unforeseen_share=0.25, return_s=2.0)
    seen, empty = np.ones((1, 1), bool), np.zeros((1, 1), bool)
    background.observe(frame_of(seen, empty))
    for hidden in range(3):
        shares = [1 - 0.75 * math.exp(-(hidden + step) * 0.1 / 2.0) for step in range(3)]
        assert background.probabilities(2).ravel() == pytest.approx([0.1 * share for share in shares], rel=1e-5)
        background.observe(frame_of(empty, empty))
    background.observe(frame_of(seen, empty))
    assert background.probabilities(0).item() == pytest.approx(0.025)


def test_what_stands_sinks_into_the_background_and_what_has_left_leaves_it():
    background = background_of([[0.0, 0.0]])
    seen, parked = np.ones((1, 2), bool), np.array([[True, False]])
    for _ in range(100):
        background.observe(frame_of(seen, parked))
    keep = math.exp(-0.1 / 5.0)
    frames = (1 - keep**100) / (1 - keep)
    sunk = np.array([[frames / (frames + PRIOR_FRAMES), 0.0]])
    assert background.probabilities(0)[0] == pytest.approx(sunk)
    for _ in range(100):
        background.observe(frame_of(~seen, ~seen))
    assert background.probabilities(0)[0] == pytest.approx(sunk)  # hidden is not gone
    for _ in range(100):
        background.observe(frame_of(seen, ~seen))
    assert background.probabilities(0)[0] == pytest.approx(np.zeros((1, 2)))


def test_a_wall_that_is_taken_away_is_forgotten():
    background = background_of([[0.9]])
    for _ in range(1000):
        background.observe(frame_of(np.ones((1, 1), bool), np.zeros((1, 1), bool)))
    frames = 1 / (1 - math.exp(-0.1 / 5.0))
    assert background.probabilities(0)[0, 0, 0] == pytest.approx(0.9 * PRIOR_FRAMES / (PRIOR_FRAMES + frames), rel=1e-5)


# Segmentation


def test_returns_nearer_than_the_link_are_one_cluster_and_chains_hold_together():
    points = np.array([[0.0, 0.0], [0.9, 0.0], [1.8, 0.0], [5.0, 0.0]])
    clusters = segment(points, np.zeros(4), link_m=1.0, link_per_m=0.0)
    assert sorted(len(cluster.points) for cluster in clusters) == [1, 3]


def test_the_link_grows_with_range_and_the_nearer_return_decides():
    points = np.array([[0.0, 0.0], [1.5, 0.0]])
    assert len(segment(points, np.array([10.0, 10.0]), 1.0, 0.1)) == 1
    assert len(segment(points, np.array([2.0, 10.0]), 1.0, 0.1)) == 2


def test_no_returns_are_no_clusters():
    assert segment(np.empty((0, 2)), np.empty(0), 1.0, 0.0) == []


# Estimation


def test_with_a_long_memory_the_motion_model_is_textbook_constant_velocity():
    dt, q = 0.1, 0.7
    transition, noise = motion_model(dt, q, velocity_memory_s=1e6)
    along = q**2 * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    assert transition == pytest.approx(np.kron([[1, dt], [0, 1]], np.eye(2)), abs=1e-6)
    assert noise == pytest.approx(np.kron(along, np.eye(2)), rel=1e-5)


def test_a_forgotten_velocity_carries_as_far_as_its_memory():
    estimator = ConstantVelocityKalman(np.zeros(2), 0.1, MotionNoise(0.5, 2.0, 0.1, 1.0))
    for step in range(60):
        estimator.predict()
        estimator.update(np.array([0.1 * (step + 1), 0.0]))
    velocity = estimator.mean[2]
    means, _ = estimator.ahead(400)
    assert means[10, 0] - means[0, 0] == pytest.approx(velocity * 2.0 * (1 - math.exp(-0.5)), rel=1e-6)
    assert means[400, 0] - means[0, 0] == pytest.approx(velocity * 2.0, rel=1e-6)


def test_looking_ahead_is_predicting_and_leaves_the_state():
    estimator = ConstantVelocityKalman(np.array([1.0, 2.0]), 0.1, MotionNoise(0.5, 2.0, 0.1, 1.0))
    estimator.predict()
    estimator.update(np.array([1.1, 2.0]))
    before = estimator.mean.copy(), estimator.covariance.copy()
    means, covariances = estimator.ahead(3)
    assert np.array_equal(before[0], estimator.mean)
    assert np.array_equal(before[1], estimator.covariance)
    for _ in range(3):
        estimator.predict()
    assert means[3] == pytest.approx(estimator.mean)
    assert covariances[3] == pytest.approx(estimator.covariance)


def test_the_filter_knows_how_wrong_it_is():
    """Mean normalised estimation error squared of a simulated motion is that of a consistent filter: 4 in 4 states."""
    random = np.random.default_rng(0)
    noise = MotionNoise(0.5, 2.0, 0.1, 0.7)
    transition, process = motion_model(0.1, noise.acceleration, noise.velocity_memory_s)
    errors = []
    for _ in range(100):
        truth = np.concatenate([np.zeros(2), random.normal(0, noise.initial_speed, 2)])
        estimator = ConstantVelocityKalman(random.normal(0, noise.position_noise_m, 2), 0.1, noise)
        for _ in range(20):
            truth = random.multivariate_normal(transition @ truth, process)
            estimator.predict()
            estimator.update(truth[:2] + random.normal(0, noise.position_noise_m, 2))
        off = truth - estimator.mean
        errors.append(off @ np.linalg.solve(estimator.covariance, off))
    assert np.mean(errors) == pytest.approx(4.0, abs=4 * math.sqrt(2 * 4 / 100))


# Association


def test_mahalanobis_distance_of_a_hand_computed_pair():
    distance = squared_mahalanobis(np.array([[2.0, 1.0]]), np.zeros((1, 2)), np.diag([4.0, 0.25])[None])
    assert distance == pytest.approx(np.array([[2.0**2 / 4.0 + 1.0 / 0.25]]))


@given(
    st.tuples(st.integers(1, 4), st.integers(1, 4)).flatmap(
        lambda shape: arrays(float, shape, elements=st.floats(0, 20))
    )
)
def test_assignment_is_the_best_of_all_assignments(distances):
    gate = 9.0
    pairs = assign(distances, gate)
    assert all(distances[track, cluster] <= gate for track, cluster in pairs.items())
    assert len(set(pairs.values())) == len(pairs)
    wide = distances if distances.shape[0] <= distances.shape[1] else distances.T
    best = min(
        (
            -sum(wide[r, c] <= gate for r, c in enumerate(p)),
            sum(wide[r, c] for r, c in enumerate(p) if wide[r, c] <= gate),
        )
        for p in permutations(range(wide.shape[1]), wide.shape[0])
    )
    assert -len(pairs) == best[0]
    assert sum(distances[track, cluster] for track, cluster in pairs.items()) == pytest.approx(best[1])


def test_a_stray_leg_joins_its_person_and_does_not_become_another():
    legs = [Cluster(np.array([[0.0, 0.0]])), Cluster(np.array([[0.4, 0.0]]))]
    shares, left = share_out(legs, {0: 0}, np.array([[0.1, 0.0]]), reach_m=0.5)
    assert len(shares[0].points) == 2
    assert left == []


def test_two_people_whose_returns_touch_stay_two():
    both = Cluster(np.array([[0.0, 0.0], [0.1, 0.0], [0.5, 0.0], [0.6, 0.0]]))
    shares, left = share_out([both], {0: 0}, np.array([[0.0, 0.1], [0.6, 0.1]]), reach_m=0.5)
    assert shares[0].points[:, 0].tolist() == [0.0, 0.1]
    assert shares[1].points[:, 0].tolist() == [0.5, 0.6]
    assert left == []


def test_a_cluster_out_of_reach_is_left_for_a_new_track():
    clusters = [Cluster(np.array([[0.0, 0.0]])), Cluster(np.array([[3.0, 0.0]]))]
    shares, left = share_out(clusters, {0: 0}, np.zeros((1, 2)), reach_m=0.5)
    assert list(shares) == [0]
    assert left == [clusters[1]]


# Dwell


def cells_at(*cells):
    occupied = np.zeros((5, 5), bool)
    for cell in cells:
        occupied[cell] = True
    return occupied


def test_the_age_of_a_return_goes_on_in_the_next_cell_and_starts_anew_elsewhere():
    ages = np.full((5, 5), NOT_OCCUPIED)
    for occupied in (cells_at((1, 1)), cells_at((1, 2)), cells_at((1, 2), (4, 4))):
        ages = next_ages(ages, occupied, oldest=10)
    assert (ages[1, 2], ages[4, 4]) == (2, 0)
    assert (ages == NOT_OCCUPIED).sum() == 23
    assert next_ages(ages, cells_at((1, 2)), oldest=2)[1, 2] == 2


def test_life_table_counts_who_is_still_there_where_it_can_be_seen():
    seen, hidden = np.ones((5, 5), bool), np.zeros((5, 5), bool)
    frames = [frame_of(seen, cells_at((1, 1))), frame_of(seen, cells_at((1, 1))), frame_of(hidden, cells_at())]
    table = fit_dwell([frames] * 100, np.ones((5, 5), bool), (3, 3))
    known = 1.0 / (1.0 + PRIOR_RETURNS / 100)
    assert table[0] == pytest.approx([known, known, 0.0])  # after two steps nothing is seen: the prior stands
    assert table[1] == pytest.approx([known, 0.0, 0.0])


def test_life_table_is_read_from_the_age_and_from_the_time_since_last_seen():
    table = np.array([[1.0, 0.5, 0.2], [0.9, 0.8, 0.7]], np.float32)
    assert staying(table, np.array([0, 5]), unseen=0, steps=3) == pytest.approx(
        np.array([[1.0, 0.5, 0.2, 0.2], [0.9, 0.8, 0.7, 0.7]])
    )
    assert staying(table, np.array([0]), unseen=1, steps=1) == pytest.approx(np.array([[0.5, 0.2]]))


# Life of a track


def test_existence_follows_bayes_rule():
    assert existence_when_detected(0.5, 0.9, 0.1) == pytest.approx(0.45 / (0.45 + 0.05))
    assert existence_when_missed(0.5, 0.9) == pytest.approx(0.05 / (0.05 + 0.5))


def test_a_miss_where_nothing_could_be_seen_says_nothing():
    assert existence_when_missed(0.7, 0.0) == 0.7


@given(st.floats(0.01, 0.99), st.integers(1, 60))
def test_a_shape_that_does_not_change_keeps_one_frame_of_weight(keep, frames):
    offsets = np.array([[0.0, 0.0], [0.2, 0.0]])
    shape = Shape.of(offsets)
    for _ in range(frames):
        shape.extend(offsets, keep)
    assert len(shape.weights) <= MAX_POINTS
    assert 0.9 * 2 <= shape.weights.sum() <= 2 + 1e-9


# Forecast


def test_points_in_the_middle_of_cells_are_drawn_as_those_cells():
    patch = splat(np.array([[0.0, 0.0], [0.2, -0.1]]), np.array([1.0, 0.5]), cell_m=0.1)
    half = patch.shape[0] // 2
    assert patch[half, half] == pytest.approx(1.0)
    assert patch[half - 1, half + 2] == pytest.approx(0.5)  # x is along columns, y along rows
    assert patch.sum() == pytest.approx(1.5)


def test_a_blurred_point_is_the_gaussian_mass_of_every_cell():
    image = np.zeros((1, 21, 21), np.float32)
    point = np.pad(np.ones((1, 1), np.float32), 1)
    draw(image, point, np.array([[10.5, 12.5]]), np.array([[1.0, 2.0]]), np.ones(1))

    def mass(low, high, mean, sigma):
        return 0.5 * (math.erf((high - mean) / sigma / math.sqrt(2)) - math.erf((low - mean) / sigma / math.sqrt(2)))

    assert image[0, 12, 10] == pytest.approx(mass(10, 11, 10.5, 1) * mass(12, 13, 12.5, 2), rel=1e-5)
    assert image[0, 15, 9] == pytest.approx(mass(9, 10, 10.5, 1) * mass(15, 16, 12.5, 2), rel=1e-5)


def test_points_that_stay_are_drawn_where_they_are_and_weighted_step_by_step():
    image, expected = np.zeros((2, 2, 9, 9), np.float32)
    places, weights = np.array([[2.5, 3.5], [6.0, 5.0]]), np.array([[1.0, 0.5], [0.3, 0.2]], np.float32)
    draw_points(image, places, 0.6, weights)
    for place, weight in zip(places, weights, strict=True):
        one_point = np.pad(np.ones((1, 1), np.float32), 1)
        draw(expected, one_point, np.tile(place, (2, 1)), np.full((2, 2), 0.6), weight)
    assert image == pytest.approx(expected, abs=1e-6)


def test_blur_spreads_the_mass_and_keeps_it():
    sigmas = np.array([0.5, 1.0, 2.0, 3.0])
    image = np.zeros((4, 61, 61), np.float32)
    patch = splat(np.array([[0.0, 0.0], [0.3, 0.1]]), np.ones(2), 0.1)
    draw(image, patch, np.tile([30.2, 30.7], (4, 1)), np.stack([sigmas, sigmas], 1), np.ones(4))
    assert image.sum(axis=(1, 2)) == pytest.approx(np.full(4, 2.0), rel=2e-3)
    assert (np.diff(image.max(axis=(1, 2))) < 0).all()
    columns = np.arange(61) + 0.5
    across = image.sum(axis=1) / image.sum(axis=(1, 2))[:, None]
    variance = (across * columns**2).sum(axis=1) - (across * columns).sum(axis=1) ** 2
    own = 1.5**2 + 1 / 12  # two points three cells apart, and the width of a cell
    assert variance == pytest.approx(sigmas**2 + own, rel=0.02)


def test_what_leaves_the_grid_is_cut_off_at_its_edge():
    image = np.zeros((1, 8, 8), np.float32)
    point = np.pad(np.ones((1, 1), np.float32), 1)
    draw(image, point, np.array([[0.0, 4.5]]), np.array([[1.0, 0.3]]), np.ones(1))
    assert image.sum() == pytest.approx(0.5, rel=2e-3)
    draw(image, point, np.array([[-500.0, 4.5]]), np.array([[1.0, 0.3]]), np.ones(1))
    assert image.sum() == pytest.approx(0.5, rel=2e-3)


def test_independent_causes_combine_by_noisy_or():
    occupancy = np.full((2, 1, 1), 0.2, np.float32)
    noisy_or(occupancy, np.full((2, 1, 1), 0.5, np.float32), np.array([1.0, 0.5]))
    assert occupancy.ravel() == pytest.approx([1 - 0.8 * 0.5, 1 - 0.8 * 0.75])

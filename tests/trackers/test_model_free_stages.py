"""Each stage of the model-free pipeline against a hand-computed case or an independent implementation."""

from __future__ import annotations

import math
from itertools import permutations, product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.stats import chi2

pytest.importorskip("filterpy")
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame
from gridtrack.trackers.model_free.association import (
    assign,
    distances_to,
    gaps,
    hungarian,
    joint_compatibility,
    share_out,
)
from gridtrack.trackers.model_free.background import Background, BackgroundMap, fit_background
from gridtrack.trackers.model_free.dwell import NOT_OCCUPIED, PRIOR_RETURNS, fit_dwell, next_ages, still_there
from gridtrack.trackers.model_free.segmentation import Cluster
from gridtrack.trackers.model_free.settings import PipelineSettings
from gridtrack.trackers.model_free.tracks import existence_when_detected, existence_when_missed
from gridtrack.trackers.site_rate import PRIOR_FRAMES


def cluster(points):
    """A cluster that nothing cuts off."""
    return Cluster(np.asarray(points, float), np.zeros(len(points), bool))


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
    assert background.rate[0, 0] == pytest.approx((3 + PRIOR_FRAMES * base_rate) / (4 + PRIOR_FRAMES))
    assert background.rate[1, 4] == pytest.approx(PRIOR_FRAMES * base_rate / (4 + PRIOR_FRAMES))
    assert background.rate[4, 4] == pytest.approx(base_rate)


def test_a_wall_over_which_returns_flicker_is_solid_and_a_place_that_is_busy_as_often_is_not():
    seen = np.ones((5, 9), bool)
    frames = []
    for step in range(1000):
        occupied = np.zeros((5, 9), bool)
        occupied[2, 1 + step % 2] = True
        occupied[2, 6:8] = step % 2 == 0
        frames.append(frame_of(seen, occupied))
    background = fit_background(frames, (5, 9))
    assert background.rate[2, [1, 2, 6, 7]] == pytest.approx(0.5, abs=0.01)
    assert (background.solid[1:4, 1:3] > 0.98).all()
    assert (background.solid[:, 5:] < 0.55).all()


MAP_FRAMES = 40


def background_of(rate, solid=0.0, **settings):
    given = {"explained_above": 0.9, "unforeseen_share": 0.5, "return_s": 2.0, "sink_above": 0.3, "sink_s": 5.0}
    given["map_s"] = 0.1 * MAP_FRAMES
    rate = np.asarray(rate, np.float32)
    fitted = BackgroundMap(rate, np.broadcast_to(np.asarray(solid, np.float32), rate.shape))
    return Background(fitted, 0.1, PipelineSettings(**given | settings))


def test_forecast_keeps_walls_and_the_base_rate_of_what_was_never_seen():
    background = background_of([[0.9, 0.1], [0.31, 0.0]], [[1.0, 0.0], [0.0, 0.0]])
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
    sunk = np.array([[frames / (frames + MAP_FRAMES), 0.0]])
    assert background.probabilities(0)[0] == pytest.approx(sunk)
    for _ in range(100):
        background.observe(frame_of(~seen, ~seen))
    assert background.probabilities(0)[0] == pytest.approx(sunk)  # hidden is not gone
    for _ in range(100):
        background.observe(frame_of(seen, ~seen))
    assert background.probabilities(0)[0] == pytest.approx(np.zeros((1, 2)))


def test_a_frame_after_missed_ones_stands_for_all_of_them():
    seen, parked, hidden = np.ones((1, 2), bool), np.array([[True, False]]), np.zeros((1, 2), bool)
    missed, whole = (background_of([[0.1, 0.1]], unforeseen_share=0.25) for _ in range(2))
    for background, periods in ((missed, (3, 2)), (whole, (1, 1, 1, 1, 1))):
        for count in periods:
            background.observe(frame_of(seen, parked), count)
    assert missed.probabilities(2) == pytest.approx(whole.probabilities(2), rel=1e-5)
    missed.observe(frame_of(hidden, hidden), 4)
    for _ in range(4):
        whole.observe(frame_of(hidden, hidden))
    assert missed.probabilities(2) == pytest.approx(whole.probabilities(2), rel=1e-5)
    assert missed.hidden_s == pytest.approx(np.full((1, 2), 0.4))


def test_a_wall_that_is_taken_away_is_forgotten():
    background = background_of([[0.9]], 1.0)
    for _ in range(1000):
        background.observe(frame_of(np.ones((1, 1), bool), np.zeros((1, 1), bool)))
    frames = 1 / (1 - math.exp(-0.1 / 5.0))
    assert background.probabilities(0)[0, 0, 0] == pytest.approx(0.9 * MAP_FRAMES / (MAP_FRAMES + frames), rel=1e-5)


# Association


@given(
    st.tuples(st.integers(1, 4), st.integers(1, 4)).flatmap(
        lambda shape: arrays(float, shape, elements=st.floats(0, 20))
    )
)
def test_assignment_is_the_best_of_all_assignments(costs):
    gate = 9.0
    pairs = hungarian(np.where(costs <= gate, costs, np.inf))
    assert all(costs[track, cluster] <= gate for track, cluster in pairs.items())
    assert len(set(pairs.values())) == len(pairs)
    wide = costs if costs.shape[0] <= costs.shape[1] else costs.T
    chosen = [wide[np.arange(len(wide)), list(p)] for p in permutations(range(wide.shape[1]), wide.shape[0])]
    best = min((-(some <= gate).sum(), some[some <= gate].sum()) for some in chosen)
    assert -len(pairs) == best[0]
    assert sum(costs[track, cluster] for track, cluster in pairs.items()) == pytest.approx(best[1])


@given(
    st.tuples(st.integers(1, 4), st.integers(1, 4)).flatmap(
        lambda shape: arrays(float, shape, elements=st.floats(0, 11))
    )
)
def test_joint_compatibility_finds_the_largest_likely_set_of_pairs(distances):
    """Every pair is likely for itself, so that all tracks are one group that competes."""
    limits = chi2.ppf(0.99, 3 * np.arange(1, 5))
    tracks, clusters = distances.shape
    costs = np.where(distances <= limits[0], distances, np.inf)
    best = (0, 0.0)
    for choice in product(range(-1, clusters), repeat=tracks):
        pairs = [(t, c) for t, c in enumerate(choice) if c >= 0]
        total = sum(distances[pair] for pair in pairs)
        likely = all(distances[pair] <= limits[0] for pair in pairs) and (not pairs or total <= limits[len(pairs) - 1])
        if len({c for _, c in pairs}) == len(pairs) and likely:
            best = max(best, (len(pairs), -total))
    found = joint_compatibility(costs, distances, np.full(distances.shape, 3), 0.99)
    assert len(set(found.values())) == len(found) == best[0]
    assert sum(distances[pair] for pair in found.items()) == pytest.approx(-best[1])


def assigned(distances, method, freedom=3):
    distances = np.asarray(distances)
    return assign(distances, distances, np.full(distances.shape, freedom), 0.99, method)


def test_joint_compatibility_beats_taking_the_nearest():
    """Two who walk abreast, both a little further than predicted: the nearest cluster of one is the other's."""
    distances = np.array([[4.0, 2.0], [60.0, 3.0]])
    nearest = {int(t): int(distances[t].argmin()) for t in range(2)}
    assert nearest == {0: 1, 1: 1}
    assert assigned(distances, "jcbb") == {0: 0, 1: 1}


def test_joint_compatibility_beats_gating_each_pair_for_itself():
    """The first has gone and the second is where it was expected; a newcomer is just near enough to that one.

    To give each a cluster, one has to take another's and the other a newcomer: likely for each, and not together.
    """
    distances = np.array([[9.0, np.inf], [0.5, 10.5]])
    assert assigned(distances, "hungarian") == {0: 0, 1: 1}
    assert assigned(distances, "jcbb") == {1: 0}


def test_joint_compatibility_refuses_pairs_that_are_each_just_likely_but_not_together():
    gate = chi2.ppf(0.99, 3)
    distances = np.full((4, 4), np.inf)
    np.fill_diagonal(distances, 0.7 * gate)
    distances[0, 1] = distances[1, 2] = distances[2, 3] = 0.7 * gate  # one group that competes
    assert len(assigned(distances, "hungarian")) == 4
    assert len(assigned(distances, "jcbb")) == 2


@pytest.mark.parametrize("method", ["hungarian", "jcbb"])
def test_the_gate_lets_in_the_stated_share_of_poses_with_and_without_a_heading(method):
    for freedom in (2, 3):
        gate = chi2.ppf(0.99, freedom)
        assert assigned([[0.999 * gate]], method, freedom) == {0: 0}
        assert assigned([[1.001 * gate]], method, freedom) == {}
    both = np.diag([0.7 * chi2.ppf(0.99, 2)] * 2) + 1e6 * (1 - np.eye(2))
    assert len(assigned(both, method, freedom=3)) == 2


def test_a_crowd_too_large_to_search_is_never_worse_off_than_by_the_hungarian_less_its_most_distant_pairs():
    distances = np.full((10, 10), 0.6 * chi2.ppf(0.99, 3))
    pairs = assigned(distances, "jcbb")
    assert len(pairs) == 3
    assert sum(distances[pair] for pair in pairs.items()) <= chi2.ppf(0.99, 9) < 4 * distances[0, 0]
    random = np.random.default_rng(0)
    for _ in range(5):
        distances = random.uniform(0.0, 15.0, (12, 12))
        pairs, each = assigned(distances, "jcbb"), assigned(distances, "hungarian")
        kept = sorted(distances[pair] for pair in each.items())
        likely = np.cumsum(kept) <= chi2.ppf(0.99, 3 * np.arange(1, len(kept) + 1))
        assert len(pairs) >= np.flatnonzero(likely).max() + 1


def test_distance_from_a_boundary_is_that_of_its_nearest_point():
    points = np.array([[0.0, 0.0], [3.0, 4.0], [10.0, 0.0]])
    boundaries = [np.array([[0.0, 1.0], [3.0, 3.5]]), np.array([[10.0, 2.0]])]
    distances = distances_to(points, boundaries)
    hand_computed = [[1.0, np.hypot(10, 2)], [0.5, np.hypot(7, 2)], [np.hypot(7, 3.5), 2.0]]
    assert distances == pytest.approx(np.array(hand_computed))
    assert gaps(distances, [cluster(points[:2]), cluster(points[2:])]) == pytest.approx(
        np.array([[0.5, np.hypot(7, 3.5)], [np.hypot(7, 2), 2.0]])
    )


def shared(clusters, pairs, positions, reach_m):
    points = np.concatenate([cluster.points for cluster in clusters])
    distances = distances_to(points, [np.array([place]) for place in positions])
    return share_out(clusters, pairs, distances, gaps(distances, clusters) <= reach_m)


def test_a_stray_leg_joins_its_person_and_does_not_become_another():
    legs = [cluster([[0.0, 0.0]]), cluster([[0.4, 0.0]])]
    shares, left = shared(legs, {0: 0}, [(0.1, 0.0)], reach_m=0.5)
    assert len(shares[0].points) == 2
    assert left == []


def test_two_people_whose_returns_touch_stay_two():
    both = cluster([[0.0, 0.0], [0.1, 0.0], [0.5, 0.0], [0.6, 0.0]])
    shares, left = shared([both], {0: 0}, [(0.0, 0.1), (0.6, 0.1)], reach_m=0.5)
    assert shares[0].points[:, 0].tolist() == [0.0, 0.1]
    assert shares[1].points[:, 0].tolist() == [0.5, 0.6]
    assert left == []


def test_a_cluster_out_of_reach_is_left_for_a_new_track():
    clusters = [cluster([[0.0, 0.0]]), cluster([[3.0, 0.0]])]
    shares, left = shared(clusters, {0: 0}, [(0.0, 0.0)], reach_m=0.5)
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
    late = next_ages(ages, cells_at((1, 2), (0, 4)), oldest=10, periods=3)
    assert (late[1, 2], late[0, 4]) == (5, 0)


def test_life_table_counts_who_is_still_there_where_it_can_be_seen():
    seen, hidden = np.ones((5, 5), bool), np.zeros((5, 5), bool)
    frames = [frame_of(seen, cells_at((1, 1))), frame_of(seen, cells_at((1, 1))), frame_of(hidden, cells_at())]
    table = fit_dwell([frames] * 100, np.ones((5, 5), bool), (3, 3))
    known = 1.0 / (1.0 + PRIOR_RETURNS / 100)
    assert table[0] == pytest.approx([known, known, 0.0])  # after two steps nothing is seen: the prior stands
    assert table[1] == pytest.approx([known, 0.0, 0.0])


def test_life_table_is_read_from_the_age_and_from_the_time_since_last_seen():
    table = np.array([[1.0, 0.5, 0.2], [0.9, 0.8, 0.7]], np.float32)
    assert still_there(table, np.array([0, 5]), unseen=np.array([0, 0]), steps=3) == pytest.approx(
        np.array([[1.0, 0.5, 0.2, 0.2], [0.9, 0.8, 0.7, 0.7]])
    )
    assert still_there(table, np.array([0]), unseen=np.array([1]), steps=1) == pytest.approx(np.array([[0.5, 0.2]]))


# Life of a track


def test_existence_follows_bayes_rule():
    assert existence_when_detected(0.5, 0.9, 0.1) == pytest.approx(0.45 / (0.45 + 0.05))
    assert existence_when_missed(0.5, 0.9) == pytest.approx(0.05 / (0.05 + 0.5))


def test_a_miss_where_nothing_could_be_seen_says_nothing():
    assert existence_when_missed(0.7, 0.0) == 0.7

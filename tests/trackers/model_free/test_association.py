"""Association: optimal assignment, joint compatibility of pairs, and assignment of returns to the nearest boundary."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.stats import chi2

from gridtrack.trackers.model_free.association import (
    assign,
    assign_returns,
    distances_to,
    gaps,
    hungarian,
    joint_compatibility,
)
from gridtrack.trackers.model_free.segmentation import Cluster


def cluster(points):
    """A cluster without cut-off returns."""
    return Cluster(np.asarray(points, float), np.zeros(len(points), bool))


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
    """Each pair passes its gate, so that all tracks are one group of competitors."""
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


def test_joint_compatibility_finds_better_pairs_than_individual_gates():
    """The first has gone and the second is where it was expected; a newcomer is just near enough to that one.

    To give each a cluster, one has to take another's and the other a newcomer: likely for each, and not together.
    """
    distances = np.array([[9.0, np.inf], [0.5, 10.5]])
    assert assigned(distances, "hungarian") == {0: 0, 1: 1}
    assert assigned(distances, "jcbb") == {1: 0}


@pytest.mark.parametrize("method", ["hungarian", "jcbb"])
def test_the_gate_contains_the_stated_share_of_poses_with_and_without_a_heading(method):
    for freedom in (2, 3):
        gate = chi2.ppf(0.99, freedom)
        assert assigned([[0.999 * gate]], method, freedom) == {0: 0}
        assert assigned([[1.001 * gate]], method, freedom) == {}
    both = np.diag([0.7 * chi2.ppf(0.99, 2)] * 2) + 1e6 * (1 - np.eye(2))
    assert len(assigned(both, method, freedom=3)) == 2


def test_a_limited_search_is_at_least_as_good_as_the_pruned_hungarian_assignment():
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


def test_distance_from_a_boundary_is_the_distance_from_its_nearest_point():
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
    return assign_returns(clusters, pairs, distances, gaps(distances, clusters) <= reach_m)


def test_a_separate_leg_belongs_to_its_person():
    legs = [cluster([[0.0, 0.0]]), cluster([[0.4, 0.0]])]
    shares, left = shared(legs, {0: 0}, [(0.1, 0.0)], reach_m=0.5)
    assert len(shares[0].points) == 2
    assert left == []


def test_two_people_in_contact_remain_two():
    both = cluster([[0.0, 0.0], [0.1, 0.0], [0.5, 0.0], [0.6, 0.0]])
    shares, left = shared([both], {0: 0}, [(0.0, 0.1), (0.6, 0.1)], reach_m=0.5)
    assert shares[0].points[:, 0].tolist() == [0.0, 0.1]
    assert shares[1].points[:, 0].tolist() == [0.5, 0.6]
    assert left == []


def test_a_cluster_out_of_reach_is_unassigned():
    clusters = [cluster([[0.0, 0.0]]), cluster([[3.0, 0.0]])]
    shares, left = shared(clusters, {0: 0}, [(0.0, 0.0)], reach_m=0.5)
    assert list(shares) == [0]
    assert left == [clusters[1]]

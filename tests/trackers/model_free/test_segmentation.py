"""Clusters of returns, against hand-made chains and an independent implementation."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse.csgraph import connected_components

pytest.importorskip("filterpy")
from gridtrack.trackers.model_free.segmentation import clusters_of, segment


def test_returns_nearer_than_the_link_are_one_cluster_and_chains_hold_together():
    points = np.array([[0.0, 0.0], [0.9, 0.0], [1.8, 0.0], [5.0, 0.0]])
    labels = segment(points, np.zeros(4), link_m=1.0, link_per_m=0.0)
    clusters = clusters_of(points, np.array([False, True, False, False]), labels)
    assert sorted(len(cluster.points) for cluster in clusters) == [1, 3]
    assert [cluster.points[cluster.cut].tolist() for cluster in clusters if cluster.cut.any()] == [[[0.9, 0.0]]]


def test_the_link_grows_with_range_and_the_nearer_return_decides():
    points = np.array([[0.0, 0.0], [1.5, 0.0]])
    assert len(set(segment(points, np.array([10.0, 10.0]), 1.0, 0.1))) == 1
    assert len(set(segment(points, np.array([2.0, 10.0]), 1.0, 0.1))) == 2


@given(st.integers(0, 60), st.integers(0, 10_000))
def test_clusters_are_the_connected_components_of_the_links(count, seed):
    random = np.random.default_rng(seed)
    points, ranges = random.uniform(0, 6, (count, 2)).round(1), random.uniform(0, 20, count)
    reach = 0.3 + 0.03 * ranges
    apart = np.linalg.norm(points[:, None] - points, axis=2)
    _, wanted = connected_components(apart <= np.minimum(reach[:, None], reach), directed=False)
    assert segment(points, ranges, 0.3, 0.03).tolist() == wanted.tolist()


def test_no_returns_are_no_clusters():
    nothing = np.empty((0, 2))
    assert clusters_of(nothing, np.empty(0, bool), segment(nothing, np.empty(0), 1.0, 0.0)) == []

"""Segmentation: the returns that the background does not explain, as clusters; the linking distance adapts to range."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

Points = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Cluster:
    """Returns that belong together: `points` (N, 2), metres, world frame."""

    points: Points

    @property
    def centre(self) -> Points:
        """Mean of the points, (2,), metres, world frame."""
        return np.asarray(self.points.mean(axis=0))


def segment(points: Points, ranges: NDArray[np.float64], link_m: float, link_per_m: float) -> list[Cluster]:
    """Single-linkage clusters of `points` (N, 2) in metres, each at its range (N,) from its sensor in metres.

    Two points are linked when they are no further apart than `link_m + link_per_m * range` at the nearer's range.
    """
    if not len(points):
        return []
    reach = link_m + link_per_m * ranges
    pairs = cKDTree(points).query_pairs(float(reach.max()), output_type="ndarray")
    first, second = pairs[:, 0], pairs[:, 1]
    distance = np.linalg.norm(points[first] - points[second], axis=1)
    near = distance <= np.minimum(reach[first], reach[second])
    graph = coo_array((near[near], (first[near], second[near])), shape=(len(points), len(points)))
    count, labels = connected_components(graph, directed=False)
    return [Cluster(points[labels == label]) for label in range(count)]

"""Segmentation: the returns that the background does not explain, as clusters; the linking distance adapts to range."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from gridtrack.common.grid import Mask

Points = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Cluster:
    """Returns that belong together: `points` (N, 2), metres, grid frame, and which of them are `cut` off (N,)."""

    points: Points
    cut: Mask
    """At these the surface may go on unseen (`occlusion.cut_off`)."""

    def __len__(self) -> int:
        return len(self.points)

    @property
    def centre(self) -> Points:
        """Mean of the points, (2,), metres, grid frame."""
        return np.asarray(self.points.mean(axis=0))


def segment(points: Points, ranges: NDArray[np.float64], link_m: float, link_per_m: float) -> NDArray[np.int64]:
    """Single-linkage clusters of `points` (N, 2) in metres, each at its range (N,) from its sensor in metres.

    Two points are linked when they are no further apart than `link_m + link_per_m * range` at the nearer's range.
    Returns the number of the cluster that each is of (N,).
    """
    if not len(points):
        return np.zeros(0, np.int64)
    reach = link_m + link_per_m * ranges
    pairs = cKDTree(points).query_pairs(float(reach.max()), output_type="ndarray")
    first, second = pairs[:, 0], pairs[:, 1]
    distance = np.linalg.norm(points[first] - points[second], axis=1)
    near = distance <= np.minimum(reach[first], reach[second])
    graph = coo_array((near[near], (first[near], second[near])), shape=(len(points), len(points)))
    return np.asarray(connected_components(graph, directed=False)[1], np.int64)


def clusters_of(points: Points, cut: Mask, labels: NDArray[np.int64]) -> list[Cluster]:
    """The clusters that `segment` numbered."""
    if not len(points):
        return []
    order = np.argsort(labels, kind="stable")
    ends = np.cumsum(np.bincount(labels))[:-1]
    return [Cluster(*parts) for parts in zip(np.split(points[order], ends), np.split(cut[order], ends), strict=True)]

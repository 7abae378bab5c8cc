"""Segmentation: the returns that the background does not explain, as clusters; the linking distance adapts to range."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numba
import numpy as np
from numpy.typing import NDArray

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
    return np.asarray(_segment(points, link_m + link_per_m * ranges, np.argsort(points[:, 0])))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _segment(points, reach, order):  # type: ignore[no-untyped-def]
    """As `segment`, of points (N, 2) that each reach so far (N,), swept in the `order` (N,) of their x.

    Clusters are trees of points that lead to their first one (union-find; Tarjan 1975).
    """
    parent = np.arange(len(points))
    for n in range(len(order)):
        i = order[n]
        for m in range(n + 1, len(order)):
            j = order[m]
            dx, dy, near = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1], min(reach[i], reach[j])
            if dx > reach[i]:
                break
            if dx * dx + dy * dy <= near * near:
                first, second = _first(parent, i), _first(parent, j)
                parent[max(first, second)] = min(first, second)
    labels, count = np.empty(len(points), np.int64), 0
    for i in range(len(points)):
        if parent[i] == i:
            labels[i] = count
            count += 1
        else:
            labels[i] = labels[_first(parent, i)]
    return labels


@numba.njit(error_model="numpy")
def _first(parent, i):  # type: ignore[no-untyped-def]
    """The first point of the cluster of point i; the way to it is halved."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


def clusters_of(points: Points, cut: Mask, labels: NDArray[np.int64]) -> list[Cluster]:
    """The clusters that `segment` numbered."""
    if not len(points):
        return []
    order = np.argsort(labels, kind="stable")
    points, cut, bounds = points[order], cut[order], np.cumsum(np.bincount(labels)).tolist()
    return [Cluster(points[first:last], cut[first:last]) for first, last in pairwise([0, *bounds])]


def joined(parts: Sequence[Cluster]) -> Cluster:
    """The parts as one, itself where there is only one."""
    if len(parts) == 1:
        return parts[0]
    return Cluster(np.concatenate([part.points for part in parts]), np.concatenate([part.cut for part in parts]))

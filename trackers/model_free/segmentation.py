"""Segmentation: clusters of the foreground returns, and the returns where an occluder cuts off a surface."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numba
import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import GridFrame, GridSpec, Mask
from gridtrack.trackers.model_free.arrays import Array

BEARINGS = 1440
"""Number of bearing bins around a sensor."""
NO_RETURN, BACKGROUND = -2, -1
"""Label of a bearing without a return, and of a return outside all clusters."""


@dataclass(frozen=True, slots=True)
class Cluster:
    """Returns of one cluster: `points` (N, 2), metres, fixed frame; at points that are `cut` off (N,) an occluder may
    hide the continuation of the surface (`cut_off_returns`)."""

    points: Array
    cut: Mask

    def __len__(self) -> int:
        return len(self.points)

    @property
    def centre(self) -> Array:
        """Mean of the points, (2,), metres, fixed frame."""
        return np.asarray(self.points.mean(axis=0))


def segment(points: Array, ranges: Array, link_m: float, link_per_m: float) -> NDArray[np.int64]:
    """Single-linkage clusters of `points` (N, 2) in metres, each at its range (N,) from its sensor in metres.

    Two points are linked if their distance is at most `link_m + link_per_m * range`, at the smaller range.
    Returns the cluster number of each point (N,).
    """
    return np.asarray(_segment(points, link_m + link_per_m * ranges, np.argsort(points[:, 0])))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _segment(points, reach, order):  # type: ignore[no-untyped-def]
    """`segment` of points (N, 2) with linking distances `reach` (N,), in the `order` (N,) of their x.

    Clusters are trees of points, rooted at the first one (union-find; Tarjan 1975).
    """
    parent = np.empty(len(points), np.int64)
    for i in range(len(points)):
        parent[i] = i
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
    """The first point of the cluster of point i, with path halving."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


def clusters_of(points: Array, cut: Mask, labels: NDArray[np.int64]) -> list[Cluster]:
    """The clusters with the cluster numbers `labels` (N,) of `segment`."""
    if not len(points):
        return []
    order = np.argsort(labels, kind="stable")
    points, cut, bounds = points[order], cut[order], np.cumsum(np.bincount(labels)).tolist()
    return [Cluster(points[first:last], cut[first:last]) for first, last in pairwise([0, *bounds])]


def joined(parts: Sequence[Cluster]) -> Cluster:
    """One cluster of all parts; the part itself if there is only one."""
    if len(parts) == 1:
        return parts[0]
    return Cluster(np.concatenate([part.points for part in parts]), np.concatenate([part.cut for part in parts]))


def cut_off_returns(frame: GridFrame, grid: GridSpec, labels: NDArray[np.int64]) -> Mask:
    """The returns of the frame (N,) with a hidden neighbour cell that their own cluster does not hide.

    `labels` (N,) are cluster numbers, or BACKGROUND. Cells outside the grid count as hidden.
    """
    cut = np.zeros(len(frame.points), np.bool_)
    for sensor, origin in enumerate(frame.origins):
        own = frame.point_origin == sensor
        points = (frame.points[own] - origin).astype(np.float64)
        corner = np.array(grid.origin) - origin
        cut[own] = _cut_off(points, labels[own], frame.visible, corner, grid.cell_m)
    return cut


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _cut_off(points, labels, visible, corner, cell_m):  # type: ignore[no-untyped-def]
    """`cut_off_returns` for one sensor at (0, 0), with the lower-left corner of the grid at `corner` (2,)."""
    ranges, nearest = _first_returns(points, labels, cell_m)
    size = len(visible)
    cut = np.zeros(len(points), np.bool_)
    for i in range(len(points)):
        if labels[i] == BACKGROUND:
            continue
        column, row = math.floor((points[i, 0] - corner[0]) / cell_m), math.floor((points[i, 1] - corner[1]) / cell_m)
        for k in range(9):
            r, c = row + k // 3 - 1, column + k % 3 - 1
            if not (0 <= r < size and 0 <= c < size):
                cut[i] = True
            elif not visible[r, c]:
                x, y = corner[0] + (c + 0.5) * cell_m, corner[1] + (r + 0.5) * cell_m
                b = _bearing_bin(math.atan2(y, x))
                if not (nearest[b] == labels[i] and ranges[b] <= math.hypot(x, y)):
                    cut[i] = True
    return cut


@numba.njit(error_model="numpy")
def _first_returns(points, labels, cell_m):  # type: ignore[no-untyped-def]
    """Range and label (BEARINGS,) of the nearest return in each bearing bin; a return is one cell wide."""
    ranges, nearest = np.full(BEARINGS, np.inf), np.full(BEARINGS, NO_RETURN)
    for i in range(len(points)):
        away = max(math.hypot(points[i, 0], points[i, 1]), 1e-6)
        bearing, half = math.atan2(points[i, 1], points[i, 0]), math.atan2(0.6 * cell_m, away)
        first = math.floor((bearing - half) / (2.0 * math.pi) * BEARINGS)
        last = math.floor((bearing + half) / (2.0 * math.pi) * BEARINGS)
        for b in range(first, last + 1):
            if away < ranges[b % BEARINGS]:
                ranges[b % BEARINGS], nearest[b % BEARINGS] = away, labels[i]
    return ranges, nearest


@numba.njit(error_model="numpy")
def _bearing_bin(bearing):  # type: ignore[no-untyped-def]
    return math.floor(bearing / (2.0 * math.pi) * BEARINGS) % BEARINGS

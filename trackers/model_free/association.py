"""Association: which cluster may be which track (the gate), which is (the assignment), and whose each return is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from typing import Literal

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.sparse.csgraph import connected_components
from scipy.stats import chi2

from gridtrack.trackers.model_free.ragged import bounds_of, split
from gridtrack.trackers.model_free.segmentation import Cluster, joined

Array = NDArray[np.float64]

Method = Literal["hungarian", "jcbb"]
"""How clusters are assigned to tracks: each pair likely, or the whole set of pairs."""
MEASURED = 3
"""Degrees of freedom of a pair: x, y and heading."""
MAX_NODES = 20_000
"""The most hypotheses that are tried for one group of tracks that compete."""


def assign(costs: Array, distances: Array, probability: float, method: Method) -> dict[int, int]:
    """Track -> cluster, from `costs` and squared Mahalanobis `distances` (T, C), infinite where out of question.

    `probability` is the share of true pairs, or with JCBB of true sets of pairs, that the gate lets in.
    """
    if method == "jcbb":
        return joint_compatibility(costs, distances, probability)
    return hungarian(np.where(distances <= _gate(probability), costs, np.inf))


@cache
def _gate(probability: float) -> float:
    return float(chi2.ppf(probability, MEASURED))


def hungarian(costs: Array) -> dict[int, int]:
    """Track -> cluster: as many pairs of finite cost (T, C) as can be, at the least sum of costs."""
    possible = np.isfinite(costs)
    beyond = 1.0 + costs[possible].sum()
    rows, columns = linear_sum_assignment(np.where(possible, costs, beyond))
    return {int(t): int(c) for t, c in zip(rows, columns, strict=True) if possible[t, c]}


def joint_compatibility(costs: Array, distances: Array, probability: float) -> dict[int, int]:
    """Track -> cluster: the largest set of pairs that is likely as a whole, at the least sum of costs (T, C).

    Joint compatibility branch and bound (Neira and Tardos, IEEE Transactions on Robotics and Automation 2001). Tracks
    are filtered each for itself, so the joint distance is the sum of `distances` (T, C); each group of tracks that
    compete for clusters is a problem of its own. After MAX_NODES the best set so far stands: the branches are tried
    best pair first, so it is never worse than taking the nearest.
    """
    limits = chi2.ppf(probability, MEASURED * np.arange(1, len(costs) + 1))
    possible = np.isfinite(costs) & (distances <= limits[:1])
    pairs: dict[int, int] = {}
    for tracks in _components(possible):
        pairs |= _Search(costs, distances, possible, tracks, limits).best
    return pairs


class _Search:
    """Branch and bound over one group of `tracks` that compete for clusters; `best` is track -> cluster."""

    def __init__(self, costs: Array, distances: Array, possible: NDArray[np.bool_], tracks: list[int], limits: Array):
        self.costs, self.distances, self.limits, self.tracks = costs, distances, limits, tracks
        self.options = [[c for c in np.argsort(costs[t]) if possible[t, c]] for t in tracks]
        self.best: dict[int, int] = {}
        self.best_cost = np.inf
        self.nodes = 0
        self._branch(0, {}, 0.0, 0.0)

    def _branch(self, depth: int, pairs: dict[int, int], distance: float, cost: float) -> None:
        """Try every cluster for the track at `depth`, and none, where that can still make a better set."""
        self.nodes += 1
        attainable = len(pairs) + len(self.tracks) - depth
        if self.nodes > MAX_NODES or (attainable, -cost) <= (len(self.best), -self.best_cost):
            return
        if depth == len(self.tracks):
            if not pairs or distance <= self.limits[len(pairs) - 1]:
                self.best, self.best_cost = dict(pairs), cost
            return
        track = self.tracks[depth]
        for cluster in self.options[depth]:
            joint = distance + self.distances[track, cluster]
            if cluster not in pairs.values() and joint <= self.limits[attainable - 1]:
                pairs[track] = int(cluster)
                self._branch(depth + 1, pairs, joint, cost + self.costs[track, cluster])
                del pairs[track]
        self._branch(depth + 1, pairs, distance, cost)


def _components(possible: NDArray[np.bool_]) -> list[list[int]]:
    """Groups of tracks that compete, over `possible` pairs (T, C): no cluster is possible for two groups."""
    linked = possible.astype(np.int64) @ possible.T.astype(np.int64)
    _, labels = connected_components(linked, directed=False)
    return [[int(t) for t in np.flatnonzero(labels == label)] for label in np.unique(labels)]


def share_out(
    clusters: Sequence[Cluster], pairs: dict[int, int], distances: Array, near: NDArray[np.bool_]
) -> tuple[dict[int, Cluster], list[Cluster]]:
    """Give each return to a track: track -> its returns, and the clusters that are left for new tracks.

    `distances` (K, T): of every return, in the clusters' order, from every track's boundary. Besides the assigned pairs
    (track -> cluster), a track without a cluster and a cluster without a track are offered to what is paired and `near`
    (T, C) them; then each return goes to the nearest boundary among those that may have it. So a stray leg joins its
    person, a vehicle's second piece the first, and two people whose returns touch stay two.
    """
    may_have = near.copy()
    paired_tracks, paired_clusters = np.zeros((2, max(may_have.shape, default=0)), bool)
    paired_tracks[list(pairs.keys())] = paired_clusters[list(pairs.values())] = True
    may_have &= paired_tracks[: may_have.shape[0], None] ^ paired_clusters[None, : may_have.shape[1]]
    may_have[list(pairs.keys()), list(pairs.values())] = True
    candidates: list[list[int]] = [[] for _ in clusters]
    for number, track in np.argwhere(may_have.T).tolist():
        candidates[number].append(track)
    shares: dict[int, list[Cluster]] = {}
    for cluster, own, tracks in zip(clusters, split(distances, clusters), candidates, strict=True):
        if len(tracks) == 1:
            shares.setdefault(tracks[0], []).append(cluster)
        elif tracks:
            owners = np.array(tracks)[own[:, tracks].argmin(axis=1)]
            for track in np.unique(owners).tolist():
                shares.setdefault(track, []).append(_part(cluster, owners == track))
    left = [cluster for cluster, tracks in zip(clusters, candidates, strict=True) if not tracks]
    return {track: joined(parts) for track, parts in shares.items()}, left


def _part(cluster: Cluster, kept: NDArray[np.bool_]) -> Cluster:
    """The kept returns of a cluster, itself where it is kept whole."""
    return cluster if kept.all() else Cluster(cluster.points[kept], cluster.cut[kept])


def gaps(distances: Array, clusters: Sequence[Cluster]) -> Array:
    """Distance (T, C) between each track's boundary and each cluster, from those of every return (K, T)."""
    return np.asarray(np.minimum.reduceat(distances, bounds_of(clusters)[:-1], axis=0).T)


def distances_to(points: Array, boundaries: Sequence[Array]) -> Array:
    """Distance (K, T) of each of `points` (K, 2) from the nearest point of each boundary (N, 2), metres."""
    x, y = np.ascontiguousarray(np.concatenate(boundaries).T)
    return np.asarray(_distances_to(np.ascontiguousarray(points), x, y, bounds_of(boundaries)[1:]))


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def _distances_to(points, x, y, ends):  # type: ignore[no-untyped-def]
    """As `distances_to`, the boundaries' `x` and `y` (N,) one after the other, each up to its of `ends` (T,)."""
    nearest = np.empty((len(points), len(ends)))
    px, py, least = points[:, 0].copy(), points[:, 1].copy(), np.empty(len(points))
    first = 0
    for track in range(len(ends)):
        least[:] = 1e12
        for j in range(first, ends[track]):
            for k in range(len(px)):  # innermost, for there it vectorises
                dx, dy = px[k] - x[j], py[k] - y[j]
                least[k] = min(least[k], dx * dx + dy * dy)
        for k in range(len(px)):
            nearest[k, track] = math.sqrt(least[k])
        first = ends[track]
    return nearest

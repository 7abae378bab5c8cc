"""Association: gating, assignment of clusters to tracks, and assignment of each return to a track."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.sparse.csgraph import connected_components
from scipy.special import chdtri

from gridtrack.trackers.model_free.arrays import Array, bounds_of, split
from gridtrack.trackers.model_free.segmentation import Cluster, joined
from gridtrack.trackers.model_free.settings import AssociationMethod

MOST_FREEDOM = 3
"""Maximum degrees of freedom of a pair: x, y and heading."""
MAX_NODES = 2000
"""Maximum number of hypotheses for one group of competing tracks."""


def assign(
    costs: Array, distances: Array, freedom: NDArray[np.int64], probability: float, method: AssociationMethod
) -> dict[int, int]:
    """Track -> cluster, from `costs` and squared Mahalanobis `distances` (T, C), infinite for impossible pairs.

    Each distance has `freedom` (T, C) degrees of freedom. `probability` is the gate probability of a true pair, or with
    JCBB of a true set of pairs.
    """
    within = np.where(distances <= gate_limits(probability, 1)[freedom], costs, np.inf)
    if method == "jcbb":
        return joint_compatibility(within, distances, freedom, probability)
    return hungarian(within)


@cache
def gate_limits(probability: float, pairs: int) -> Array:
    """The gate of the joint squared distance of `pairs` pairs, for 0, 1, 2, ... degrees of freedom."""
    return np.concatenate([[0.0], chdtri(np.arange(1, MOST_FREEDOM * pairs + 1), 1.0 - probability)])


def hungarian(costs: Array) -> dict[int, int]:
    """Track -> cluster: the maximum number of pairs of finite cost (T, C), at minimum total cost."""
    possible = np.isfinite(costs)
    beyond = 1.0 + costs[possible].sum()
    rows, columns = linear_sum_assignment(np.where(possible, costs, beyond))
    return {int(t): int(c) for t, c in zip(rows, columns, strict=True) if possible[t, c]}


def joint_compatibility(
    costs: Array, distances: Array, freedom: NDArray[np.int64], probability: float
) -> dict[int, int]:
    """Track -> cluster: the largest jointly compatible set of pairs, at minimum total cost (finite `costs`, (T, C)).

    Joint compatibility branch and bound (Neira and Tardos, IEEE Transactions on Robotics and Automation 2001). Tracks
    are filtered independently, so the joint distance is the sum of `distances` (T, C), with `freedom` (T, C) degrees
    of freedom each; each group of tracks that compete for clusters is solved separately. The search starts from the
    Hungarian assignment without its most distant pairs, and returns the best set found within MAX_NODES.
    """
    pairs: dict[int, int] = {}
    for tracks in _components(np.isfinite(costs)):
        group = _Group(costs, distances, freedom, gate_limits(probability, len(tracks)))
        pairs |= _Search(group, tracks).best
    return pairs


class _Group(NamedTuple):
    """Costs, distances and degrees of freedom of pairs (T, C), and the gate by the degrees of freedom of a set."""

    costs: Array
    distances: Array
    freedom: NDArray[np.int64]
    limits: Array

    def compatible(self, pairs: dict[int, int]) -> bool:
        """Whether the pairs are jointly compatible."""
        chosen = tuple(np.array([*pairs.items()], np.int64).reshape(-1, 2).T)
        return bool(self.distances[chosen].sum() <= self.limits[self.freedom[chosen].sum()])


class _Search:
    """Branch and bound over a group of `tracks` that compete for clusters; `best` is track -> cluster."""

    def __init__(self, group: _Group, tracks: list[int]):
        self.group = group
        options = {t: [int(c) for c in np.argsort(group.costs[t]) if np.isfinite(group.costs[t, c])] for t in tracks}
        self.options = sorted(options.items(), key=lambda each: len(each[1]))  # fewest candidates first
        self.best = self._pruned({tracks[t]: c for t, c in hungarian(group.costs[tracks]).items()})
        self.best_cost = sum(group.costs[pair] for pair in self.best.items())
        self.nodes = 0
        self._branch(0, {}, 0.0, 0, 0.0)

    def _pruned(self, pairs: dict[int, int]) -> dict[int, int]:
        """The pairs without the most distant ones, as many as are necessary for joint compatibility."""
        while not self.group.compatible(pairs):
            del pairs[max(pairs, key=lambda track: self.group.distances[track, pairs[track]])]
        return pairs

    def _branch(self, depth: int, pairs: dict[int, int], distance: float, freedom: int, cost: float) -> None:
        """Try each cluster, and none, for the track at `depth`, as long as a better set is possible."""
        self.nodes += 1
        remaining = len(self.options) - depth
        if self.nodes > MAX_NODES or (len(pairs) + remaining, -cost) <= (len(self.best), -self.best_cost):
            return
        if not remaining:
            if distance <= self.group.limits[freedom]:
                self.best, self.best_cost = dict(pairs), cost
            return
        track, clusters = self.options[depth]
        for cluster in clusters:
            joint, free = distance + self.group.distances[track, cluster], freedom + self.group.freedom[track, cluster]
            if cluster not in pairs.values() and joint <= self.group.limits[free + MOST_FREEDOM * (remaining - 1)]:
                pairs[track] = cluster
                self._branch(depth + 1, pairs, joint, free, cost + self.group.costs[track, cluster])
                del pairs[track]
        self._branch(depth + 1, pairs, distance, freedom, cost)


def _components(possible: NDArray[np.bool_]) -> list[list[int]]:
    """Groups of tracks that share no cluster with each other, from the `possible` pairs (T, C)."""
    linked = possible.astype(np.int64) @ possible.T.astype(np.int64)
    _, labels = connected_components(linked, directed=False)
    return [[int(t) for t in np.flatnonzero(labels == label)] for label in np.unique(labels)]


def assign_returns(
    clusters: Sequence[Cluster], pairs: dict[int, int], distances: Array, members: NDArray[np.bool_]
) -> tuple[dict[int, Cluster], list[Cluster]]:
    """Assign each return to a track: track -> its returns, and the clusters without a track.

    `distances` (K, T): of each return, in the order of the clusters, from the boundary of each track. The
    candidates of a cluster are its track in `pairs` (track -> cluster) and its possible `members` (T, C): an unpaired
    cluster may belong to a paired track, an unpaired track may share a paired cluster. Each return is assigned to the
    nearest boundary of its candidates. Thus a separate leg joins its person, the second part of a vehicle the first,
    and two people in contact remain two.
    """
    has_cluster, has_track = (np.zeros(count, np.bool_) for count in members.shape)
    has_cluster[list(pairs.keys())] = has_track[list(pairs.values())] = True
    possible = members & (has_cluster[:, None] != has_track)
    possible[list(pairs.keys()), list(pairs.values())] = True
    candidates: list[list[int]] = [[] for _ in clusters]
    for number, track in np.argwhere(possible.T).tolist():
        candidates[number].append(track)
    shares: dict[int, list[Cluster]] = {}
    for cluster, own, tracks in zip(clusters, split(distances, clusters), candidates, strict=True):
        if len(tracks) == 1:
            shares.setdefault(tracks[0], []).append(cluster)
        elif tracks:
            owners = np.array(tracks)[own[:, tracks].argmin(axis=1)]
            for track in np.unique(owners).tolist():
                shares.setdefault(track, []).append(_part(cluster, owners == track))
    unassigned = [cluster for cluster, tracks in zip(clusters, candidates, strict=True) if not tracks]
    return {track: joined(parts) for track, parts in shares.items()}, unassigned


def _part(cluster: Cluster, kept: NDArray[np.bool_]) -> Cluster:
    """The kept returns of a cluster; the cluster itself if all are kept."""
    return cluster if kept.all() else Cluster(cluster.points[kept], cluster.cut[kept])


def gaps(distances: Array, clusters: Sequence[Cluster]) -> Array:
    """Distance (T, C) between each boundary and each cluster, from the distances (K, T) of the returns."""
    return np.asarray(np.minimum.reduceat(distances, bounds_of(clusters)[:-1], axis=0).T)


def distances_to(points: Array, boundaries: Sequence[Array]) -> Array:
    """Distance (K, T), metres, of each of `points` (K, 2) from the nearest point of each boundary (N, 2)."""
    x, y = np.ascontiguousarray(np.concatenate(boundaries).T)
    return np.asarray(_distances_to(np.ascontiguousarray(points), x, y, bounds_of(boundaries)[1:]))


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def _distances_to(points, x, y, ends):  # type: ignore[no-untyped-def]
    """`distances_to` of boundaries as concatenated `x` and `y` (N,), each up to its entry of `ends` (T,)."""
    nearest = np.empty((len(points), len(ends)))
    px, py, least = points[:, 0].copy(), points[:, 1].copy(), np.empty(len(points))
    first = 0
    for track in range(len(ends)):
        least[:] = 1e12
        for j in range(first, ends[track]):
            for k in range(len(px)):  # the inner loop vectorises
                dx, dy = px[k] - x[j], py[k] - y[j]
                least[k] = min(least[k], dx * dx + dy * dy)
        for k in range(len(px)):
            nearest[k, track] = math.sqrt(least[k])
        first = ends[track]
    return nearest

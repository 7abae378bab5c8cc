"""Association: which cluster may be which track (the gate), which is (the assignment), and whose each return is."""

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
from scipy.stats import chi2

from gridtrack.trackers.model_free.arrays import Array
from gridtrack.trackers.model_free.ragged import bounds_of, split
from gridtrack.trackers.model_free.segmentation import Cluster, joined
from gridtrack.trackers.model_free.settings import AssociationMethod

MOST_FREEDOM = 3
"""The most degrees of freedom that a pair has: x, y and heading."""
MAX_NODES = 2000
"""The most hypotheses that are tried for one group of tracks that compete."""


def assign(
    costs: Array, distances: Array, freedom: NDArray[np.int64], probability: float, method: AssociationMethod
) -> dict[int, int]:
    """Track -> cluster, from `costs` and squared Mahalanobis `distances` (T, C), infinite where out of question.

    The distance of a pair has so many degrees of `freedom` (T, C). `probability` is the share of true pairs, or with
    JCBB of true sets of pairs, that the gate lets in.
    """
    within = np.where(distances <= limits(probability, 1)[freedom], costs, np.inf)
    if method == "jcbb":
        return joint_compatibility(within, distances, freedom, probability)
    return hungarian(within)


@cache
def limits(probability: float, pairs: int) -> Array:
    """The squared distance that so many true pairs together stay below, by their degrees of freedom from 0 on."""
    return np.concatenate([[0.0], chi2.ppf(probability, np.arange(1, MOST_FREEDOM * pairs + 1))])


def hungarian(costs: Array) -> dict[int, int]:
    """Track -> cluster: as many pairs of finite cost (T, C) as can be, at the least sum of costs."""
    possible = np.isfinite(costs)
    beyond = 1.0 + costs[possible].sum()
    rows, columns = linear_sum_assignment(np.where(possible, costs, beyond))
    return {int(t): int(c) for t, c in zip(rows, columns, strict=True) if possible[t, c]}


def joint_compatibility(
    costs: Array, distances: Array, freedom: NDArray[np.int64], probability: float
) -> dict[int, int]:
    """Track -> cluster: the largest set of pairs that is likely as a whole, at the least sum of finite costs (T, C).

    Joint compatibility branch and bound (Neira and Tardos, IEEE Transactions on Robotics and Automation 2001). Tracks
    are filtered each for itself, so the joint distance is the sum of `distances` (T, C), each of so many degrees of
    `freedom` (T, C); each group of tracks that compete for clusters is a problem of its own. It begins with the
    Hungarian assignment less its most distant pairs, as many as must go; after MAX_NODES the best so far stands.
    """
    pairs: dict[int, int] = {}
    for tracks in _components(np.isfinite(costs)):
        group = _Group(costs, distances, freedom, limits(probability, len(tracks)))
        pairs |= _Search(group, tracks).best
    return pairs


class _Group(NamedTuple):
    """What is known of pairs (T, C), and what a set of them must stay below, by its degrees of freedom."""

    costs: Array
    distances: Array
    freedom: NDArray[np.int64]
    limits: Array

    def likely(self, pairs: dict[int, int]) -> bool:
        """Whether the pairs are likely together."""
        chosen = tuple(np.array([*pairs.items()], np.int64).reshape(-1, 2).T)
        return bool(self.distances[chosen].sum() <= self.limits[self.freedom[chosen].sum()])


class _Search:
    """Branch and bound over a group of `tracks` that compete for clusters; `best` is track -> cluster."""

    def __init__(self, group: _Group, tracks: list[int]):
        self.group = group
        options = {t: [int(c) for c in np.argsort(group.costs[t]) if np.isfinite(group.costs[t, c])] for t in tracks}
        self.options = sorted(options.items(), key=lambda each: len(each[1]))  # who has the fewest chooses first
        self.best = self._pruned({tracks[t]: c for t, c in hungarian(group.costs[tracks]).items()})
        self.best_cost = sum(group.costs[pair] for pair in self.best.items())
        self.nodes = 0
        self._branch(0, {}, 0.0, 0, 0.0)

    def _pruned(self, pairs: dict[int, int]) -> dict[int, int]:
        """The pairs less the most distant ones, until they are likely together."""
        while not self.group.likely(pairs):
            del pairs[max(pairs, key=lambda track: self.group.distances[track, pairs[track]])]
        return pairs

    def _branch(self, depth: int, pairs: dict[int, int], distance: float, freedom: int, cost: float) -> None:
        """Try every cluster for the track at `depth`, and none, where that can still make a better set."""
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
    """Groups of tracks that compete, over `possible` pairs (T, C): no cluster is possible for two groups."""
    linked = possible.astype(np.int64) @ possible.T.astype(np.int64)
    _, labels = connected_components(linked, directed=False)
    return [[int(t) for t in np.flatnonzero(labels == label)] for label in np.unique(labels)]


def assign_returns(
    clusters: Sequence[Cluster], pairs: dict[int, int], distances: Array, near: NDArray[np.bool_]
) -> tuple[dict[int, Cluster], list[Cluster]]:
    """Give each return to a track: track -> its returns, and the clusters that are left for new tracks.

    `distances` (K, T): of every return, in the clusters' order, from every track's boundary. Besides the assigned pairs
    (track -> cluster), a track without a cluster and a cluster without a track are offered to what is paired and `near`
    (T, C) them; then each return goes to the nearest boundary among those that may have it. So a stray leg joins its
    person, a vehicle's second piece the first, and two people whose returns touch stay two.
    """
    has_cluster, has_track = (np.zeros(count, np.bool_) for count in near.shape)
    has_cluster[list(pairs.keys())] = has_track[list(pairs.values())] = True
    may_have = near & (has_cluster[:, None] != has_track)
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

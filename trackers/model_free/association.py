"""Association: which cluster may be which track (the gate), which is (the assignment), and whose each return is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from gridtrack.trackers.model_free.segmentation import Cluster

Array = NDArray[np.float64]


def squared_mahalanobis(centres: Array, positions: Array, covariances: Array) -> Array:
    """Squared Mahalanobis distance (T, C) of cluster centres (C, 2) from tracks at (T, 2), covariance (T, 2, 2)."""
    offset = centres[None] - positions[:, None]
    return np.asarray(np.einsum("tci,tij,tcj->tc", offset, np.linalg.inv(covariances), offset))


def assign(distances: Array, gate: float) -> dict[int, int]:
    """Track -> cluster: as many pairs inside the gate as can be, at the least sum of squared distances (Hungarian).

    `distances` (T, C) squared Mahalanobis; `gate` on the same scale.
    """
    beyond = gate * (1 + min(distances.shape, default=0))
    rows, columns = linear_sum_assignment(np.where(distances <= gate, distances, beyond))
    return {int(t): int(c) for t, c in zip(rows, columns, strict=True) if distances[t, c] <= gate}


def share_out(
    clusters: Sequence[Cluster], pairs: dict[int, int], positions: Array, reach_m: float
) -> tuple[dict[int, Cluster], list[Cluster]]:
    """Give each return to a track: track -> its returns, and the clusters that are left for new tracks.

    Besides the assigned pairs (track -> cluster), a track without a cluster and a cluster without a track are offered
    to what is paired within `reach_m` of them; then each return goes to the nearest predicted position (T, 2) among
    those that may have it. So a stray leg joins its person, and two people whose returns touch stay two.
    """
    may_have = _neighbours(clusters, positions, reach_m)
    paired_tracks, paired_clusters = np.zeros((2, max(may_have.shape, default=0)), bool)
    paired_tracks[list(pairs.keys())] = paired_clusters[list(pairs.values())] = True
    may_have &= paired_tracks[: len(positions), None] ^ paired_clusters[None, : len(clusters)]
    may_have[list(pairs.keys()), list(pairs.values())] = True
    shares: dict[int, list[Array]] = {}
    for number, cluster in enumerate(clusters):
        tracks = np.flatnonzero(may_have[:, number])
        if tracks.size:
            distances = np.linalg.norm(cluster.points[:, None] - positions[None, tracks], axis=2)
            owners = tracks[distances.argmin(axis=1)]
            for track in np.unique(owners):
                shares.setdefault(int(track), []).append(cluster.points[owners == track])
    left = [cluster for number, cluster in enumerate(clusters) if not may_have[:, number].any()]
    return {track: Cluster(np.concatenate(parts)) for track, parts in shares.items()}, left


def _neighbours(clusters: Sequence[Cluster], positions: Array, reach_m: float) -> NDArray[np.bool_]:
    """Which tracks stand within `reach_m` of a return of which cluster, (T, C)."""
    near = np.zeros((len(positions), len(clusters)), bool)
    for number, cluster in enumerate(clusters):
        distances = np.linalg.norm(cluster.points[None] - positions[:, None], axis=2)
        near[:, number] = distances.min(axis=1) <= reach_m
    return near

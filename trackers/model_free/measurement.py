"""Measurement: the pose of a track by matching returns to its boundary; costs of pairs and membership of clusters."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import wrap_angle
from gridtrack.common.grid import Mask
from gridtrack.trackers.model_free.arrays import Array, bounds_of, means_of, spans_of
from gridtrack.trackers.model_free.association import distances_to, gaps
from gridtrack.trackers.model_free.matching import Match, Matches, Outlines, Pairs, match
from gridtrack.trackers.model_free.segmentation import Cluster
from gridtrack.trackers.model_free.settings import PipelineSettings
from gridtrack.trackers.model_free.tracks import Track, boundaries_of, poses_of

HEADING_FROM_M = 1.0
"""The heading is observable if boundary and returns are at least so long: for vehicles, not for pedestrians."""
UNCERTAIN = 2.0
"""If the predicted position is more uncertain than this many surface widths, the cluster's centre is a start too."""
REACH_SIGMAS = 3.0
"""A cluster is a candidate up to this many standard deviations of the position beyond a track's reach."""

ON_BOUNDARY, ON_BOUNDARY_SHARE = 2.0, 0.8
"""A cluster lies on a boundary if this share of its returns is within this many surface widths of it."""


def match_pairs(
    tracks: Sequence[Track],
    views: Sequence[Mask],
    clusters: Sequence[Cluster],
    numbers: NDArray[np.int64],
    settings: PipelineSettings,
) -> Matches:
    """The pose of a track measured from a cluster, with its total covariance, for P pairs `numbers` (P, 2).

    `views` (N,) of each track: which points of its boundary are in view.
    """
    shapes = [track.shape for track in tracks]
    boundaries = Outlines.of(
        [shape.offsets for shape in shapes], [shape.weights for shape in shapes], [shape.cut for shape in shapes]
    )
    returns = Outlines.of([cluster.points for cluster in clusters], None, [cluster.cut for cluster in clusters])
    t, c = numbers.T
    # The hidden part of a person is short: none of its ends is treated as cut off.
    extended = spans_of(boundaries.points, boundaries.bounds)[t] >= HEADING_FROM_M
    oriented = extended & (spans_of(returns.points, returns.bounds)[c] >= HEADING_FROM_M)
    pairs = Pairs(numbers, *_starts(tracks, returns, numbers, settings.surface_noise_m), extended, oriented)
    found = match(boundaries, np.concatenate(views), returns, pairs, settings.surface_noise_m)
    return found._replace(covariances=found.covariances + pose_noise(settings))


def _starts(
    tracks: Sequence[Track], returns: Outlines, numbers: NDArray[np.int64], surface_noise_m: float
) -> tuple[Array, Array]:
    """Start poses of each pair (P, 2, 3), and the standard deviation of the predicted position (P,), metres.

    The first start is the predicted pose. If it is uncertain, the second has the boundary's centre at the cluster's
    centre.
    """
    t, c = numbers.T
    boundaries = boundaries_of(tracks)
    centres = means_of(np.concatenate(boundaries), bounds_of(boundaries))
    shifts = means_of(returns.points, returns.bounds)[c] - centres[t]
    start_error_m = np.sqrt(_covariances(tracks)[:, (0, 1), (0, 1)].max(axis=1))[t]
    starts = np.repeat(poses_of(tracks)[t, None], 2, axis=1)
    starts[:, 1, :2] += np.where(start_error_m > UNCERTAIN * surface_noise_m, shifts.T, np.nan).T
    return starts, start_error_m


@lru_cache(maxsize=64)
def pose_noise(settings: PipelineSettings) -> Array:
    """Covariance (3, 3) that is added to a match."""
    return np.diag([settings.position_noise_m, settings.position_noise_m, settings.heading_noise]) ** 2


class Pairing(NamedTuple):
    """All pairs of tracks and clusters: `costs` and squared Mahalanobis `distances` (T, C), infinite if impossible.

    `freedom` (T, C) are the degrees of freedom of the distances.
    """

    costs: Array
    distances: Array
    freedom: NDArray[np.int64]
    matches: dict[tuple[int, int], Match]
    """The matches of the possible pairs."""


def pairing_of(
    tracks: Sequence[Track],
    clusters: Sequence[Cluster],
    distances: Array,
    views: Sequence[Mask],
    settings: PipelineSettings,
) -> Pairing:
    """Match each track to the clusters near it; the cost is the distance from the prediction plus the residual.

    `distances` (K, T): of the clusters' returns from the predicted boundaries, metres. `views`: as in `match_pairs`.
    """
    costs, mahalanobis = np.full((2, len(tracks), len(clusters)), np.inf)
    freedom = np.zeros(costs.shape, np.int64)
    reach = settings.reach_m + REACH_SIGMAS * _largest_deviation(_covariances(tracks))
    numbers = np.argwhere(gaps(distances, clusters) <= reach[:, None])
    found = match_pairs(tracks, views, clusters, numbers, settings)
    t, c = numbers.T
    mahalanobis[t, c] = squared_mahalanobis(found, tracks, t)
    costs[t, c] = mahalanobis[t, c] + found.residuals
    freedom[t, c] = found.freedom
    return Pairing(costs, mahalanobis, freedom, {(t, c): found.of(p) for p, (t, c) in enumerate(numbers.tolist())})


def membership(
    tracks: Sequence[Track], clusters: Sequence[Cluster], pairs: dict[int, int], settings: PipelineSettings
) -> NDArray[np.bool_]:
    """The possible members (T, C): clusters that may belong to a track besides its assigned one in `pairs`.

    These are clusters within reach of the assigned cluster (the other leg), or of the boundary if none is assigned; and
    clusters on the established boundary: the far part of a vehicle, but not a person who leaves a group.
    """
    points = np.concatenate([cluster.points for cluster in clusters])
    boundaries = boundaries_of(tracks)
    nearby = [clusters[pairs[t]].points if t in pairs else boundary for t, boundary in enumerate(boundaries)]
    established = [boundary[track.shape.established] for boundary, track in zip(boundaries, tracks, strict=True)]
    within_reach = gaps(distances_to(points, nearby), clusters) <= settings.reach_m
    on_it = distances_to(points, established) <= ON_BOUNDARY * settings.surface_noise_m
    return np.asarray(within_reach | (means_of(on_it, bounds_of(clusters)).T >= ON_BOUNDARY_SHARE))


def measured_poses(
    tracks: Sequence[Track],
    shares: dict[int, Cluster],
    clusters: Sequence[Cluster],
    pairing: Pairing,
    views: Sequence[Mask],
    settings: PipelineSettings,
) -> dict[int, Match]:
    """Track -> the pose measured from its returns; matches of whole clusters are taken from `pairing`."""
    numbers = {id(cluster): number for number, cluster in enumerate(clusters)}
    found = {t: pairing.matches.get((t, numbers.get(id(share), -1))) for t, share in shares.items()}
    poses = {t: old for t, old in found.items() if old}
    new = [t for t in shares if t not in poses]
    if new:
        each = np.repeat(np.arange(len(new))[:, None], 2, axis=1)
        more = match_pairs([tracks[t] for t in new], [views[t] for t in new], [shares[t] for t in new], each, settings)
        poses |= {t: more.of(number) for number, t in enumerate(new)}
    return poses


def squared_mahalanobis(found: Matches, tracks: Sequence[Track], owners: NDArray[np.int64]) -> Array:
    """Squared Mahalanobis distances (P,) of matched poses from the predicted poses of the tracks `owners` (P,)."""
    difference = found.poses - poses_of(tracks)[owners]
    difference[:, 2] = wrap_angle(difference[:, 2])
    spreads = _covariances(tracks)[owners, :3, :3] + found.covariances
    return np.asarray((difference * np.linalg.solve(spreads, difference[..., None])[..., 0]).sum(axis=1))


def _largest_deviation(covariances: Array) -> Array:
    """The largest standard deviation (T,) of the position in any direction, from `covariances` (T, 6, 6) of states."""
    xx, xy, yy = covariances[:, 0, 0], covariances[:, 0, 1], covariances[:, 1, 1]
    return np.asarray(np.sqrt(0.5 * (xx + yy) + np.hypot(0.5 * (xx - yy), xy)))


def _covariances(tracks: Sequence[Track]) -> Array:
    """Covariances of the states of the tracks (T, 6, 6)."""
    return np.array([track.estimator.covariance for track in tracks])

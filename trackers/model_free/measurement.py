"""Measurement: a track's pose from returns, by matching them to its boundary; and which clusters it may be."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import wrap_angle
from gridtrack.common.grid import Mask
from gridtrack.trackers.model_free.arrays import Array
from gridtrack.trackers.model_free.association import distances_to, gaps
from gridtrack.trackers.model_free.matches import Match, Matches, Outlines, Pairs
from gridtrack.trackers.model_free.matching import match
from gridtrack.trackers.model_free.ragged import bounds_of, means_of, spans_of
from gridtrack.trackers.model_free.segmentation import Cluster
from gridtrack.trackers.model_free.settings import PipelineSettings
from gridtrack.trackers.model_free.tracks import Track, boundaries_of, poses_of

TURNS_FROM_M = 1.0
"""A body whose boundary and whose returns are both this long shows its heading; a person does not."""
UNSURE = 2.0
"""From a predicted position as unsure as this many surface widths, matching starts from the cluster's centre too."""
REACH_SIGMAS = 3.0
"""A cluster further beyond a track's reach than this many standard deviations of its position is no candidate."""

ON_BOUNDARY, MOST = 2.0, 0.8
"""A cluster lies on a boundary where this share of its returns is within so many surface widths of it."""


def measure(
    tracks: Sequence[Track],
    views: Sequence[Mask],
    clusters: Sequence[Cluster],
    numbers: NDArray[np.int64],
    settings: PipelineSettings,
) -> Matches:
    """The pose of a track as a cluster shows it, with all noise, for P pairs of them, `numbers` (P, 2).

    Of each track's boundary the points of its `views` (N,) are in view.
    """
    shapes = [track.shape for track in tracks]
    boundaries = Outlines.of(
        [shape.offsets for shape in shapes], [shape.weights for shape in shapes], [shape.cut for shape in shapes]
    )
    returns = Outlines.of([cluster.points for cluster in clusters], None, [cluster.cut for cluster in clusters])
    t, c = numbers.T
    # A person does not go on for long behind what hides the rest: no end is cut off.
    goes_on = spans_of(boundaries.points, boundaries.bounds)[t] >= TURNS_FROM_M
    turns = goes_on & (spans_of(returns.points, returns.bounds)[c] >= TURNS_FROM_M)
    pairs = Pairs(numbers, *_starts(tracks, returns, numbers, settings.surface_noise_m), goes_on, turns)
    found = match(boundaries, np.concatenate(views), returns, pairs, settings.surface_noise_m)
    return found._replace(covariances=found.covariances + noise(settings))


def _starts(
    tracks: Sequence[Track], returns: Outlines, numbers: NDArray[np.int64], surface_noise_m: float
) -> tuple[Array, Array]:
    """Where the match of each pair starts (P, 2, 3), and how uncertain that is (P,), metres: at the predicted pose.

    And if that is unsure, with the boundary's centre on the cluster's.
    """
    t, c = numbers.T
    boundaries = boundaries_of(tracks)
    centres = means_of(np.concatenate(boundaries), bounds_of(boundaries))
    shifts = means_of(returns.points, returns.bounds)[c] - centres[t]
    unsure_m = np.sqrt(_covariances(tracks)[:, (0, 1), (0, 1)].max(axis=1))[t]
    starts = np.repeat(poses_of(tracks)[t, None], 2, axis=1)
    starts[:, 1, :2] += np.where(unsure_m > UNSURE * surface_noise_m, shifts.T, np.nan).T
    return starts, unsure_m


@lru_cache(maxsize=64)
def noise(settings: PipelineSettings) -> Array:
    """Covariance (3, 3) of a matched pose beside that of the match."""
    return np.diag([settings.position_noise_m, settings.position_noise_m, settings.heading_noise]) ** 2


class Pairing(NamedTuple):
    """Every cluster as every track: `costs` and squared Mahalanobis `distances` (T, C), infinite out of question.

    And of how many degrees of `freedom` (T, C) the distances are.
    """

    costs: Array
    distances: Array
    freedom: NDArray[np.int64]
    matches: dict[tuple[int, int], Match]
    """Those of the pairs that are not out of question."""


def compare(
    tracks: Sequence[Track],
    clusters: Sequence[Cluster],
    distances: Array,
    views: Sequence[Mask],
    settings: PipelineSettings,
) -> Pairing:
    """Match the clusters near a track to its boundary; the cost is the distance from the prediction and the residual.

    `distances` (K, T) of the clusters' returns from the predicted boundaries, metres; `views` (T) of those.
    """
    costs, mahalanobis = np.full((2, len(tracks), len(clusters)), np.inf)
    freedom = np.zeros(costs.shape, np.int64)
    reach = settings.reach_m + REACH_SIGMAS * _widest(_covariances(tracks))
    numbers = np.argwhere(gaps(distances, clusters) <= reach[:, None])
    found = measure(tracks, views, clusters, numbers, settings)
    t, c = numbers.T
    mahalanobis[t, c] = squared_mahalanobis(found, tracks, t)
    costs[t, c] = mahalanobis[t, c] + found.residuals
    freedom[t, c] = found.freedom
    return Pairing(costs, mahalanobis, freedom, {(t, c): found.of(p) for p, (t, c) in enumerate(numbers.tolist())})


def membership(
    tracks: Sequence[Track], clusters: Sequence[Cluster], pairs: dict[int, int], settings: PipelineSettings
) -> NDArray[np.bool_]:
    """Which clusters may be parts of which tracks, (T, C), beside the assigned `pairs` (track -> cluster).

    A cluster within reach of the one that the track was assigned, as legs are, or where none was, of its boundary; and
    one on the boundary as it has long been, as the far piece of a vehicle lies and who leaves a group does not.
    """
    points = np.concatenate([cluster.points for cluster in clusters])
    boundaries = boundaries_of(tracks)
    seen = [clusters[pairs[t]].points if t in pairs else boundary for t, boundary in enumerate(boundaries)]
    lasting = [boundary[track.shape.established] for boundary, track in zip(boundaries, tracks, strict=True)]
    within_reach = gaps(distances_to(points, seen), clusters) <= settings.reach_m
    on_it = distances_to(points, lasting) <= ON_BOUNDARY * settings.surface_noise_m
    return np.asarray(within_reach | (means_of(on_it, bounds_of(clusters)).T >= MOST))


def measured(
    tracks: Sequence[Track],
    shares: dict[int, Cluster],
    clusters: Sequence[Cluster],
    pairing: Pairing,
    views: Sequence[Mask],
    settings: PipelineSettings,
) -> dict[int, Match]:
    """Track -> the pose that its share of the returns shows; matched already where that is a whole cluster."""
    numbers = {id(cluster): number for number, cluster in enumerate(clusters)}
    found = {t: pairing.matches.get((t, numbers.get(id(share), -1))) for t, share in shares.items()}
    poses = {t: old for t, old in found.items() if old}
    new = [t for t in shares if t not in poses]
    if new:
        each = np.repeat(np.arange(len(new))[:, None], 2, axis=1)
        more = measure([tracks[t] for t in new], [views[t] for t in new], [shares[t] for t in new], each, settings)
        poses |= {t: more.of(number) for number, t in enumerate(new)}
    return poses


def squared_mahalanobis(found: Matches, tracks: Sequence[Track], owners: NDArray[np.int64]) -> Array:
    """Squared Mahalanobis distances (P,) of matched poses from the predicted ones of their tracks, `owners` (P,)."""
    off = found.poses - poses_of(tracks)[owners]
    off[:, 2] = wrap_angle(off[:, 2])
    spreads = _covariances(tracks)[owners, :3, :3] + found.covariances
    return np.asarray((off * np.linalg.solve(spreads, off[..., None])[..., 0]).sum(axis=1))


def _widest(covariances: Array) -> Array:
    """The largest standard deviation (T,) of a position in any direction, of the states' `covariances` (T, 6, 6)."""
    xx, xy, yy = covariances[:, 0, 0], covariances[:, 0, 1], covariances[:, 1, 1]
    return np.asarray(np.sqrt(0.5 * (xx + yy) + np.hypot(0.5 * (xx - yy), xy)))


def _covariances(tracks: Sequence[Track]) -> Array:
    """Of the tracks' states, (T, 6, 6)."""
    return np.array([track.estimator.covariance for track in tracks])

"""Measurement: a track's pose from returns, by matching them to its boundary; and which clusters it may be."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import wrap_angle
from gridtrack.trackers.model_free.association import distances_to, gaps, starts_of
from gridtrack.trackers.model_free.matching import Match, Outline, match
from gridtrack.trackers.model_free.segmentation import Cluster
from gridtrack.trackers.model_free.settings import PipelineSettings
from gridtrack.trackers.model_free.shape import span_m
from gridtrack.trackers.model_free.tracks import Track

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

TURNS_FROM_M = 1.0
"""A body whose boundary and whose returns are both this long shows its heading; a person does not."""
UNSURE = 2.0
"""From a predicted position as unsure as this many surface widths, matching starts from the cluster's centre too."""
REACH_SIGMAS = 3.0
"""A cluster further beyond a track's reach than this many standard deviations of its position is no candidate."""

ON_BOUNDARY, MOST = 2.0, 0.8
"""A cluster lies on a boundary where this share of its returns is within so many surface widths of it."""


def measure(track: Track, cluster: Cluster, seen: Mask, settings: PipelineSettings) -> Match:
    """The pose of a track as a cluster shows it, with all noise; of its boundary the points `seen` (N,) are in view."""
    (xx, _, _), (_, yy, _) = track.estimator.covariance[:2, :3].tolist()
    starts, unsure_m = track.pose[None], math.sqrt(max(xx, yy))
    if unsure_m > UNSURE * settings.surface_m:
        shift = cluster.centre - track.boundary.mean(axis=0)
        starts = starts + np.array([[0.0, 0.0, 0.0], [shift[0], shift[1], 0.0]])
    points, shape = cluster.points, track.shape
    long = shape.extent_m >= TURNS_FROM_M
    turns = long and span_m(points) >= TURNS_FROM_M
    # A person does not go on for long behind what hides the rest: no end is cut off.
    returns = Outline(points, np.ones(len(points)), cluster.cut & long)
    boundary = Outline(shape.offsets, shape.weights, shape.cut & long)
    found = match(returns, boundary, seen, starts, unsure_m, settings.surface_m, turns)
    return found._replace(covariance=found.covariance + noise(settings))


@lru_cache(maxsize=64)
def noise(settings: PipelineSettings) -> Array:
    """Covariance (3, 3) of a matched pose beside that of the match."""
    return np.diag([settings.position_noise_m, settings.position_noise_m, settings.heading_noise]) ** 2


class Pairing(NamedTuple):
    """Every cluster as every track: `costs` and squared Mahalanobis `distances` (T, C), infinite out of question."""

    costs: Array
    distances: Array
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
    matches = {}
    spreads = np.stack([track.estimator.covariance[:2, :2] for track in tracks])
    reach = settings.reach_m + REACH_SIGMAS * np.sqrt(np.linalg.eigvalsh(spreads)[:, -1])
    for t, c in np.argwhere(gaps(distances, clusters) <= reach[:, None]).tolist():
        found = matches[t, c] = measure(tracks[t], clusters[c], views[t], settings)
        mahalanobis[t, c] = squared_mahalanobis(found, tracks[t])
        costs[t, c] = mahalanobis[t, c] + found.residual
    return Pairing(costs, mahalanobis, matches)


def belonging(
    tracks: Sequence[Track], clusters: Sequence[Cluster], pairs: dict[int, int], settings: PipelineSettings
) -> NDArray[np.bool_]:
    """Which clusters may be parts of which tracks, (T, C), beside the assigned `pairs` (track -> cluster).

    A cluster within reach of the one that the track was assigned, as legs are, or where none was, of its boundary; and
    one on the boundary as it has long been, as the far piece of a vehicle lies and who leaves a group does not.
    """
    points = np.concatenate([cluster.points for cluster in clusters])
    seen = [clusters[pairs[t]].points if t in pairs else track.boundary for t, track in enumerate(tracks)]
    within_reach = gaps(distances_to(points, seen), clusters) <= settings.reach_m
    on_it = distances_to(points, [track.established for track in tracks]) <= ON_BOUNDARY * settings.surface_m
    sizes = np.array([len(cluster.points) for cluster in clusters])
    shares = np.add.reduceat(on_it, starts_of(clusters), axis=0, dtype=np.float64).T / sizes
    return np.asarray(within_reach | (shares >= MOST))


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
    return {t: old or measure(tracks[t], shares[t], views[t], settings) for t, old in found.items()}


def squared_mahalanobis(found: Match, track: Track) -> float:
    """Squared Mahalanobis distance of a matched pose from the track's predicted one."""
    off = found.pose - track.pose
    off[2] = wrap_angle(off[2])
    return float(_squared_norm(track.estimator.covariance[:3, :3] + found.covariance, off))


@numba.njit(cache=True, nogil=True)
def _squared_norm(covariance, off):  # type: ignore[no-untyped-def]
    return off @ np.linalg.solve(covariance, off)

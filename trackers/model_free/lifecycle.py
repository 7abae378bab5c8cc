"""The life of a track: its initiation, and its merging with the background or with another track."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.stats import chi2

from gridtrack.trackers.model_free.arrays import Array, bounds_of
from gridtrack.trackers.model_free.association import distances_to
from gridtrack.trackers.model_free.estimators import MakeEstimator, SwitchingEstimator
from gridtrack.trackers.model_free.measurement import HEADING_FROM_M, pose_noise
from gridtrack.trackers.model_free.motion import Regimes
from gridtrack.trackers.model_free.segmentation import Cluster
from gridtrack.trackers.model_free.settings import PipelineSettings
from gridtrack.trackers.model_free.shape import to_body
from gridtrack.trackers.model_free.tracks import Status, Track, boundaries_of

SHADOW_M = 2.0
"""Largest gap between the cut-off ends of a body and of a cluster that may be its continuation behind an occluder."""
MOVING_MPS = 1.0
"""Slower bodies are not continued: in a queue, neighbours are different objects."""
PART_VELOCITY_MPS = 0.5
"""Standard deviation of the velocity of such a cluster relative to the body."""
SIGNIFICANT = float(chi2.ppf(0.95, 2))
"""Beyond this squared Mahalanobis distance two velocities differ significantly."""
KNOWN_MPS = 0.5
"""Limit of the root mean square error of a velocity that counts as zero."""


def initiate(
    make_estimator: MakeEstimator,
    cluster: Cluster,
    tracks: Sequence[Track],
    regimes: Regimes,
    settings: PipelineSettings,
) -> SwitchingEstimator:
    """The estimator of a new track; the body frame lies at the centre of the cluster, parallel to the grid.

    The mean velocity is zero, or the velocity of the long moving body of `tracks` that the cluster seems to continue: a
    bus appears from behind pedestrians window by window, and the pose of a single window does not show its speed.
    """
    initiated = SwitchingEstimator(make_estimator, np.array([*cluster.centre, 0.0]), pose_noise(settings), regimes)
    body = continued_by(cluster, tracks)
    if body is not None:
        mean, covariance = initiated.mean.copy(), initiated.covariance.copy()
        mean[3:5] = body.estimator.mean[3:5]
        covariance[3:5, 3:5] = body.estimator.covariance[3:5, 3:5] + PART_VELOCITY_MPS**2 * np.eye(2)
        initiated.reinitialise(mean, covariance)
    return initiated


def continued_by(cluster: Cluster, tracks: Sequence[Track]) -> Track | None:
    """The confirmed, long, moving track with cut-off boundary points nearest to the cut-off points of the cluster."""
    bodies = [track for track in tracks if _can_continue(track)]
    if not bodies or not cluster.cut.any():
        return None
    ends = [body.boundary[body.shape.cut] for body in bodies]
    gaps = distances_to(cluster.points[cluster.cut], ends).min(axis=0)
    nearest = int(gaps.argmin())
    return bodies[nearest] if gaps[nearest] <= SHADOW_M else None


def _can_continue(track: Track) -> bool:
    moving = float(np.hypot(*track.estimator.mean[3:5])) > MOVING_MPS
    long = track.shape.extent_m >= HEADING_FROM_M
    return track.confirmed and not track.unseen and moving and long and bool(track.shape.cut.any())


def velocities_agree(difference: Array, covariance: Array) -> bool:
    """Whether a velocity, or a difference of two, (2,) m/s with covariance (2, 2), is not significantly nonzero."""
    (x, y), ((xx, xy), (_, yy)) = difference.tolist(), covariance.tolist()
    return bool(yy * x * x - 2.0 * xy * x * y + xx * y * y < SIGNIFICANT * (xx * yy - xy * xy))


def is_stopped(track: Track) -> bool:
    """Whether the track's velocity is known and not significantly different from zero."""
    mean, covariance = track.estimator.mean[3:5], track.estimator.covariance[3:5, 3:5]
    return bool(covariance.trace() <= KNOWN_MPS**2) and velocities_agree(mean, covariance)


class TrackMerger:
    """Merges two tracks after `periods` consecutive periods in which they touched and their velocities agreed."""

    def __init__(self, touch_m: float, periods: int) -> None:
        self._touch_m, self._periods = touch_m, periods
        self._together: dict[tuple[int, int], int] = {}

    def merged(self, tracks: Sequence[Track], periods: int) -> list[Track]:
        """The tracks, `periods` after the last call, without the younger track of each merged pair."""
        seen = [track for track in tracks if track.status is Status.CONFIRMED]
        together = {}
        merged: set[int] = set()
        for older, younger in _touching(seen, self._touch_m):
            if _velocities_of_tracks_agree(older, younger):
                key = older.identity, younger.identity
                together[key] = self._together.get(key, 0) + periods
                if together[key] >= self._periods and not merged & set(key):
                    merge_into(older, younger)
                    merged.add(younger.identity)
        self._together = together
        return [track for track in tracks if track.identity not in merged]


def merge_into(track: Track, other: Track) -> None:
    """Add the boundary and the newest returns of `other` to `track`."""
    track.shape.extend(other.shape, to_body(other.boundary, track.pose))
    track.returns = np.concatenate([track.returns, other.returns])
    track.ages = np.concatenate([track.ages, other.ages])


def _velocities_of_tracks_agree(one: Track, other: Track) -> bool:
    difference = one.estimator.mean[3:5] - other.estimator.mean[3:5]
    return velocities_agree(difference, one.estimator.covariance[3:5, 3:5] + other.estimator.covariance[3:5, 3:5])


def _touching(tracks: Sequence[Track], touch_m: float) -> Iterator[tuple[Track, Track]]:
    """Pairs of tracks with boundaries within `touch_m`, the older track first; bounding boxes are compared first."""
    if not tracks:
        return
    boundaries = boundaries_of(tracks)
    points, starts = np.concatenate(boundaries), bounds_of(boundaries)[:-1]
    low, high = np.minimum.reduceat(points, starts), np.maximum.reduceat(points, starts) + touch_m
    overlap = (low[:, None] <= high).all(axis=2) & (low <= high[:, None]).all(axis=2)
    for first, second in np.argwhere(np.triu(overlap, 1)).tolist():
        if distances_to(boundaries[first], [boundaries[second]]).min() <= touch_m:
            yield tracks[first], tracks[second]

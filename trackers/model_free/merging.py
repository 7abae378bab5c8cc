"""Merging: a track with the background once it stands, and with another one that moves as it does and touches it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.stats import chi2

from gridtrack.trackers.model_free.arrays import Array
from gridtrack.trackers.model_free.association import distances_to
from gridtrack.trackers.model_free.ragged import bounds_of
from gridtrack.trackers.model_free.shape import to_body
from gridtrack.trackers.model_free.tracks import Status, Track, boundaries_of

DIFFERENT = float(chi2.ppf(0.95, 2))
"""Squared Mahalanobis distance of two velocities from which on they are told apart."""
SURE_MPS = 0.5
"""A velocity with a larger root mean square error is not known to be zero, even if it cannot be told from it."""


def velocities_agree(difference: Array, covariance: Array) -> bool:
    """Whether a velocity, or a difference of two, (2,) m/s with its covariance (2, 2), cannot be told from zero."""
    (x, y), ((xx, xy), (_, yy)) = difference.tolist(), covariance.tolist()
    return bool(yy * x * x - 2.0 * xy * x * y + xx * y * y < DIFFERENT * (xx * yy - xy * xy))


def stands(track: Track) -> bool:
    """Whether the track's velocity is known and cannot be told from zero."""
    mean, covariance = track.estimator.mean[3:5], track.estimator.covariance[3:5, 3:5]
    return bool(covariance.trace() <= SURE_MPS**2) and velocities_agree(mean, covariance)


class TrackMerger:
    """For how many periods in a row pairs of tracks have moved alike and touched; after so many they are one."""

    def __init__(self, touch_m: float, periods: int) -> None:
        self._touch_m, self._periods = touch_m, periods
        self._together: dict[tuple[int, int], int] = {}

    def merged(self, tracks: Sequence[Track], periods: int) -> list[Track]:
        """The tracks so many periods later, the younger of two that are one taken into the older."""
        seen = [track for track in tracks if track.status is Status.CONFIRMED]
        together = {}
        taken: set[int] = set()
        for one, other in _touching(seen, self._touch_m):
            if _move_alike(one, other):
                key = one.identity, other.identity
                together[key] = self._together.get(key, 0) + periods
                if together[key] >= self._periods and not taken & set(key):
                    take_in(one, other)
                    taken.add(other.identity)
        self._together = together
        return [track for track in tracks if track.identity not in taken]


def take_in(track: Track, other: Track) -> None:
    """Make the boundary and the newest returns of `other` part of the track."""
    track.shape.extend(other.shape, to_body(other.boundary, track.pose))
    track.returns = np.concatenate([track.returns, other.returns])
    track.ages = np.concatenate([track.ages, other.ages])


def _move_alike(one: Track, other: Track) -> bool:
    difference = one.estimator.mean[3:5] - other.estimator.mean[3:5]
    return velocities_agree(difference, one.estimator.covariance[3:5, 3:5] + other.estimator.covariance[3:5, 3:5])


def _touching(tracks: Sequence[Track], touch_m: float) -> Iterator[tuple[Track, Track]]:
    """Pairs of tracks, the older first, whose boundaries come within `touch_m`; their boxes are looked at first."""
    if not tracks:
        return
    boundaries = boundaries_of(tracks)
    points, starts = np.concatenate(boundaries), bounds_of(boundaries)[:-1]
    low, high = np.minimum.reduceat(points, starts), np.maximum.reduceat(points, starts) + touch_m
    overlap = (low[:, None] <= high).all(axis=2) & (low <= high[:, None]).all(axis=2)
    for first, second in np.argwhere(np.triu(overlap, 1)).tolist():
        if distances_to(boundaries[first], [boundaries[second]]).min() <= touch_m:
            yield tracks[first], tracks[second]

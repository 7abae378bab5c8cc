"""Birth of a track: where it is, and how it moves if it continues a body that something nearer cuts off."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from gridtrack.trackers.model_free.arrays import Array
from gridtrack.trackers.model_free.association import distances_to
from gridtrack.trackers.model_free.measurement import TURNS_FROM_M, noise
from gridtrack.trackers.model_free.motion.estimator import MotionEstimator
from gridtrack.trackers.model_free.motion.parameters import MotionModel, Regimes
from gridtrack.trackers.model_free.motion.regimes import SwitchingEstimator
from gridtrack.trackers.model_free.segmentation import Cluster
from gridtrack.trackers.model_free.settings import PipelineSettings
from gridtrack.trackers.model_free.tracks import Track

Estimator = Callable[[Array, Array, MotionModel], MotionEstimator]
"""Begins to estimate a motion, from a pose (3,), its covariance (3, 3) and the motion model."""

SHADOW_M = 2.0
"""A cluster cut off so near to where a body is cut off may be more of it, beyond the shadow."""
MOVES_MPS = 1.0
"""A slower body says nothing of what is beside it: queues stand side by side."""
PARTS_MPS = 0.5
"""Standard deviation of the velocity of such a cluster about that body's."""


def begin(
    estimator: Estimator, cluster: Cluster, tracks: Sequence[Track], regimes: Regimes, settings: PipelineSettings
) -> SwitchingEstimator:
    """The motion of a new track; its body's frame lies at the cluster's centre, along the grid.

    It stands in the mean, or has the velocity of the long moving body of `tracks` that it seems to be more of: a bus
    comes out from behind people window by window, and no window shows how fast it is.
    """
    begun = SwitchingEstimator(estimator, np.array([*cluster.centre, 0.0]), noise(settings), regimes)
    body = continued_by(cluster, tracks)
    if body is not None:
        mean, covariance = begun.mean.copy(), begun.covariance.copy()
        mean[3:5] = body.estimator.mean[3:5]
        covariance[3:5, 3:5] = body.estimator.covariance[3:5, 3:5] + PARTS_MPS**2 * np.eye(2)
        begun.begin_anew(mean, covariance)
    return begun


def continued_by(cluster: Cluster, tracks: Sequence[Track]) -> Track | None:
    """The confirmed, long and moving track whose cut-off boundary comes nearest to where the cluster is cut off."""
    bodies = [track for track in tracks if _may_go_on(track)]
    if not bodies or not cluster.cut.any():
        return None
    ends = [body.boundary[body.shape.cut] for body in bodies]
    gaps = distances_to(cluster.points[cluster.cut], ends).min(axis=0)
    nearest = int(gaps.argmin())
    return bodies[nearest] if gaps[nearest] <= SHADOW_M else None


def _may_go_on(track: Track) -> bool:
    fast = float(np.hypot(*track.estimator.mean[3:5])) > MOVES_MPS
    long = track.shape.extent_m >= TURNS_FROM_M
    return track.confirmed and not track.unseen and fast and long and bool(track.shape.cut.any())

"""Initiation of a track: its pose, and its velocity where it continues a partly hidden body with a track."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from gridtrack.trackers.model_free.arrays import Array
from gridtrack.trackers.model_free.association import distances_to
from gridtrack.trackers.model_free.measurement import HEADING_FROM_M, pose_noise
from gridtrack.trackers.model_free.motion.estimator import MotionEstimator
from gridtrack.trackers.model_free.motion.parameters import MotionModel, Regimes
from gridtrack.trackers.model_free.motion.regimes import SwitchingEstimator
from gridtrack.trackers.model_free.segmentation import Cluster
from gridtrack.trackers.model_free.settings import PipelineSettings
from gridtrack.trackers.model_free.tracks import Track

Estimator = Callable[[Array, Array, MotionModel], MotionEstimator]
"""Makes the estimator of one motion from a pose (3,), its covariance (3, 3) and the motion model."""

SHADOW_M = 2.0
"""Largest gap between the cut-off ends of a body and of a cluster that may continue it behind an occluder."""
MOVING_MPS = 1.0
"""Slower bodies are not continued: in a queue, neighbours are different objects."""
PART_VELOCITY_MPS = 0.5
"""Standard deviation of the velocity of such a cluster about that of the body."""


def initiate(
    estimator: Estimator, cluster: Cluster, tracks: Sequence[Track], regimes: Regimes, settings: PipelineSettings
) -> SwitchingEstimator:
    """The estimator of a new track; the body frame lies at the centre of the cluster, parallel to the grid.

    The mean velocity is zero, or that of the long moving body of `tracks` that the cluster seems to continue: a bus
    appears from behind pedestrians window by window, and the pose of a single window does not show its speed.
    """
    initiated = SwitchingEstimator(estimator, np.array([*cluster.centre, 0.0]), pose_noise(settings), regimes)
    body = continued_by(cluster, tracks)
    if body is not None:
        mean, covariance = initiated.mean.copy(), initiated.covariance.copy()
        mean[3:5] = body.estimator.mean[3:5]
        covariance[3:5, 3:5] = body.estimator.covariance[3:5, 3:5] + PART_VELOCITY_MPS**2 * np.eye(2)
        initiated.reinitialise(mean, covariance)
    return initiated


def continued_by(cluster: Cluster, tracks: Sequence[Track]) -> Track | None:
    """The confirmed, long, moving track whose cut-off boundary points are nearest to those of the cluster."""
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

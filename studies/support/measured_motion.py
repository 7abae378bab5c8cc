"""Objects with a known motion, and noisy measurements of their poses, for the estimators of a track."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridtrack.trackers.model_free.motion import MotionModel

Array = NDArray[np.float64]
MODEL = MotionModel(
    acceleration=0.7,
    speed_noise=0.001,
    turn_acceleration=0.3,
    velocity_memory_s=20.0,
    turn_memory_s=3.0,
    initial_speed=5.0,
    initial_turn_rate=0.2,
    period_s=0.125,
)
NOISE = np.diag([0.06, 0.06, 0.04]) ** 2
"""Covariance of a vehicle's pose measured in cells of 0.1 m: metres, metres, radians."""
FRAMES_PER_SECOND = 8


def measured_poses(truth: Array, noise: Array, outliers: float, rng: np.random.Generator) -> Array:
    """Measured poses (N, 3) of true states (N, 6).

    A share `outliers` is wrong by up to 1.5 m and 0.5 rad along each axis, but none of the first three.
    """
    poses = truth[:, :3] + rng.multivariate_normal(np.zeros(3), noise, len(truth))
    wrong = rng.random(len(truth)) < outliers
    wrong[:3] = False
    poses[wrong] += rng.uniform(-1.0, 1.0, (wrong.sum(), 3)) * [1.5, 1.5, 0.5]
    return np.asarray(poses, np.float64)

"""State estimation: where an object is and how it moves, with covariance."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from filterpy.common import Q_continuous_white_noise
from filterpy.kalman import KalmanFilter
from numpy.typing import NDArray

Array = NDArray[np.float64]


class MotionEstimator(Protocol):
    """What a track asks of the estimator of its motion; state (x, y, vx, vy), metres and m/s, world frame."""

    @property
    def mean(self) -> Array:
        """State (4,)."""
        ...

    @property
    def covariance(self) -> Array:
        """Covariance of the state (4, 4)."""
        ...

    def predict(self) -> None:
        """Move on by one period."""
        ...

    def update(self, position: Array) -> None:
        """Take in a measured position (2,), metres."""
        ...

    def ahead(self, steps: int) -> tuple[Array, Array]:
        """Means (steps+1, 4) and covariances (steps+1, 4, 4) of steps 0..steps; the state stays as it is."""
        ...


class ConstantVelocityKalman:
    """Kalman filter of a point that moves with constant velocity but for white-noise acceleration.

    `acceleration` in m/s^2 per sqrt(Hz), `position_noise_m` and `initial_speed` are standard deviations along each
    axis (Bar-Shalom, Li and Kirubarajan 2001, section 6.2.2).
    """

    def __init__(
        self, position: Array, period_s: float, acceleration: float, position_noise_m: float, initial_speed: float
    ) -> None:
        self._filter = KalmanFilter(dim_x=4, dim_z=2)
        self._filter.x = np.array([position[0], position[1], 0.0, 0.0])
        self._filter.P = np.diag(np.square([position_noise_m, position_noise_m, initial_speed, initial_speed]))
        self._filter.F = np.eye(4) + period_s * np.eye(4, k=2)
        self._filter.H = np.eye(2, 4)
        self._filter.Q = Q_continuous_white_noise(2, period_s, acceleration**2, block_size=2, order_by_dim=False)
        self._filter.R = np.eye(2) * position_noise_m**2

    @property
    def mean(self) -> Array:
        """State (4,): x, y, vx, vy."""
        return np.asarray(self._filter.x)

    @property
    def covariance(self) -> Array:
        """Covariance of the state (4, 4)."""
        return np.asarray(self._filter.P)

    def predict(self) -> None:
        """Move on by one period."""
        self._filter.predict()

    def update(self, position: Array) -> None:
        """Take in a measured position (2,), metres."""
        self._filter.update(position)

    def ahead(self, steps: int) -> tuple[Array, Array]:
        """Means (steps+1, 4) and covariances (steps+1, 4, 4) of steps 0..steps; the state stays as it is."""
        transition, noise = self._filter.F, self._filter.Q
        means, covariances = np.empty((steps + 1, 4)), np.empty((steps + 1, 4, 4))
        means[0], covariances[0] = self.mean, self.covariance
        for step in range(steps):
            means[step + 1] = transition @ means[step]
            covariances[step + 1] = transition @ covariances[step] @ transition.T + noise
        return means, covariances

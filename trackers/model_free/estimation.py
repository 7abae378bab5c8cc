"""State estimation: where an object is and how it moves, with covariance."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple, Protocol

import numpy as np
from filterpy.common import van_loan_discretization
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


@lru_cache(maxsize=64)
def motion_model(period_s: float, acceleration: float, velocity_memory_s: float) -> tuple[Array, Array]:
    """Transition and process noise (4, 4) over one period, of the state (x, y, vx, vy)."""
    drift = np.zeros((4, 4))
    drift[:2, 2:] = np.eye(2)
    drift[2:, 2:] = -np.eye(2) / velocity_memory_s
    transition, noise = van_loan_discretization(drift, np.eye(4, 2, -2) * acceleration, period_s)
    return np.asarray(transition), np.asarray(noise)


class MotionNoise(NamedTuple):
    """The motion model's standard deviations, all along each axis, and how long it remembers a velocity."""

    acceleration: float
    """White noise, m/s^2 per sqrt(Hz)."""
    velocity_memory_s: float
    """Time constant with which a velocity is forgotten."""
    position_noise_m: float
    """Of a measured position."""
    initial_speed: float
    """Of the velocity before anything is known of it, m/s."""


class ConstantVelocityKalman:
    """Kalman filter of a point with nearly constant velocity, in the plane.

    The velocity is an Ornstein-Uhlenbeck process, position its integral: white-noise acceleration drives it, and it
    is forgotten with a time constant; in the limit of a long one, this is the constant-velocity model of Bar-Shalom,
    Li and Kirubarajan 2001, section 6.2.2.
    """

    def __init__(self, position: Array, period_s: float, noise: MotionNoise) -> None:
        self._filter = KalmanFilter(dim_x=4, dim_z=2)
        self._filter.x = np.concatenate([position, np.zeros(2)])
        self._filter.P = np.diag(np.repeat([noise.position_noise_m, noise.initial_speed], 2)) ** 2
        self._filter.F, self._filter.Q = motion_model(period_s, noise.acceleration, noise.velocity_memory_s)
        self._filter.H = np.eye(2, 4)
        self._filter.R = np.eye(2) * noise.position_noise_m**2

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

"""The prior of a match: the predicted pose of a scan, from odometry or from the last motion."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from gridtrack.common.geometry import SE2
from gridtrack.common.scan import PoseQuality
from gridtrack.recordings.ego_motion.returns import PlaneArray

ODOMETRY_DRIFT, ODOMETRY_TURN_DRIFT = 0.05, 1.0
"""Standard deviations of odometry: of the position, metres per metre driven, and of the heading, radians per radian
turned, and half of it per metre driven."""
ACCELERATION, TURN_ACCELERATION = 3.0, 10.0
"""Without odometry: standard deviations of the acceleration, m/s^2, and of the angular acceleration, rad/s^2."""
POSITION_FLOOR_M, HEADING_FLOOR_RAD = 0.002, 0.002
"""Minimum standard deviations of a prior."""
TURN_LEVER_M = 0.5
"""A turn of one radian adds as much position noise as this distance, and this share of a turn adds to the heading's."""
MIN_NOISE_S = 0.05
"""Minimum time for the noise of a prior without odometry: stamps of a log may come in bursts."""
MIN_VELOCITY_S = 0.04
"""Minimum time over which the velocity is measured, for the same reason."""
MAX_COAST_S, MAX_OPEN_S = 1.0, 5.0
"""The last velocity is used for at most this long while scans cannot be matched, and while a direction is weak; after
that the sensor is assumed at rest."""
UNKNOWN_VELOCITY = np.array([3.0, 3.0, 1.0])
"""Standard deviations at the beginning, m/s and rad/s."""
MAX_DEVIATION = np.array([10.0, 10.0, 3.0])
"""Limits of the standard deviations, m/s and rad/s."""


class Velocity(NamedTuple):
    """A velocity, sensor frame: `mean` in m/s and rad/s, and its `covariance` (3, 3)."""

    mean: SE2
    covariance: PlaneArray


class Prior(NamedTuple):
    """A predicted pose `world_T_sensor`, the `motion` since the scan before (in its sensor frame), and the noise.

    `information` (3, 3) is the inverse covariance of x, y and heading, sensor frame; `coarse`: the pose may be off by
    more than the fine kernel.
    """

    world_T_sensor: SE2
    motion: SE2
    information: PlaneArray
    coarse: bool


def odometry_prior(last: SE2, odometry: SE2) -> Prior:
    """The pose after the recorded motion `odometry` (last_T_sensor) from the pose `last`."""
    distance, turn = math.hypot(odometry.x, odometry.y), abs(odometry.theta)
    position = POSITION_FLOOR_M + ODOMETRY_DRIFT * (distance + TURN_LEVER_M * turn)
    heading = HEADING_FLOOR_RAD + ODOMETRY_TURN_DRIFT * (turn + TURN_LEVER_M * distance)
    return Prior(last @ odometry, odometry, _information(position, heading), False)


def motion_prior(last: SE2, velocity: Velocity, since_s: float) -> Prior:
    """The pose `since_s` seconds after the pose `last`, by `velocity` and its possible change."""
    mean, noise_s = velocity.mean, max(since_s, MIN_NOISE_S)
    motion = SE2(mean.x * since_s, mean.y * since_s, mean.theta * since_s)
    position = POSITION_FLOOR_M + ACCELERATION * noise_s**2 / 2.0
    heading = HEADING_FLOOR_RAD + TURN_ACCELERATION * noise_s**2 / 2.0
    covariance = np.diag([position**2, position**2, heading**2]) + velocity.covariance * noise_s**2
    return Prior(last @ motion, motion, inverse(covariance), True)


def inverse(matrix: PlaneArray) -> PlaneArray:
    """The covariance (3, 3) of an information, or the information of a covariance."""
    return np.linalg.inv(matrix).astype(np.float64)


def _information(position_m: float, heading_rad: float) -> PlaneArray:
    return np.diag([position_m**-2, position_m**-2, heading_rad**-2])


class LastMotion:
    """The velocity from scan to scan; its covariance grows in each direction until a match constrains it."""

    def __init__(self, stamp_ns: int, world_T_sensor: SE2) -> None:
        self._from = stamp_ns, world_T_sensor
        self._stamp_ns = self._matched_ns = self._constrained_ns = stamp_ns
        self._velocity = Velocity(SE2(), np.diag(UNKNOWN_VELOCITY**2))
        self._change = np.array([ACCELERATION, ACCELERATION, TURN_ACCELERATION])

    def velocity(self, stamp_ns: int) -> Velocity:
        """The velocity for the prediction of the pose at a stamp."""
        stands = stamp_ns - self._matched_ns > MAX_COAST_S * 1e9 or stamp_ns - self._constrained_ns > MAX_OPEN_S * 1e9
        return self._velocity._replace(mean=SE2()) if stands else self._velocity

    def add(self, stamp_ns: int, world_T_sensor: SE2, quality: PoseQuality, information: PlaneArray) -> None:
        """The next pose, with the information (3, 3) of its match."""
        since_s = (stamp_ns - self._stamp_ns) / 1e9
        grown = self._velocity.covariance + np.diag((self._change * since_s) ** 2)
        beyond = float(np.max(np.diag(grown) / MAX_DEVIATION**2))
        self._velocity = self._velocity._replace(covariance=grown / max(beyond, 1.0))
        self._stamp_ns = stamp_ns
        if quality.failed:
            return
        self._matched_ns = stamp_ns
        if not quality.fell_back:
            self._constrained_ns = stamp_ns
        self._measure(stamp_ns, world_T_sensor, information)

    def _measure(self, stamp_ns: int, world_T_sensor: SE2, information: PlaneArray) -> None:
        then_ns, then = self._from
        since_s = (stamp_ns - then_ns) / 1e9
        if since_s >= MIN_VELOCITY_S:
            motion = then.inverse() @ world_T_sensor
            mean = SE2(motion.x / since_s, motion.y / since_s, motion.theta / since_s)
            self._velocity = Velocity(mean, inverse(information) / since_s**2)
            self._from = stamp_ns, world_T_sensor

"""Wheel odometry: the poses that a vehicle with two driven wheels would record on its true path.

Each wheel measures its distance with an error whose variance grows with that distance (Chong and Kleeman, "Accurate
odometry and error modelling for a mobile robot", ICRA 1997), wheels slip in turns, and the wheels' diameters are not
equal, which bends a straight path (Borenstein and Feng, "Measurement and correction of systematic odometry errors in
mobile robots", IEEE Transactions on Robotics and Automation 12 (6), 1996).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from gridtrack.common.config import Settings
from gridtrack.common.geometry import wrap_angle


class WheelOdometry(Settings):
    """Errors of wheel odometry; the same seed and path give the same errors.

    The defaults are of the size measured on an indoor robot with wheels about 0.4 m apart, see docs/drives.md.
    """

    seed: int = Field(default=0, ge=0, lt=1 << 63)
    track_width_m: float = Field(default=0.4, gt=0.0, le=10.0)
    """Distance between the left and the right wheel."""
    wheel_std: float = Field(default=0.004, ge=0.0, le=1.0)
    """Standard deviation of a wheel's distance, metres after one metre; it grows with the root of the distance."""
    turn_std: float = Field(default=0.07, ge=0.0, le=1.0)
    """Standard deviation of the heading after a turn by one radian; it grows with the root of the angle."""
    diameter_std: float = Field(default=0.002, ge=0.0, le=0.1)
    """Standard deviation of the relative difference of the wheels' diameters; one value for a recording."""

    def scaled(self, factor: float) -> WheelOdometry:
        """All errors multiplied by `factor`. Raises pydantic's ValidationError beyond the limits."""
        errors = ("wheel_std", "turn_std", "diameter_std")
        return WheelOdometry(**self.model_dump() | {name: getattr(self, name) * factor for name in errors})

    def recorded(self, poses: NDArray[np.float64]) -> NDArray[np.float64]:
        """The recorded poses (n, 3) of the true ones: x, y, heading, metres and radians. The first pose is exact."""
        random = np.random.default_rng(self.seed)
        bend = self.diameter_std / self.track_width_m * random.standard_normal()
        step, angle = np.diff(poses[:, :2], axis=0), wrap_angle(np.diff(poses[:, 2]))
        distance = np.hypot(step[:, 0], step[:, 1])
        left, right = self.wheel_std * np.sqrt(distance) * random.standard_normal((2, len(distance)))
        slip = self.turn_std * np.sqrt(np.abs(angle)) * random.standard_normal(len(distance))
        turned = (right - left) / self.track_width_m + slip + bend * distance
        longer = np.divide((left + right) / 2.0, distance, out=np.zeros_like(distance), where=distance > 0.0)
        heading = poses[0, 2] + np.concatenate([[0.0], np.cumsum(angle + turned)])
        # The step in the frame of the body at its start, laid where the recorded body is halfway through its error.
        ahead = np.arctan2(step[:, 1], step[:, 0]) - poses[:-1, 2] + heading[:-1] + turned / 2.0
        measured = (distance * (1.0 + longer))[:, None] * np.column_stack([np.cos(ahead), np.sin(ahead)])
        position = poses[0, :2] + np.concatenate([np.zeros((1, 2)), np.cumsum(measured, axis=0)])
        return np.column_stack([position, heading])

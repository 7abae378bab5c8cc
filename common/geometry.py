"""Poses in the plane: SE(2), and angles wrapped to [-pi, pi)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Angle = TypeVar("Angle", float, NDArray[np.float64])
"""Radians: one angle, or an array of them."""


@dataclass(frozen=True, slots=True)
class SE2:
    """A planar pose `target_T_source`: x and y in metres, theta in radians, counter-clockwise."""

    x: float = 0.0
    y: float = 0.0
    theta: float = 0.0

    def __matmul__(self, other: SE2) -> SE2:
        """Chain poses: `a_T_b @ b_T_c` is `a_T_c`."""
        c, s = math.cos(self.theta), math.sin(self.theta)
        return SE2(
            self.x + c * other.x - s * other.y,
            self.y + s * other.x + c * other.y,
            wrap_angle(self.theta + other.theta),
        )

    def inverse(self) -> SE2:
        """`source_T_target`."""
        c, s = math.cos(self.theta), math.sin(self.theta)
        return SE2(-c * self.x - s * self.y, s * self.x - c * self.y, -self.theta)

    def apply(self, points: NDArray[Any]) -> NDArray[np.float64]:
        """Points (N, 2) in metres, source frame -> (N, 2), target frame."""
        c, s = math.cos(self.theta), math.sin(self.theta)
        moved: NDArray[np.float64] = np.asarray(points, np.float64) @ [[c, s], [-s, c]] + [self.x, self.y]
        return moved


def wrap_angle(theta: Angle) -> Angle:
    """The same angle in [-pi, pi)."""
    return (theta + math.pi) % (2.0 * math.pi) - math.pi


def same_pose(one: SE2, other: SE2) -> bool:
    """Whether two poses agree to a millimetre and a milliradian, so that a grid cell is the same place in both."""
    turned = abs(wrap_angle(one.theta - other.theta))
    return max(abs(one.x - other.x), abs(one.y - other.y), turned) < 1e-3

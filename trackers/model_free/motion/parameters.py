"""Parameters of the motion models: of one regime, and of a set of regimes with their transition probabilities."""

from __future__ import annotations

import math
from typing import NamedTuple


class MotionModel(NamedTuple):
    """Process noise and initial uncertainty of the motion of an object; every number positive and finite."""

    acceleration: float
    """White-noise acceleration along each axis: square root of its density, m/s^2 per sqrt(Hz)."""
    speed_noise: float
    """White noise of the relative change of speed: fast objects accelerate and brake harder; 1/s per sqrt(Hz)."""
    turn_acceleration: float
    """White-noise acceleration of the turn rate, rad/s^2 per sqrt(Hz)."""
    velocity_memory_s: float
    """Correlation time of the velocity; large: nearly constant velocity."""
    turn_memory_s: float
    """Correlation time of the turn rate."""
    initial_speed: float
    """Standard deviation of a new track's velocity along each axis, m/s."""
    initial_turn_rate: float
    """Standard deviation of a new track's turn rate, rad/s."""
    period_s: float
    """Period of the frames."""


class Regimes(NamedTuple):
    """The motion model of each regime, and the transition probabilities `switching` (2, 2) in a period."""

    models: tuple[MotionModel, MotionModel]
    switching: tuple[tuple[float, float], tuple[float, float]]

    @classmethod
    def of(
        cls, steady: MotionModel, manoeuvre_noise: float, steady_duration_s: float, manoeuvre_duration_s: float
    ) -> Regimes:
        """`steady`, and a manoeuvre with `manoeuvre_noise` times its process noise; mean durations in seconds."""
        manoeuvre = steady._replace(
            acceleration=steady.acceleration * manoeuvre_noise,
            speed_noise=steady.speed_noise * manoeuvre_noise,
            turn_acceleration=steady.turn_acceleration * manoeuvre_noise,
        )
        starts, ends = (-math.expm1(-steady.period_s / mean_s) for mean_s in (steady_duration_s, manoeuvre_duration_s))
        return cls((steady, manoeuvre), ((1.0 - starts, starts), (ends, 1.0 - ends)))

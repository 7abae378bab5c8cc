"""Parameters of the motion models: of one regime, and of a set of regimes with their transition probabilities."""

from __future__ import annotations

import math
from typing import NamedTuple


class MotionModel(NamedTuple):
    """How an object is expected to move, and what is known of its motion at first; every number positive and finite."""

    acceleration: float
    """White noise along each axis: the square root of its density, m/s^2 per sqrt(Hz)."""
    speed_noise: float
    """White noise of the speed's relative growth: what is fast speeds up and brakes harder; 1/s per sqrt(Hz)."""
    turn_acceleration: float
    """The same of the turn rate, rad/s^2 per sqrt(Hz)."""
    velocity_memory_s: float
    """Time constant with which a velocity is forgotten; large: nearly constant velocity."""
    turn_memory_s: float
    """Time constant with which a turn rate is forgotten."""
    initial_speed: float
    """Standard deviation of a new track's velocity along each axis, m/s."""
    initial_turn_rate: float
    """Standard deviation of a new track's turn rate, rad/s."""
    period_s: float
    """From one frame to the next."""


class Regimes(NamedTuple):
    """The motion model of each regime, and the probability `switching` (2, 2) of one after another in a period."""

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

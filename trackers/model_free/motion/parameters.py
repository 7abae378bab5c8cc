"""Parameters of the motion models: of one regime, and of a set of regimes with their transition probabilities."""

from __future__ import annotations

import math
from typing import NamedTuple


class MotionModel(NamedTuple):
    """How an object is expected to move, and what is known of its motion at first; every number positive and finite."""

    acceleration: float
    """White noise along each axis: the square root of its density, m/s^2 per sqrt(Hz)."""
    surge: float
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
    def of(cls, steady: MotionModel, agility: float, steady_s: float, agile_s: float) -> Regimes:
        """`steady`, and the same with `agility` times the process noise; each lasts for so many seconds in the mean."""
        agile = steady._replace(
            acceleration=steady.acceleration * agility,
            surge=steady.surge * agility,
            turn_acceleration=steady.turn_acceleration * agility,
        )
        leaves, settles = (-math.expm1(-steady.period_s / lasting) for lasting in (steady_s, agile_s))
        return cls((steady, agile), ((1.0 - leaves, leaves), (settles, 1.0 - settles)))

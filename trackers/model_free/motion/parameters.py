"""Parameters of the motion models: of one regime, and of a set of regimes; the limits of what an estimate can be."""

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


class StateLimits(NamedTuple):
    """What the estimate for an object can be that was measured just now, in a window with frames of one period.

    All its poses lie in the window: no two of them are farther apart than its diagonal, none is left faster than the
    diagonal in a period, and a turn of more than half a circle in a period looks like one the other way.
    """

    distance_m: float
    """Largest distance of the position from the measured one."""
    speed: float
    """Largest speed, m/s."""
    turn_rate: float
    """Largest turn rate either way, rad/s."""

    @classmethod
    def of(cls, window_m: float, period_s: float) -> StateLimits:
        """The limits in a window with sides of `window_m`."""
        diagonal_m = math.sqrt(2.0) * window_m
        return cls(diagonal_m, diagonal_m / period_s, math.pi / period_s)


class Regimes(NamedTuple):
    """The motion model of each regime, the transition probabilities `switching` (2, 2) in a period, and the limits."""

    models: tuple[MotionModel, MotionModel]
    switching: tuple[tuple[float, float], tuple[float, float]]
    limits: StateLimits

    @classmethod
    def of(
        cls,
        steady: MotionModel,
        manoeuvre_noise: float,
        steady_duration_s: float,
        manoeuvre_duration_s: float,
        window_m: float,
    ) -> Regimes:
        """`steady`, and a manoeuvre with `manoeuvre_noise` times its process noise; mean durations in seconds.

        `window_m` is the side of the window in which the objects are measured.
        """
        manoeuvre = steady._replace(
            acceleration=steady.acceleration * manoeuvre_noise,
            speed_noise=steady.speed_noise * manoeuvre_noise,
            turn_acceleration=steady.turn_acceleration * manoeuvre_noise,
        )
        starts, ends = (-math.expm1(-steady.period_s / mean_s) for mean_s in (steady_duration_s, manoeuvre_duration_s))
        switching = (1.0 - starts, starts), (ends, 1.0 - ends)
        return cls((steady, manoeuvre), switching, StateLimits.of(window_m, steady.period_s))

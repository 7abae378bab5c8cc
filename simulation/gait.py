"""Walking: where the feet of a person are who moves along a path.

The length of a step grows with the speed to the power of 0.42 (A. D. Kuo, "A simple model of bipedal walking predicts
the preferred speed-step length relationship", Journal of Biomechanical Engineering 123, 2001) and with the height of
the body; a foot is on the ground for 60 % of its cycle (D. A. Winter, "Biomechanics and Motor Control of Human
Movement", 4th edition, 2009), where it does not move while the body passes over it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import wrap_angle
from gridtrack.simulation.motion import smoothed

STEP_PER_HEIGHT = 0.4
"""Length of a step at the preferred speed, as a share of the height."""
PREFERRED_PER_HEIGHT_HZ = 0.77
"""Preferred speed in heights per second: 1.35 m/s for 1.75 m."""
SPEED_EXPONENT = 0.42
LONGEST_STEP_S = 0.9
"""A slow walker makes shorter steps rather than slower ones."""
STANCE = 0.6
"""Share of its cycle that a foot is on the ground."""
SPEED_STD_S = 0.15
HIP_PER_HEIGHT = 0.53


def step_length_m(speed: NDArray[np.float64], height_m: float) -> NDArray[np.float64]:
    """The length of a step (n,), metres, at speeds (n,) in metres per second."""
    relative = np.abs(speed) / (PREFERRED_PER_HEIGHT_HZ * height_m)
    return np.minimum(STEP_PER_HEIGHT * height_m * relative**SPEED_EXPONENT, LONGEST_STEP_S * np.abs(speed))


def foot_offset(phase: NDArray[np.float64]) -> NDArray[np.float64]:
    """How far ahead of the body a foot is (n,), in strides (two steps), at `phase` (n,) of its cycle.

    The cycle is 1 long and begins where the foot is set down. On the ground it stays behind evenly; in the swing it
    leaves and meets the ground at rest (a cubic with the slope of the stance at both ends).
    """
    phase = np.mod(phase, 1.0)
    reach = STANCE / 2.0
    u = np.clip((phase - STANCE) / (1.0 - STANCE), 0.0, 1.0)
    swing = reach * (6.0 * u**2 - 4.0 * u**3 - 1.0) - (1.0 - STANCE) * (2.0 * u**3 - 3.0 * u**2 + u)
    return np.where(phase < STANCE, reach - phase, swing)


def feet(
    position: NDArray[np.float64], heading: NDArray[np.float64], rate_hz: float, height_m: float, first_phase: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """How far the left and the right foot are ahead of the body: (n, 2) each, metres, body frame (x forward, y left).

    `position` (n, 2) and `heading` (n,) are the body's in successive frames; the feet's distance from one another
    across is not part of the offsets. A body that stands has its feet side by side.
    """
    if len(position) < 2:
        return np.zeros((len(position), 2)), np.zeros((len(position), 2))
    velocity = smoothed(np.gradient(position, 1.0 / rate_hz, axis=0), max(SPEED_STD_S * rate_hz, 0.5))
    speed = np.hypot(velocity[:, 0], velocity[:, 1])
    stride = 2.0 * step_length_m(speed, height_m)
    cycles = np.divide(speed, stride, out=np.zeros_like(speed), where=stride > 0.0) / rate_hz
    phase = first_phase + np.concatenate([[0.0], np.cumsum((cycles[1:] + cycles[:-1]) / 2.0)])
    direction = wrap_angle(np.arctan2(velocity[:, 1], velocity[:, 0]) - heading)
    along = np.column_stack([np.cos(direction), np.sin(direction)])
    return (
        (stride * foot_offset(phase))[:, None] * along,
        (stride * foot_offset(phase + 0.5))[:, None] * along,
    )

"""The particle grid's parameters; `fit` tunes those that the place and its movers decide."""

from __future__ import annotations

from pydantic import Field

from gridtrack.common.config import Settings

NAME = "dogma"
"""What the tracker is called."""


class DogmaSettings(Settings):
    """Settings of the particle grid; defaults suit what moves at a junction."""

    particles: int = Field(100_000, ge=100, le=10_000_000)
    """How many particles there are; as many persist as are resampled."""

    # Inverse sensor model
    occupied_mass: float = Field(0.9, gt=0, lt=1)
    """Mass of occupied that a return gives its cell."""
    free_mass: float = Field(0.9, gt=0, lt=1)
    """Mass of free that a cell gets which beams only cross."""
    return_noise_m: float = Field(0.1, gt=0, le=10)
    """Standard deviation of a return about the surface, along each axis; for centres of cells, of those about it."""
    association_probability: float = Field(0.5, ge=0, lt=1)
    """Probability p_A that a return tells where in its cell the surface is."""

    # Birth and life
    birth_probability: float = Field(0.005, gt=0, lt=1)
    """Probability p_B that an object appears in a cell within a period."""
    mean_lifetime_s: float = Field(10.0, gt=0, le=3600)
    """Mean time until what is not seen is no longer believed in."""
    free_decay_s: float = Field(3.0, gt=0, le=3600)
    """Time constant with which free mass becomes unknown."""
    static_share: float = Field(0.2, ge=0, le=1)
    """The share of newborn particles that rest."""
    birth_speed: float = Field(5.0, gt=0, le=100)
    """Standard deviation of the velocity of the others along each axis, m/s."""

    # Process model
    acceleration: float = Field(0.4, gt=0, le=100)
    """White-noise acceleration of what moves: square root of its density, m/s^2 per sqrt(Hz)."""
    position_noise_m: float = Field(0.02, ge=0, le=10)
    """Noise of the place of what moves, metres in a period: legs alternate, surfaces come and go."""
    start_stop_speed: float = Field(0.5, gt=0, le=100)
    """Below this what moves may stop, and about this fast it starts, m/s."""
    time_to_start_s: float = Field(30.0, gt=0, le=3600)
    """Mean time at rest."""
    time_to_stop_s: float = Field(10.0, gt=0, le=3600)
    """Mean time until what creeps stops."""

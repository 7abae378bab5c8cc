"""Settings of the particle grid; `fit` tunes the settings that depend on the site and its traffic."""

from __future__ import annotations

from pydantic import Field

from gridtrack.common.config import Settings


class DogmaSettings(Settings):
    """Settings of the particle grid; the defaults are for the traffic of a junction."""

    particles: int = Field(100_000, ge=100, le=10_000_000)
    """Number of particles, persistent and newborn together."""

    # Inverse sensor model
    occupied_mass: float = Field(0.9, gt=0, lt=1)
    """Mass of "occupied" in the measurement of a cell with a return."""
    free_mass: float = Field(0.9, gt=0, lt=1)
    """Mass of "free" in the measurement of a cell that beams crossed without a return."""
    return_noise_m: float = Field(0.1, gt=0, le=10)
    """Standard deviation of a return about the surface, along each axis; for cell centres, of their quantisation."""
    association_probability: float = Field(0.5, ge=0, lt=1)
    """Probability p_A that a return is informative about the position of the surface within its cell."""

    # Birth and persistence
    birth_probability: float = Field(0.005, gt=0, lt=1)
    """Probability p_B that an object appears in a cell within a period."""
    mean_lifetime_s: float = Field(10.0, gt=0, le=3600)
    """Mean time that an unobserved object persists."""
    free_decay_s: float = Field(3.0, gt=0, le=3600)
    """Time constant with which free mass decays to unknown mass."""
    static_share: float = Field(0.2, ge=0, le=1)
    """Share of newborn particles that are at rest."""
    birth_speed: float = Field(5.0, gt=0, le=100)
    """Standard deviation of the velocity of the other newborn particles along each axis, m/s."""

    # Process model
    acceleration: float = Field(0.4, gt=0, le=100)
    """White-noise acceleration of moving particles: square root of its density, m/s^2 per sqrt(Hz)."""
    position_noise_m: float = Field(0.02, ge=0, le=10)
    """Standard deviation of the position noise of moving particles, metres in a period."""
    start_stop_speed: float = Field(0.5, gt=0, le=100)
    """A particle slower than this can stop; a starting particle has about this speed, m/s."""
    time_to_start_s: float = Field(30.0, gt=0, le=3600)
    """Mean time at rest."""
    time_to_stop_s: float = Field(10.0, gt=0, le=3600)
    """Mean time until a slow particle stops."""

"""The filter: Dempster-Shafer masses and particles of a grid, updated with each frame.

Equations of Nuss et al., "A random finite set approach for dynamic occupancy grid maps with real-time application"
(IJRR 2018, arXiv 1605.02406), section V. Masses are (M, M) float32; the remaining mass 1 - m_O - m_F is unknown.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from gridtrack.common.config import Settings
from gridtrack.common.grid import GridFrame, GridSpec, Mask, Shift, rolled, shift_between
from gridtrack.trackers.cell_records import HiddenTime, OpenSpace
from gridtrack.trackers.dogma.particles import (
    Birth,
    Motion,
    Particles,
    Returns,
    predict_particles,
    random_stream,
    resample_particles,
    sort_by_cell,
    weight_particles,
)

MAX_PREDICTED_MASS = np.float32(0.98)
"""Upper bound of predicted occupied mass: Dempster's rule never revises a mass of 1."""
CLOSED_SHARE = 0.04
"""Cells that were open in a larger share of the recent frames are open space."""


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


Mass = NDArray[np.float32]


class Masses(NamedTuple):
    """Evidence of a grid: `occupied` and `free` (M, M) float32, each at least 0 and together at most 1."""

    occupied: Mass
    free: Mass


def measured_masses(visible: Mask, occupied: Mask, occupied_mass: float, free_mass: float) -> Masses:
    """Masses of a frame: `occupied_mass` in cells with a return, `free_mass` in cells that beams only crossed."""
    hit = np.where(occupied, np.float32(occupied_mass), np.float32(0.0))
    return Masses(hit, np.where(visible & ~occupied, np.float32(free_mass), np.float32(0.0)))


def predicted_free(free: Mass, keep: float, occupied: Mass) -> Mass:
    """Predicted free mass: the share `keep` of `free`, bounded by 1 less the predicted `occupied` mass."""
    return np.asarray(np.minimum(free * np.float32(keep), 1 - occupied))


def combined(prior: Masses, evidence: Masses) -> Masses:
    """Dempster's rule of combination; the conflict must be below 1."""
    unknown, ignorance = 1 - prior.occupied - prior.free, 1 - evidence.occupied - evidence.free
    conflict = prior.occupied * evidence.free + prior.free * evidence.occupied
    occupied = prior.occupied * (evidence.occupied + ignorance) + unknown * evidence.occupied
    free = prior.free * (evidence.free + ignorance) + unknown * evidence.free
    return Masses(occupied / (1 - conflict), free / (1 - conflict))


def newborn_mass(occupied: Mass, predicted: Mass, birth_probability: float) -> Mass:
    """Newborn part of the updated mass `occupied`, given the `predicted` occupied mass; the rest is persistent.

    rho_b = m_O p_B (1 - m_O+) / (m_O+ + p_B (1 - m_O+))
    """
    born = np.float32(birth_probability) * (1 - predicted)
    return np.asarray(occupied * born / (predicted + born), np.float32)


class ParticleGrid:
    """Masses and particles, float32, of a grid with a window that scrolls with the sensor.

    `masses` (M, M) are from the last frame, in its window. The first `count` of `particles` have the weight `weight`
    each; `persisted` (M * M, 2) int32 are the first and last (exclusive) persistent particles of a cell, others are
    newborn. `hidden` is the time since each cell was last seen.
    """

    def __init__(self, grid: GridSpec, period_s: float, settings: DogmaSettings, seed: int) -> None:
        self.grid, self.period_s, self.settings, self.seed = grid, period_s, settings, seed
        self.masses = Masses(np.zeros(grid.shape, np.float32), np.zeros(grid.shape, np.float32))
        self.particles, self._moved = Particles.empty(settings.particles), Particles.empty(settings.particles)
        self.count, self.weight = 0, 0.0
        self.persisted = np.zeros((grid.size**2, 2), np.int32)
        self.frame: GridFrame | None = None
        self.draws = 0
        self._cells = np.empty(settings.particles, np.int32)
        self._starts = np.empty(grid.size**2 + 2, np.int32)
        self._weights = np.empty(settings.particles, np.float32)
        speed = settings.birth_speed * period_s / grid.cell_m
        self._resting, self._birth_speed = np.full(grid.shape, settings.static_share, np.float32), np.float32(speed)
        self._came_in: Mask = np.zeros(grid.shape, np.bool_)
        self._open_space = OpenSpace(grid.shape, period_s)
        self.hidden = HiddenTime(grid.shape)

    def update(self, frame: GridFrame) -> None:
        """Update with one frame."""
        elapsed = 1.0
        if self.frame is not None:
            elapsed = (frame.stamp_ns - self.frame.stamp_ns) * 1e-9 / self.period_s
            self._scroll(shift_between(self.frame.world_T_grid, frame.world_T_grid, self.grid.cell_m))
        self.hidden.observe(frame.visible, elapsed * self.period_s)
        if self._came_in.any():
            self._open_space.observe(frame, max(1, round(elapsed)))
        self.frame = frame
        predicted = self._predict(elapsed)
        evidence = measured_masses(frame.visible, frame.occupied, self.settings.occupied_mass, self.settings.free_mass)
        self.masses = combined(predicted, evidence)
        born = newborn_mass(self.masses.occupied, predicted.occupied, self.settings.birth_probability)
        self._resample(np.where(frame.visible, born, np.float32(0.0)))

    def motion(self, periods: float) -> Motion:
        """Process model of the particles over `periods`."""
        settings, cell_m, time_s = self.settings, self.grid.cell_m, periods * self.period_s
        values = (
            periods,
            settings.position_noise_m / cell_m * math.sqrt(periods),
            settings.acceleration * math.sqrt(time_s) * self.period_s / cell_m,
            -math.expm1(-time_s / settings.time_to_start_s),
            -math.expm1(-time_s / settings.time_to_stop_s),
            settings.start_stop_speed * self.period_s / cell_m,
        )
        return Motion(*map(np.float32, values))

    def free_retention(self, periods: float) -> float:
        """Share of the free mass that remains free over `periods`."""
        return math.exp(-periods * self.period_s / self.settings.free_decay_s)

    def survival(self, periods: float) -> float:
        """Persistence probability p_S of an object over `periods`."""
        return math.exp(-periods * self.period_s / self.settings.mean_lifetime_s)

    def _scroll(self, shift: Shift) -> None:
        """Move masses and particles with the window; cells that come in are unknown.

        Particles that are now outside are removed by the prediction, with their mass.
        """
        if shift:
            self.masses = Masses(*(rolled(mass, shift, 0.0) for mass in self.masses))
            self.particles.x[: self.count] -= np.float32(shift.columns)
            self.particles.y[: self.count] -= np.float32(shift.rows)
            self._came_in = rolled(self._came_in, shift, True)
            self._open_space.scroll(shift)
            self.hidden.scroll(shift)

    def _predict(self, periods: float) -> Masses:
        """Predict and sort the particles, and predict the masses."""
        size, motion = self.grid.size, self.motion(periods)
        predict_particles(self.particles, self.count, size, motion, self._next_counter(), self._cells, self._starts)
        sort_by_cell(self.particles, self.count, self._cells, self._starts, self._moved)
        counts = np.diff(self._starts)[: size * size].reshape(size, size)
        weight = np.float32(self.weight * self.survival(periods))
        occupied = np.minimum(counts.astype(np.float32) * weight, MAX_PREDICTED_MASS)
        return Masses(occupied, predicted_free(self.masses.free, self.free_retention(periods), occupied))

    def _resample(self, born: Mass) -> None:
        """Distribute the mass of each cell to its persistent and newborn particles, and resample to equal weights."""
        returns, persistent = self._returns(), self.masses.occupied - born
        weight_particles(self._moved, self._starts, persistent.reshape(-1), returns, self._weights)
        self.count = resample_particles(
            self._moved,
            self._starts,
            self._weights,
            born.reshape(-1),
            returns,
            Birth(self._resting_share().reshape(-1), self._birth_speed),
            self._next_counter(),
            self.particles,
            self.persisted,
        )
        self.weight = float(self.masses.occupied.sum(dtype=np.float64)) / max(self.count, 1)

    def _resting_share(self) -> Mass:
        """Share (M, M) of newborn particles at rest; 1 in cells that came in and were hardly ever open."""
        if not self._came_in.any():
            return self._resting
        return np.where(self._came_in & self._open_space.closed(CLOSED_SHARE), np.float32(1.0), self._resting)

    def _returns(self) -> Returns:
        """One return of each cell of the frame, the last if there are several."""
        assert self.frame is not None
        cells, inside = self.grid.cells_of(self.frame.points)
        rows, columns = cells[inside].T
        points = np.full((self.grid.size**2, 2), np.nan, np.float32)
        points[rows * self.grid.size + columns] = (self.frame.points[inside] - self.grid.origin) / self.grid.cell_m
        deviation = np.float32(self.settings.return_noise_m / self.grid.cell_m)
        return Returns(points, deviation, np.float32(self.settings.association_probability))

    def _next_counter(self) -> np.uint64:
        self.draws += 1
        return random_stream(self.seed, self.draws)

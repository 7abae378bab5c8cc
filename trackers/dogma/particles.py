"""Particles: positions and velocities as float32 arrays; prediction, counting sort by cell, weights, resampling.

Positions are in cells from the corner of the grid, velocities in cells per period. All particles have equal weight.

Random numbers are a counter hashed by SplitMix64 (Steele, Lea and Flood, "Fast splittable pseudorandom number
generators", OOPSLA 2014), normal deviates from a table of quantiles. The counter is the only state: the same counter
gives the same numbers.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

Component = NDArray[np.float32]

_QUANTILES = 4096
NORMAL = ndtri((np.arange(_QUANTILES) + 0.5) / _QUANTILES).astype(np.float32)
"""Equally probable values of a standard normal deviate; the largest is 3.7."""

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_1, _MIX_2 = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_30, _27, _31 = np.uint64(30), np.uint64(27), np.uint64(31)
_INDEX = np.uint64(_QUANTILES - 1)
_48 = np.uint64(48)
_UNIT = np.float32(2.0**-16)


class Particles(NamedTuple):
    """`x`, `y`, `vx`, `vy`, each (N,) float32."""

    x: Component
    y: Component
    vx: Component
    vy: Component

    @classmethod
    def empty(cls, count: int) -> Particles:
        """Room for `count` particles."""
        return cls(*(np.empty(count, np.float32) for _ in range(4)))


class Motion(NamedTuple):
    """Process model over `periods`, in cells and periods, each a float32.

    `position` and `velocity` are standard deviations of the noise of moving particles. A particle at rest starts with
    probability `start` at about `threshold_speed`; a slower one stops with probability `stop`.
    """

    periods: np.float32
    position: np.float32
    velocity: np.float32
    start: np.float32
    stop: np.float32
    threshold_speed: np.float32


class Returns(NamedTuple):
    """One return of each cell: `points` (M * M, 2), cells, NaN if there is none.

    It has the standard deviation `deviation` about the surface, and is informative with probability `association`.
    """

    points: NDArray[np.float32]
    deviation: np.float32
    association: np.float32


class Birth(NamedTuple):
    """Newborn particles, float32.

    `resting` (M * M,): the share at rest in each cell; `speed`: standard deviation of the other velocities.
    """

    resting: Component
    speed: np.float32


def random_stream(seed: int, number: int) -> np.uint64:
    """The first counter (uint64) of stream `number` of `seed`; consecutive streams are 2**40 draws apart."""
    start = int(hashed(np.uint64(seed % 2**64))) + number * 2**40 * int(_GOLDEN)
    return np.uint64(start % 2**64)


@numba.njit(error_model="numpy")
def hashed(counter):  # type: ignore[no-untyped-def]
    """64 random bits of a counter, both uint64."""
    z = (counter ^ (counter >> _30)) * _MIX_1
    z = (z ^ (z >> _27)) * _MIX_2
    return z ^ (z >> _31)


@numba.njit(error_model="numpy")
def next_counter(counter):  # type: ignore[no-untyped-def]
    """The next counter."""
    return counter + _GOLDEN


@numba.njit(error_model="numpy")
def normal(bits, number):  # type: ignore[no-untyped-def]
    """A standard normal deviate, float32: `number` 0, 1, 2 or 3, each from 12 bits of its own."""
    return NORMAL[(bits >> np.uint64(12 * number)) & _INDEX]


@numba.njit(error_model="numpy")
def uniform(bits):  # type: ignore[no-untyped-def]
    """A multiple of 2**-16 in [0, 1), float32, from bits 48 to 63, independent of the normal deviates."""
    return np.float32(bits >> _48) * _UNIT


@numba.njit(error_model="numpy")
def predict_particle(x, y, vx, vy, motion, counter):  # type: ignore[no-untyped-def]
    """Position and velocity of one particle after `motion`: nearly constant velocity, or at rest."""
    bits = hashed(counter)
    chance = uniform(bits)
    if vx == 0.0 and vy == 0.0:
        if chance < motion.start:
            vx, vy = motion.threshold_speed * normal(bits, 0), motion.threshold_speed * normal(bits, 1)
        return x + motion.periods * vx, y + motion.periods * vy, vx, vy
    if chance < motion.stop and vx * vx + vy * vy < motion.threshold_speed * motion.threshold_speed:
        return x, y, np.float32(0.0), np.float32(0.0)
    ax, ay = motion.velocity * normal(bits, 0), motion.velocity * normal(bits, 1)
    half = np.float32(0.5)
    x += motion.periods * (vx + half * ax) + motion.position * normal(bits, 2)
    y += motion.periods * (vy + half * ay) + motion.position * normal(bits, 3)
    return x, y, vx + ax, vy + ay


@numba.njit(cache=True, nogil=True, error_model="numpy")
def predict_particles(particles, count, size, motion, counter, cells, starts):  # type: ignore[no-untyped-def]
    """Predict the first `count` particles, and write the cell of each to `cells` (N,) int32.

    A cell is row * size + column, or size² outside the grid. `starts` (size² + 2,) int32 receives the index of the
    first particle of each cell in sorted order.
    """
    starts[:] = 0
    outside = size * size
    for i in range(count):
        counter = next_counter(counter)
        x, y, vx, vy = predict_particle(
            particles.x[i], particles.y[i], particles.vx[i], particles.vy[i], motion, counter
        )
        particles.x[i], particles.y[i], particles.vx[i], particles.vy[i] = x, y, vx, vy
        inside = 0.0 <= x < size and 0.0 <= y < size
        cell = np.int32(y) * size + np.int32(x) if inside else outside
        cells[i] = cell
        starts[cell + 1] += 1
    for cell in range(outside + 1):
        starts[cell + 1] += starts[cell]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def sort_by_cell(particles, count, cells, starts, out):  # type: ignore[no-untyped-def]
    """Write the first `count` particles, ordered by cell, to `out`: a counting sort.

    `cells` and `starts`: from `predict_particles`.
    """
    position = starts.copy()
    for i in range(count):
        index = position[cells[i]]
        position[cells[i]] = index + 1
        _store(out, index, particles.x[i], particles.y[i], particles.vx[i], particles.vy[i])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def weight_particles(particles, starts, persistent, returns, weights):  # type: ignore[no-untyped-def]
    """Distribute the mass `persistent` (M * M,) of each cell to its particles, into `weights` (N,) float32.

    The share 1 - p_A is distributed uniformly, the rest by the likelihood g(z|x) of the return of the cell; in a cell
    without a return everything is uniform. `particles` are sorted, `starts` is from `predict_particles`.
    """
    weights[starts[persistent.size] : starts[persistent.size + 1]] = 0.0  # outside the grid
    for cell in range(persistent.size):
        first, last = starts[cell], starts[cell + 1]
        if last == first:
            continue
        total_likelihood = np.float32(0.0)
        if not np.isnan(returns.points[cell, 0]):
            for i in range(first, last):
                weights[i] = _likelihood(particles.x[i], particles.y[i], returns.points[cell], returns.deviation)
                total_likelihood += weights[i]
        uniform_share = persistent[cell] / np.float32(last - first)
        if total_likelihood == 0.0:
            weights[first:last] = uniform_share
            continue
        likelihood_share = persistent[cell] * returns.association / total_likelihood
        uniform_share *= np.float32(1.0) - returns.association
        for i in range(first, last):
            weights[i] = uniform_share + likelihood_share * weights[i]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def resample_particles(particles, starts, weights, born, returns, birth, counter, out, persisted):  # type: ignore[no-untyped-def]
    """Fill `out` from particles (N,) with `weights` and from the mass `born` (M * M,); return the number of particles.

    Systematic resampling of the joint set, cell by cell: thresholds are evenly spaced along the cumulative mass, one
    for each particle of `out`. A threshold in the weight of a particle copies it; a threshold in newborn mass draws a
    new particle. `persisted` (M * M, 2) int32 receives the first and last (exclusive) index in `out` of the copies of
    each cell.
    """
    size, capacity = int(np.sqrt(born.size)), out.x.size
    count = starts[born.size]
    spacing = (np.sum(weights[:count].astype(np.float64)) + np.sum(born.astype(np.float64))) / capacity
    threshold, cumulative, filled = spacing * uniform(hashed(counter)), 0.0, 0
    for cell in range(born.size):
        persisted[cell, 0] = filled
        for i in range(starts[cell], starts[cell + 1]):
            cumulative += weights[i]
            while threshold < cumulative and filled < capacity:
                _store(out, filled, particles.x[i], particles.y[i], particles.vx[i], particles.vy[i])
                filled += 1
                threshold += spacing
        persisted[cell, 1] = filled
        cumulative += born[cell]
        while threshold < cumulative and filled < capacity:
            counter = next_counter(counter)
            x, y, vx, vy = _newborn(
                cell % size, cell // size, returns, returns.points[cell], birth.resting[cell], birth.speed, counter
            )
            _store(out, filled, x, y, vx, vy)
            filled += 1
            threshold += spacing
    return filled


@numba.njit(error_model="numpy")
def _likelihood(x, y, point, deviation):  # type: ignore[no-untyped-def]
    """Likelihood g(z|x) of a return at `point` (2,) for a surface at x, y, up to a factor."""
    dx, dy = (x - point[0]) / deviation, (y - point[1]) / deviation
    return np.exp(np.float32(-0.5) * (dx * dx + dy * dy))


@numba.njit(error_model="numpy")
def _newborn(column, row, returns, point, resting, speed, counter):  # type: ignore[no-untyped-def]
    """A newborn particle of a cell: with probability p_A near the cell's return, if any, else anywhere in the cell."""
    bits, more, choice = hashed(counter), hashed(~counter), hashed(hashed(counter))
    x, y = np.float32(column) + uniform(bits), np.float32(row) + uniform(more)
    if not np.isnan(point[0]) and uniform(choice) < returns.association:
        x = point[0] + returns.deviation * normal(choice, 0)
        y = point[1] + returns.deviation * normal(choice, 1)
    if uniform(hashed(choice)) < resting:
        return x, y, np.float32(0.0), np.float32(0.0)
    return x, y, speed * normal(bits, 0), speed * normal(bits, 1)


@numba.njit(error_model="numpy")
def _store(out, index, x, y, vx, vy):  # type: ignore[no-untyped-def]
    out.x[index], out.y[index], out.vx[index], out.vy[index] = x, y, vx, vy

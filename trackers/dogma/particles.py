"""Particles: places and velocities as float32 arrays, moved, sorted by cell without comparing, and resampled.

Places are in cells from the grid's corner, velocities in cells a period. All particles weigh the same.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from gridtrack.trackers.dogma.random_numbers import (
    after,
    first_normal,
    fourth_normal,
    hashed,
    second_normal,
    third_normal,
    uniform,
)

Column = NDArray[np.float32]


class Particles(NamedTuple):
    """`x`, `y`, `vx`, `vy`, each (N,) float32."""

    x: Column
    y: Column
    vx: Column
    vy: Column

    @classmethod
    def empty(cls, count: int) -> Particles:
        """Room for `count` particles."""
        return cls(*(np.empty(count, np.float32) for _ in range(4)))


class Motion(NamedTuple):
    """How a particle moves in a while, in cells and periods, each a float32.

    It lasts `periods`; `position` and `velocity` are standard deviations of the noise of what moves; what rests starts
    with probability `start`, and what is slower than `creep` stops with probability `stop`.
    """

    periods: np.float32
    position: np.float32
    velocity: np.float32
    start: np.float32
    stop: np.float32
    creep: np.float32


class Returns(NamedTuple):
    """What a frame says of places inside cells: a return of each cell, `points` (M * M, 2), NaN where there is none.

    It lies about the surface with standard deviation `deviation`, and belongs to it with probability `association`.
    """

    points: NDArray[np.float32]
    deviation: np.float32
    association: np.float32


class Birth(NamedTuple):
    """How newborn particles move, each a float32: the share `resting`, and the standard deviation `speed` of others."""

    resting: np.float32
    speed: np.float32


@numba.njit(error_model="numpy")
def moved(x, y, vx, vy, motion, counter):  # type: ignore[no-untyped-def]
    """Place and velocity of one particle after a while of `motion`: nearly constant velocity, or at rest."""
    bits = hashed(counter)
    chance = uniform(bits)
    if vx == 0.0 and vy == 0.0:
        if chance < motion.start:
            vx, vy = motion.creep * first_normal(bits), motion.creep * second_normal(bits)
        return x + motion.periods * vx, y + motion.periods * vy, vx, vy
    if chance < motion.stop and vx * vx + vy * vy < motion.creep * motion.creep:
        return x, y, np.float32(0.0), np.float32(0.0)
    ax, ay = motion.velocity * first_normal(bits), motion.velocity * second_normal(bits)
    half = np.float32(0.5)
    x += motion.periods * (vx + half * ax) + motion.position * third_normal(bits)
    y += motion.periods * (vy + half * ay) + motion.position * fourth_normal(bits)
    return x, y, vx + ax, vy + ay


@numba.njit(cache=True, nogil=True, error_model="numpy")
def advance(particles, count, size, motion, counter, cells, starts):  # type: ignore[no-untyped-def]
    """Move the first `count` particles; into `cells` (N,) int32 the cell of each, row * size + column, `size`² outside.

    Into `starts` (size² + 2,) int32 the place at which each cell's particles begin when they are sorted.
    """
    starts[:] = 0
    outside = size * size
    for i in range(count):
        counter = after(counter)
        x, y, vx, vy = moved(particles.x[i], particles.y[i], particles.vx[i], particles.vy[i], motion, counter)
        particles.x[i], particles.y[i], particles.vx[i], particles.vy[i] = x, y, vx, vy
        inside = 0.0 <= x < size and 0.0 <= y < size
        cell = np.int32(y) * size + np.int32(x) if inside else outside
        cells[i] = cell
        starts[cell + 1] += 1
    for cell in range(outside + 1):
        starts[cell + 1] += starts[cell]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def sort_by_cell(particles, count, cells, starts, out):  # type: ignore[no-untyped-def]
    """Into `out` the first `count` particles, those of a cell together: a counting sort.

    `cells` and `starts` as from `advance`.
    """
    place = starts.copy()
    for i in range(count):
        at = place[cells[i]]
        place[cells[i]] = at + 1
        _place(out, at, particles.x[i], particles.y[i], particles.vx[i], particles.vy[i])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def weigh(particles, starts, persistent, returns, weights):  # type: ignore[no-untyped-def]
    """Into `weights` (N,) float32 what each particle holds of the mass `persistent` (M * M,) of its cell.

    A part 1 - p_A of it is shared out evenly, the rest by the likelihood g(z|x) of the cell's return; without a return
    all of it evenly. `particles` are sorted, and `starts` as from `advance`.
    """
    weights[starts[persistent.size] : starts[persistent.size + 1]] = 0.0  # outside the grid
    for cell in range(persistent.size):
        first, last = starts[cell], starts[cell + 1]
        if last == first:
            continue
        agreeing = np.float32(0.0)
        if not np.isnan(returns.points[cell, 0]):
            for i in range(first, last):
                weights[i] = _likelihood(particles.x[i], particles.y[i], returns.points[cell], returns.deviation)
                agreeing += weights[i]
        evenly = persistent[cell] / np.float32(last - first)
        if agreeing == 0.0:
            weights[first:last] = evenly
            continue
        by_return = persistent[cell] * returns.association / agreeing
        evenly *= np.float32(1.0) - returns.association
        for i in range(first, last):
            weights[i] = evenly + by_return * weights[i]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def resample(particles, starts, weights, born, returns, birth, counter, out, persisted):  # type: ignore[no-untyped-def]
    """Fill `out` from particles (N,) of these `weights` and from the mass `born` (M * M,); the number it then holds.

    Systematic resampling of the joint set, cell by cell: marks stand evenly along the sum of all mass, one for each
    place in `out`. One that falls on a particle copies it, one that falls on newborn mass draws a particle. Into
    `persisted` (M * M, 2) int32 the first place in `out` of each cell's copies, and the one after the last.
    """
    size, wanted = int(np.sqrt(born.size)), out.x.size
    count = starts[born.size]
    spacing = (np.sum(weights[:count].astype(np.float64)) + np.sum(born.astype(np.float64))) / wanted
    mark, passed, filled = spacing * uniform(hashed(counter)), 0.0, 0
    for cell in range(born.size):
        persisted[cell, 0] = filled
        for i in range(starts[cell], starts[cell + 1]):
            passed += weights[i]
            while mark < passed and filled < wanted:
                _place(out, filled, particles.x[i], particles.y[i], particles.vx[i], particles.vy[i])
                filled += 1
                mark += spacing
        persisted[cell, 1] = filled
        passed += born[cell]
        while mark < passed and filled < wanted:
            counter = after(counter)
            x, y, vx, vy = _newborn(cell % size, cell // size, returns, returns.points[cell], birth, counter)
            _place(out, filled, x, y, vx, vy)
            filled += 1
            mark += spacing
    return filled


@numba.njit(error_model="numpy")
def _likelihood(x, y, point, deviation):  # type: ignore[no-untyped-def]
    """g(z|x) of a return at `point` (2,) for a surface at x, y, up to a factor."""
    dx, dy = (x - point[0]) / deviation, (y - point[1]) / deviation
    return np.exp(np.float32(-0.5) * (dx * dx + dy * dy))


@numba.njit(error_model="numpy")
def _newborn(column, row, returns, point, birth, counter):  # type: ignore[no-untyped-def]
    """A particle born in a cell: with probability p_A about its return, where there is one, else anywhere in it."""
    bits, more, choice = hashed(counter), hashed(~counter), hashed(hashed(counter))
    x, y = np.float32(column) + uniform(bits), np.float32(row) + uniform(more)
    if not np.isnan(point[0]) and uniform(choice) < returns.association:
        x = point[0] + returns.deviation * first_normal(choice)
        y = point[1] + returns.deviation * second_normal(choice)
    if uniform(hashed(choice)) < birth.resting:
        return x, y, np.float32(0.0), np.float32(0.0)
    return x, y, birth.speed * first_normal(bits), birth.speed * second_normal(bits)


@numba.njit(error_model="numpy")
def _place(out, at, x, y, vx, vy):  # type: ignore[no-untyped-def]
    out.x[at], out.y[at], out.vx[at], out.vy[at] = x, y, vx, vy

"""Paths of virtual robots through a window: drawn without a forecast, and followed through forecast and observation.

A robot is a disc that drives straight on at a constant speed. Its cells in a step are those with a centre in the disc,
or between its positions in the step before and in this one. Positions are in cells from the window's lower-left corner.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import Mask
from gridtrack.evaluation.referee.targets import NOT_SCORED, Target

PATHS = 400
"""Paths of a forecast, where so many are found."""
TRIES = 10 * PATHS
"""Paths that are drawn at most."""
LEAST_CLEAR = 1e-9
"""A cell is free with at least this probability, so that a ratio of such probabilities is defined."""
NEVER = int(np.iinfo(np.int16).max)
"""The step of an event that does not occur."""


@dataclass(frozen=True, slots=True)
class Paths:
    """N paths of a disc with `radius`, in cells: `starts` (N, 2) float64, x and y; `strides` (N, 2): way
    of a step."""

    starts: NDArray[np.float64]
    strides: NDArray[np.float64]
    radius: float

    def __len__(self) -> int:
        return len(self.starts)

    def at(self, chosen: Mask) -> Paths:
        """The chosen paths."""
        return Paths(self.starts[chosen], self.strides[chosen], self.radius)

    def later(self, steps: int, moved: tuple[int, int]) -> Paths:
        """The rest of the paths after `steps` steps, in a window that moved by cells (x, y)."""
        return Paths(self.starts + steps * self.strides - np.array(moved), self.strides, self.radius)


@dataclass(frozen=True, slots=True)
class Events:
    """What N paths meet in steps 1..L of an observation.

    `contact` and `unseen` (N,) int16: the first step with an occupied cell, and with an unknown cell, on the path;
    NEVER without one. `hit` (N,) int64: the cell of the contact that the disc reaches first, row * M + column, or -1.
    """

    contact: NDArray[np.int16]
    unseen: NDArray[np.int16]
    hit: NDArray[np.int64]


def draw_paths(seed: int, free: Mask, passable: Mask, radius: float, longest_stride: float, steps: int) -> Paths:
    """Up to PATHS paths of a disc with `radius`, in cells.

    The whole disc starts on `free` cells (M, M), and for `steps` steps it stays in the window and on `passable` cells
    (M, M). Starts are uniform over the window, directions uniform, strides uniform up to the longest one. The numbers
    follow from `seed` (64 bits) alone, by operations that are exact on every machine.
    """
    drawn = np.empty((PATHS, 4))
    found = _draw(np.uint64(seed), free, passable, radius, longest_stride, steps, TRIES, drawn)
    return Paths(drawn[:found, :2].copy(), drawn[:found, 2:].copy(), radius)


def events_of(paths: Paths, targets: Sequence[Target], *, has_truth: bool) -> Events:
    """What the paths meet in the `targets` of steps 1..L.

    With truth every cell is known: the interior of a body, a hidden cell that is not scored elsewhere, is occupied.
    """
    number = len(paths)
    events = Events(np.full(number, NEVER, np.int16), np.full(number, NEVER, np.int16), np.full(number, -1, np.int64))
    states = np.stack([target.state for target in targets])
    _meet(paths.starts, paths.strides, paths.radius, states, has_truth, events.contact, events.unseen, events.hit)
    return events


def risks_of(paths: Paths, occupancy: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Risks (N, L) of a contact within 1..L steps, by the forecast (L, M, M) of these steps.

    The first is the largest probability on the path, the lower bound of the probability that any of its cells is
    occupied (Frechet). The second is the probability of it for independent cells, 1 - prod(1 - p), p being the largest
    probability of a cell in a step. A cell without a probability (NaN) gives NaN.
    """
    largest = np.zeros((len(paths), len(occupancy)), np.float32)
    independent = np.zeros((len(paths), len(occupancy)))
    _risk(paths.starts, paths.strides, paths.radius, occupancy, largest, independent)
    return largest, independent


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _uniform(seed, index):  # type: ignore[no-untyped-def]
    """The number `index` of the stream `seed`, uniform in [0, 1): SplitMix64 (Steele, Lea and Flood, 2014)."""
    z = seed + (np.uint64(index) + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return np.float64(z >> np.uint64(11)) * 2.0**-53


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _draw(seed, free, passable, radius, longest, steps, tries, paths):  # type: ignore[no-untyped-def]
    """Draw paths x, y, dx, dy (N, 4) until they are full or `tries` are used; returns their number."""
    size, found, used = free.shape[0], 0, 0
    for _ in range(tries):
        x, y = size * _uniform(seed, used), size * _uniform(seed, used + 1)
        stride = longest * _uniform(seed, used + 2)
        used += 3
        east, north, square = 0.0, 0.0, 0.0
        while square > 1.0 or square < 1e-6:  # a direction without sine and cosine, which differ between libraries
            east, north = 2.0 * _uniform(seed, used) - 1.0, 2.0 * _uniform(seed, used + 1) - 1.0
            used += 2
            square = east * east + north * north
        dx, dy = stride * east / math.sqrt(square), stride * north / math.sqrt(square)
        if not _all_on(free, x, y, 0.0, 0.0, radius):
            continue
        if _all_on(passable, x, y, steps * dx, steps * dy, radius):
            paths[found, 0], paths[found, 1], paths[found, 2], paths[found, 3] = x, y, dx, dy
            found += 1
            if found == paths.shape[0]:
                break
    return found


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _all_on(mask, x, y, dx, dy, radius):  # type: ignore[no-untyped-def]
    """Whether all cells of a disc that moves by (dx, dy) are in the window and in `mask`."""
    size = mask.shape[0]
    bottom, top = _rows(y, dy, radius)
    for row in range(bottom, top):
        left, right = _columns(row, x, y, dx, dy, radius)
        if left < right and not (0 <= row < size and left >= 0 and right <= size):
            return False
        for column in range(left, right):
            if not mask[row, column]:
                return False
    return True


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _rows(y, dy, radius):  # type: ignore[no-untyped-def]
    """The first row with centres that a moving disc may cover, and the one after the last."""
    return math.ceil(min(y, y + dy) - radius - 0.5), math.floor(max(y, y + dy) + radius - 0.5) + 1


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _columns(row, x, y, dx, dy, radius):  # type: ignore[no-untyped-def]
    """The first column of a row with a centre that a disc covers on its way (dx, dy) from (x, y), and the one after the
    last: the row of centres cuts the covered area, which is convex, in the first disc, the last one, or the sides."""
    up, left, right = row + 0.5 - y, np.inf, -np.inf
    half = radius * radius - up * up
    if half >= 0.0:
        left, right = x - math.sqrt(half), x + math.sqrt(half)
    half = radius * radius - (up - dy) * (up - dy)
    if half >= 0.0:
        left, right = min(left, x + dx - math.sqrt(half)), max(right, x + dx + math.sqrt(half))
    if dy != 0.0:
        aside = radius / math.sqrt(dx * dx + dy * dy)
        for side in (aside, -aside):
            share = (up - side * dx) / dy
            if 0.0 <= share <= 1.0:
                at = x - side * dy + share * dx
                left, right = min(left, at), max(right, at)
    if left > right:
        return 0, 0
    return math.ceil(left - 0.5), math.floor(right - 0.5) + 1


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _meet(starts, strides, radius, states, known, contact, unseen, hit):  # type: ignore[no-untyped-def]
    """Set the events of each path in the states (L, M, M) of steps 1..L; `known`: a cell not scored is occupied."""
    size = states.shape[1]
    for i in range(starts.shape[0]):
        dx, dy = strides[i, 0], strides[i, 1]
        for n in range(states.shape[0]):
            x, y = starts[i, 0] + n * dx, starts[i, 1] + n * dy
            nearest = np.inf
            bottom, top = _rows(y, dy, radius)
            for row in range(max(bottom, 0), min(top, size)):
                left, right = _columns(row, x, y, dx, dy, radius)
                for column in range(max(left, 0), min(right, size)):
                    state = states[n, row, column]
                    if state == NOT_SCORED and not known:
                        unseen[i] = min(unseen[i], n + 1)
                    elif state & 1 or state == NOT_SCORED:
                        contact[i] = n + 1
                        way = _way_until(column + 0.5 - x, row + 0.5 - y, dx, dy, radius)
                        if way < nearest:
                            nearest, hit[i] = way, row * size + column
            if contact[i] != NEVER:
                break


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _way_until(right, up, dx, dy, radius):  # type: ignore[no-untyped-def]
    """The way of a disc until it covers a point, in cells, below 0 before its start; at rest, the distance."""
    stride = math.sqrt(dx * dx + dy * dy)
    if stride == 0.0:
        return math.sqrt(right * right + up * up)
    along, across = (right * dx + up * dy) / stride, (right * dy - up * dx) / stride
    return along - math.sqrt(max(radius * radius - across * across, 0.0))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _risk(starts, strides, radius, occupancy, largest, independent):  # type: ignore[no-untyped-def]
    """Set the risks (N, L) of each path by the probabilities (L, M, M) of steps 1..L."""
    steps, size = occupancy.shape[0], occupancy.shape[1]
    highest = np.zeros((size, size), np.float32)  # of each cell on the path
    for i in range(starts.shape[0]):
        dx, dy = strides[i, 0], strides[i, 1]
        most, clear = np.float32(0.0), 1.0
        for n in range(steps):
            x, y = starts[i, 0] + n * dx, starts[i, 1] + n * dy
            bottom, top = _rows(y, dy, radius)
            for row in range(max(bottom, 0), min(top, size)):
                left, right = _columns(row, x, y, dx, dy, radius)
                for column in range(max(left, 0), min(right, size)):
                    p = occupancy[n, row, column]
                    if not p <= highest[row, column]:
                        most = most if p <= most else p
                        clear *= max(1.0 - p, LEAST_CLEAR) / max(1.0 - highest[row, column], LEAST_CLEAR)
                        highest[row, column] = p
            largest[i, n], independent[i, n] = most, 1.0 - clear
        bottom, top = _rows(starts[i, 1], steps * dy, radius)
        for row in range(max(bottom, 0), min(top, size)):
            left, right = _columns(row, starts[i, 0], starts[i, 1], steps * dx, steps * dy, radius)
            for column in range(max(left, 0), min(right, size)):
                highest[row, column] = 0.0

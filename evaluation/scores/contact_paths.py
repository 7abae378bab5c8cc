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
from gridtrack.evaluation.scores.definition import Floats

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
    """N paths of a disc of L steps, with the cells of each step.

    `starts` (N, 2) float64: x and y; `strides` (N, 2): the way of a step. `cells` int32, row * M + column, are those of
    step n of path i from `ends[i, n - 1]` on, before `ends[i, n]`; `ends` (N, L+1) int64.
    """

    starts: NDArray[np.float64]
    strides: NDArray[np.float64]
    ends: NDArray[np.int64]
    cells: NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.starts)

    @property
    def steps(self) -> int:
        """The number of steps, L."""
        return self.ends.shape[1] - 1

    def at(self, chosen: Mask) -> Paths:
        """The chosen paths, with their cells only."""
        numbers = self.ends[:, -1] - self.ends[:, 0]
        gone = np.cumsum(np.where(chosen, 0, numbers))[chosen, None]
        cells = self.cells[np.repeat(chosen, numbers)]
        return Paths(self.starts[chosen], self.strides[chosen], self.ends[chosen] - gone, cells)

    def later(self, steps: int, rows: int, columns: int, size: int) -> Paths:
        """The rest of the paths after `steps` steps, in a window of `size` cells that moved by rows and columns.

        Cells outside the new window are -1.
        """
        row, column = self.cells // size - rows, self.cells % size - columns
        inside = (row >= 0) & (row < size) & (column >= 0) & (column < size)
        cells = np.where(inside, row * size + column, -1).astype(np.int32)
        starts = self.starts + steps * self.strides - np.array([columns, rows])
        return Paths(starts, self.strides, self.ends[:, steps:], cells)


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
    return paths_along(drawn[:found, :2].copy(), drawn[:found, 2:].copy(), radius, steps, len(free))


def paths_along(starts: Floats, strides: Floats, radius: float, steps: int, size: int) -> Paths:
    """Paths of a disc with `radius` from `starts` (N, 2) by `strides` (N, 2), in a window of `size` cells."""
    ends = np.zeros((len(starts), steps + 1), np.int64)
    most = int((2.0 * radius + 2.0) * (2.0 * radius + 2.0 + np.hypot(*strides.T).max(initial=0.0))) + 1
    cells = np.empty(len(starts) * steps * most, np.int32)
    used = _sweep(starts, strides, radius, size, ends, cells)
    return Paths(starts, strides, ends, cells[:used].copy())


def events_of(paths: Paths, targets: Sequence[Target], *, has_truth: bool) -> Events:
    """What the paths meet in the `targets` of their steps 1..L.

    With truth every cell is known: the interior of a body, a hidden cell that is not scored elsewhere, is occupied.
    """
    number = len(paths)
    contact, unseen = np.full((2, number), NEVER, np.int16)
    hit = np.full(number, -1, np.int64)
    states = np.stack([target.state for target in targets])
    _meet(paths.starts, paths.strides, paths.ends, paths.cells, states, has_truth, contact, unseen, hit)
    return Events(contact, unseen, hit)


def risks_of(paths: Paths, occupancy: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Risks (N, L) of a contact within 1..L steps, by the forecast (L, M, M) of these steps.

    The first is the largest probability on the path, the lower bound of the probability that any of its cells is
    occupied (Frechet). The second is the probability of it for independent cells, 1 - prod(1 - p), p being the largest
    probability of a cell in a step. A cell without a probability (NaN) gives NaN.
    """
    largest = np.zeros((len(paths), paths.steps), np.float32)
    independent = np.zeros((len(paths), paths.steps))
    _risk(paths.ends, paths.cells, occupancy.reshape(len(occupancy), -1), largest, independent)
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
def _sweep(starts, strides, radius, size, ends, cells):  # type: ignore[no-untyped-def]
    """Set the cells of each step of each path, and their `ends` (N, L+1); returns the number of cells."""
    used = 0
    for i in range(starts.shape[0]):
        dx, dy = strides[i, 0], strides[i, 1]
        ends[i, 0] = used
        for n in range(ends.shape[1] - 1):
            x, y = starts[i, 0] + n * dx, starts[i, 1] + n * dy
            bottom, top = _rows(y, dy, radius)
            for row in range(max(bottom, 0), min(top, size)):
                left, right = _columns(row, x, y, dx, dy, radius)
                for column in range(max(left, 0), min(right, size)):
                    cells[used] = row * size + column
                    used += 1
            ends[i, n + 1] = used
    return used


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _meet(starts, strides, ends, cells, states, known, contact, unseen, hit):  # type: ignore[no-untyped-def]
    """Set the events of each path in the states (L, M, M) of steps 1..L; `known`: a cell not scored is occupied.

    Of the cells of the first contact the disc hits the one that is nearest to it, seen along its way.
    """
    size = states.shape[1]
    for i in range(starts.shape[0]):
        for n in range(states.shape[0]):
            nearest = np.inf
            for c in range(ends[i, n], ends[i, n + 1]):
                row, column = cells[c] // size, cells[c] % size
                state = states[n, row, column]
                if state == NOT_SCORED and not known:
                    unseen[i] = min(unseen[i], n + 1)
                elif state & 1 or state == NOT_SCORED:
                    contact[i] = n + 1
                    right, up = column + 0.5 - starts[i, 0], row + 0.5 - starts[i, 1]
                    along = right * strides[i, 0] + up * strides[i, 1]
                    if along < nearest:
                        nearest, hit[i] = along, cells[c]
            if contact[i] != NEVER:
                break


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _risk(ends, cells, occupancy, largest, independent):  # type: ignore[no-untyped-def]
    """Set the risks (N, L) of each path by the probabilities (L, M*M) of steps 1..L."""
    steps = occupancy.shape[0]
    highest = np.zeros(occupancy.shape[1], np.float32)  # of each cell on the path
    for i in range(ends.shape[0]):
        most, clear = np.float32(0.0), 1.0
        for n in range(steps):
            for c in range(ends[i, n], ends[i, n + 1]):
                cell = cells[c]
                if cell >= 0 and not occupancy[n, cell] <= highest[cell]:
                    p = occupancy[n, cell]
                    most = most if p <= most else p
                    clear *= max(1.0 - p, LEAST_CLEAR) / max(1.0 - highest[cell], LEAST_CLEAR)
                    highest[cell] = p
            largest[i, n], independent[i, n] = most, 1.0 - clear
        for c in range(ends[i, 0], ends[i, steps]):
            if cells[c] >= 0:
                highest[cells[c]] = 0.0

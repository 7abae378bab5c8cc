"""Paths of virtual robots through a window: drawn without a forecast, and followed through forecast and observation.

A robot is a disc that drives straight on at a constant speed. Its cells in a step are those with a centre in the disc,
or between its positions in the step before and in this one. Positions are in cells from the window's lower-left corner.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import Mask, Shift
from gridtrack.evaluation.referee.targets import NOT_SCORED
from gridtrack.evaluation.scores.definition import Floats

MOST_PATHS = 400
"""Paths of a forecast, where so many are found."""
MOST_DRAWN = 10 * MOST_PATHS
"""Paths that are drawn at most."""
NEVER = int(np.iinfo(np.int16).max)
"""The step of an event that does not occur."""
_STILL = Shift()


@dataclass(frozen=True, slots=True)
class Paths:
    """N paths of a disc of L steps, with the cells of each.

    `starts` (N, 2) float64: x and y; `strides` (N, 2): the way of a step. The cells of path i, in `rows` and `columns`
    (C,) int16, are those from `ends[i]` on, before `ends[i + 1]`; `ends` (N+1,) int64. The disc is on a cell in the
    steps from its `first` on, before its `after` (C,) int16, counted from 0: the number n is that of step n+1.
    """

    starts: NDArray[np.float64]
    strides: NDArray[np.float64]
    ends: NDArray[np.int64]
    rows: NDArray[np.int16]
    columns: NDArray[np.int16]
    first: NDArray[np.int16]
    after: NDArray[np.int16]

    def __len__(self) -> int:
        return len(self.starts)


@dataclass(frozen=True, slots=True)
class Events:
    """What N paths meet in steps 1..L of an observation.

    `contact` and `unseen` (N,) int16: the first step with an occupied cell, and with an unknown cell before it, on the
    path; NEVER without one. `hit` (N,) int64: the cell of the contact that the disc reaches first, row * M + column, or
    -1.
    """

    contact: NDArray[np.int16]
    unseen: NDArray[np.int16]
    hit: NDArray[np.int64]


def draw_paths(seed: int, free: Mask, passable: Mask, radius: float, longest_stride: float, steps: int) -> Paths:
    """Up to MOST_PATHS paths of a disc with `radius`, in cells.

    The whole disc starts on `free` cells (M, M), and for `steps` steps it stays in the window and on `passable` cells
    (M, M). Starts are uniform over the window, directions uniform, strides uniform up to the longest one. The numbers
    follow from `seed` (64 bits) alone, by operations that are exact on every machine.
    """
    drawn = np.empty((MOST_PATHS, 4))
    found = _draw(np.uint64(seed), free, passable, radius, longest_stride, steps, MOST_DRAWN, drawn)
    return paths_along(drawn[:found, :2].copy(), drawn[:found, 2:].copy(), radius, steps, len(free))


def paths_along(starts: Floats, strides: Floats, radius: float, steps: int, size: int) -> Paths:
    """Paths of a disc with `radius` from `starts` (N, 2) by `strides` (N, 2), in a window of `size` cells."""
    width = 2.0 * radius + 2.0
    most = int(len(starts) * width * (width + steps * np.hypot(*strides.T).max(initial=0.0))) + 1
    ends, cells = np.zeros(len(starts) + 1, np.int64), np.empty((4, most), np.int16)
    used = _sweep(starts, strides, radius, steps, size, ends, *cells)
    return Paths(starts, strides, ends, *cells[:, :used].copy())


def events_of(paths: Paths, states: NDArray[np.uint8], *, has_truth: bool) -> Events:
    """What the paths meet in the `states` (L, M, M) of their steps, as those of a target.

    With truth every cell is known: the interior of a body, a hidden cell that is not scored elsewhere, is occupied.
    """
    contact, unseen = np.full((2, len(paths)), NEVER, np.int16)
    hit = np.full(len(paths), -1, np.int64)
    cells = paths.ends, paths.rows, paths.columns, paths.first, paths.after
    eventful = ((states & 1) | (states == NOT_SCORED)).any(axis=0)
    _meet(paths.starts, paths.strides, *cells, states, eventful, has_truth, contact, unseen, hit)
    return Events(contact, unseen, hit)


def risks_of(
    paths: Paths, chosen: NDArray[np.int64], occupancy: NDArray[np.float32], gone: int = 0, shift: Shift = _STILL
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Risks (N, L) of a contact of the `chosen` (N,) paths within 1..L steps, by a forecast (L, M, M) of these steps.

    The first is the largest probability on the path, the lower bound of the probability that any of its cells is
    occupied (Frechet). The second is the probability of it for independent cells, 1 - prod(1 - p), p being the largest
    probability of a cell in a step. A cell without a probability (NaN) gives NaN. A later forecast is made after `gone`
    steps, in a window that moved by `shift`; it says nothing of these steps and of cells outside its window.
    """
    largest = np.zeros((len(chosen), len(occupancy)), np.float32)
    clear = np.ones(largest.shape)
    cells = paths.ends, paths.rows, paths.columns, paths.first, paths.after
    _risk(*cells, chosen, occupancy, gone, *shift, largest, clear)
    return largest, 1.0 - clear


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
        last_x, last_y = x + steps * dx, y + steps * dy
        # most paths that are not taken end outside the window: the ends are tried before the way
        if not (_all_on(free, x, y, 0.0, 0.0, radius) and _all_on(passable, last_x, last_y, 0.0, 0.0, radius)):
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
def _sweep(starts, strides, radius, steps, size, ends, rows, columns, first, after):  # type: ignore[no-untyped-def]
    """Set the cells of each path and their `ends` (N+1,), and the steps in which they are covered; returns the number
    of cells."""
    used = 0
    for i in range(starts.shape[0]):
        x, y, dx, dy = starts[i, 0], starts[i, 1], strides[i, 0], strides[i, 1]
        square = dx * dx + dy * dy
        inverse = 1.0 / square
        bottom, top = _rows(y, steps * dy, radius)
        for row in range(max(bottom, 0), min(top, size)):
            left, right = _columns(row, x, y, steps * dx, steps * dy, radius)
            for column in range(max(left, 0), min(right, size)):
                rows[used], columns[used], first[used], after[used] = row, column, 0, steps
                if square > 0.0:  # when the centre enters the disc and leaves it, in steps
                    right_of, above = column + 0.5 - x, row + 0.5 - y
                    nearest, aside = inverse * (right_of * dx + above * dy), right_of * dy - above * dx
                    half = inverse * math.sqrt(max(radius * radius * square - aside * aside, 0.0))
                    first[used] = math.ceil(max(nearest - half - 1.0, 0.0))
                    after[used] = math.floor(min(nearest + half + 1.0, float(steps)))
                used += 1
        ends[i + 1] = used
    return used


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _meet(starts, strides, ends, rows, columns, first, after, states, eventful, known, contact, unseen, hit):  # type: ignore[no-untyped-def]
    """Set the events of each path in the states (L, M, M) of steps 1..L; `known`: a cell not scored is occupied.

    Cells that are not `eventful` (M, M), as most are, are free and known in every step. Of the cells of the first
    contact the disc hits the one that is nearest to it, seen along its way.
    """
    size = states.shape[1]
    for i in range(starts.shape[0]):
        nearest = np.inf
        for c in range(ends[i], ends[i + 1]):
            row, column = rows[c], columns[c]
            if not eventful[row, column]:
                continue
            for n in range(first[c], min(after[c], contact[i])):
                state = states[n, row, column]
                if state == NOT_SCORED and not known:
                    unseen[i] = min(unseen[i], n + 1)
                elif state & 1 or state == NOT_SCORED:
                    right, up = column + 0.5 - starts[i, 0], row + 0.5 - starts[i, 1]
                    along = right * strides[i, 0] + up * strides[i, 1]
                    if n + 1 < contact[i] or along < nearest:
                        contact[i], nearest, hit[i] = n + 1, along, row * size + column
                    break


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _risk(ends, rows, columns, first, after, chosen, occupancy, gone, up, right, largest, clear):  # type: ignore[no-untyped-def]
    """Raise the largest risks (N, L) of chosen paths from 0, and lower the probabilities (N, L) that all cells are free
    from 1."""
    steps, size = occupancy.shape[0], occupancy.shape[1]
    for i in range(chosen.size):
        passed = np.ones(steps + 1)  # the probability that the cells that the disc leaves before a step are free
        for c in range(ends[chosen[i]], ends[chosen[i] + 1]):
            row, column = rows[c] - up, columns[c] - right
            if after[c] <= gone or not (0 <= row < size and 0 <= column < size):
                continue
            highest = np.float32(0.0)
            for n in range(max(first[c], gone), after[c]):
                highest = _larger(highest, occupancy[n - gone, row, column])
                largest[i, n] = _larger(largest[i, n], highest)
                clear[i, n] *= 1.0 - highest
            passed[after[c]] *= 1.0 - highest
        for n in range(1, steps):
            passed[n] *= passed[n - 1]
            clear[i, n] *= passed[n]
            largest[i, n] = _larger(largest[i, n - 1], largest[i, n])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _larger(one, other):  # type: ignore[no-untyped-def]
    """The larger probability; NaN if either is."""
    return other if (other > one) | math.isnan(other) else one

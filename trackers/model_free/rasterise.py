"""Rasterising: points about an uncertain position as probabilities of cells, and independent causes combined."""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

WINDOW_SIGMAS = 3.5
"""Half the width of the blur window; what lies beyond (0.05 %) is cut."""
SHARPEST = 0.2
"""Smallest standard deviation of the blur, in cells: below it the pixels' own size is what is seen."""


def splat(offsets: NDArray[np.float64], weights: NDArray[np.float64], cell_m: float) -> NDArray[np.float32]:
    """The points as a patch (K, K) float32 of probabilities, K odd, its middle cell centred on the track's position.

    Each point, offset (N, 2) in metres from the position, is shared bilinearly between the four nearest cells;
    no cell holds more than 1.
    """
    cells = np.asarray(offsets) / cell_m
    half = int(np.ceil(np.abs(cells).max(initial=0.0))) + 1
    patch = np.zeros((2 * half + 1, 2 * half + 1))
    corner = np.floor(cells).astype(int)
    along = cells - corner
    for right in (0, 1):
        for up in (0, 1):
            share = np.abs(1 - right - along[:, 0]) * np.abs(1 - up - along[:, 1])
            np.add.at(patch, (corner[:, 1] + half + up, corner[:, 0] + half + right), weights * share)
    return np.minimum(patch, 1.0).astype(np.float32)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def draw(image, patch, centres, deviations, weights):  # type: ignore[no-untyped-def]
    """Add to `image` (n+1, M, M) float32 the patch as it is expected to be seen, step by step.

    `patch` (K, K) float32, probabilities about a position; `centres` and `deviations` (n+1, 2), x and y, mean and
    standard deviation of that position in cells; `weights` (n+1,) probability of this alternative at each step.
    """
    half = patch.shape[0] // 2
    for step in range(image.shape[0]):
        row, row_blur = _blur_window(centres[step, 1], deviations[step, 1])
        column, column_blur = _blur_window(centres[step, 0], deviations[step, 0])
        blurred = _convolve_rows(_convolve_rows(patch, column_blur).T, row_blur * np.float32(weights[step])).T
        _add(image[step], blurred, row - half, column - half)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def draw_points(image, places, deviation, weights):  # type: ignore[no-untyped-def]
    """Add to `image` (n+1, M, M) float32 points that stay at `places` (N, 2), x and y in cells, blurred alike.

    `deviation` of the blur in cells; `weights` (N, n+1) probability that each point is there at each step.
    """
    for point in range(places.shape[0]):
        row, row_blur = _blur_window(places[point, 1], deviation)
        column, column_blur = _blur_window(places[point, 0], deviation)
        mass = np.outer(row_blur, column_blur)
        for step in range(image.shape[0]):
            _add(image[step], mass * weights[point, step], row, column)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def noisy_or(occupancy, image, existence):  # type: ignore[no-untyped-def]
    """Combine into `occupancy` (n+1, M, M) a cause that is there with probability `existence` (n+1,) at each step.

    `image` (n+1, M, M) is what the cause would show; it is independent of what is there already. Both float32.
    """
    one = np.float32(1.0)
    for step in range(occupancy.shape[0]):
        exists = np.float32(existence[step])
        target, cause = occupancy[step].reshape(-1), image[step].reshape(-1)
        for i in range(target.size):
            if cause[i] > 0.0:  # few cells are: skipping the rest is what makes it fast
                target[i] += (one - target[i]) * exists * min(cause[i], one)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _blur_window(centre, deviation):  # type: ignore[no-untyped-def]
    """First cell and mass of each cell under a Gaussian along one axis, about `centre`, in cells."""
    sigma = max(deviation, SHARPEST)
    first = math.floor(centre - WINDOW_SIGMAS * sigma)
    count = math.floor(centre + WINDOW_SIGMAS * sigma) - first + 1
    mass = np.empty(count, np.float32)
    below = math.erf((first - centre) / (sigma * math.sqrt(2.0)))
    for i in range(count):
        above = math.erf((first + i + 1 - centre) / (sigma * math.sqrt(2.0)))
        mass[i] = 0.5 * (above - below)
        below = above
    return first, mass


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _convolve_rows(image, kernel):  # type: ignore[no-untyped-def]
    """Full convolution of every row of `image` (A, B) with `kernel` (W,): (A, B + W - 1)."""
    out = np.zeros((image.shape[0], image.shape[1] + kernel.size - 1), np.float32)
    for row in range(image.shape[0]):
        for column in range(image.shape[1]):
            value = image[row, column]
            if value != 0.0:
                for i in range(kernel.size):
                    out[row, column + i] += value * kernel[i]
    return out


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _add(image, patch, first_row, first_column):  # type: ignore[no-untyped-def]
    """Add `patch` to `image` (M, M), its corner at [first_row, first_column], as far as it lies inside."""
    rows, columns = image.shape
    for i in range(max(0, -first_row), min(patch.shape[0], rows - first_row)):
        for j in range(max(0, -first_column), min(patch.shape[1], columns - first_column)):
            image[first_row + i, first_column + j] += patch[i, j]

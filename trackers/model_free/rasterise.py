"""Rasterising: the expected occupancy of tracks with uncertain poses, as probabilities of cells at each step.

A body is drawn into a patch of pixels of one or more cells, as fine as the blur requires, and the patch is convolved
with the Gaussian of the position in a window of WINDOW_SIGMAS. Lengths are in cells from the corner of the grid.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from gridtrack.trackers.model_free.arrays import Array

NEGLIGIBLE = 0.01
"""Motions are not drawn if no cell is more probable than this."""
SAME_HEADING = 0.02
"""A body keeps its patch while its heading changes by less, radians."""
U = np.uint64
"""Index type of the inner loops: unsigned indices are not counted from the end, so the loops vectorise on whole arrays.
A view of each row would do too, but its reference counting takes longer than the row."""
WINDOW_SIGMAS = 2.5
"""Half the width of the blur window; the mass beyond (1.2 %) is lost."""
MIN_BLUR = 0.2
"""Smallest standard deviation of the blur, in cells: below it the size of the cell dominates."""
PIXELS_PER_BLUR = 1.1
"""Smallest standard deviation of the blur, in pixels, if pixels of several cells are interpolated bilinearly."""
MIN_SHIFT = 0.2
"""Rows are sheared only if the first or the last row shifts by more pixels than this."""
ERF_COEFFICIENTS = tuple(
    np.float32(a) for a in (0.0705230784, 0.0422820123, 0.0092705272, 0.0001520143, 0.0002765672, 0.0000430638)
)
"""Coefficients of `_erf`."""


class Surfaces(NamedTuple):
    """Surfaces of T objects: `offsets` (N, 2) in body frames, `weights` (N,), `bounds` (T+1,) of each object.

    Here and below lengths are in cells, and positions are relative to the corner of the grid.
    """

    offsets: Array
    weights: Array
    bounds: NDArray[np.int64]


class Motions(NamedTuple):
    """Predicted motions of T objects in R regimes, at n+1 steps.

    Mean poses (T, R, n+1, 3), covariances of the positions (T, R, n+1, 2, 2), and probabilities (T, R, n+1).
    """

    poses: Array
    covariances: Array
    weights: Array


class Resident(NamedTuple):
    """Returns of T objects that may stay in place: `points` (K, 2), their `blur`, `bounds` (T+1,) of each object.

    `probability` (K, n+1) float32: P(in place) at each step.
    """

    points: Array
    bounds: NDArray[np.int64]
    probability: NDArray[np.float32]
    blur: float


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def draw_track(  # type: ignore[no-untyped-def]
    occupancy, offsets, weights, poses, covariances, moved, points, blur, in_place, existence, semantics, classes
):
    """Combine the expected occupancy of one object into `occupancy` (n+1, M, M) float32, by noisy-or.

    The object exists with probability `existence` (n+1,). Its expected occupancy is a mixture. In each of R regimes,
    of probability `moved` (R, n+1), it is its surface, `offsets` (N, 2) with `weights` (N,), at the mean `poses` (R,
    n+1, 3), x and y in cells, heading in radians, blurred by `covariances` (R, n+1, 2, 2). Or its returns are in place
    at `points` (K, 2), of probability `in_place` (K, n+1), blurred by `blur`. A position with a standard deviation
    greater than the window's side is not drawn: the object is more probably outside, and the image would have no bound.

    It is also added to `semantics` (n+1, C, M, M), multiplied by P(class), `classes` (C,); C may be 0.
    """
    size = occupancy.shape[1]
    shown = np.zeros((size, size), np.float32)
    corners, masses, points_box = _blurred_points(points, blur, size)
    mass, scales, headings = weights.sum(), np.zeros(len(moved), np.int64), np.zeros(len(moved))
    patches = [(np.zeros((1, 1), np.float32), (0, 0)) for _ in headings]
    for step in range(occupancy.shape[0]):
        box = size, 0, size, 0
        for r in range(len(moved)):
            x, y, heading = poses[r, step, 0], poses[r, step, 1], poses[r, step, 2]
            spread = covariances[r, step, 0, 0], covariances[r, step, 0, 1], covariances[r, step, 1, 1]
            weight = moved[r, step]
            if weight * _peak(mass, spread) < NEGLIGIBLE or max(spread[0], spread[2]) > size * size:
                continue
            scale = pixel_size(spread)
            if scale != scales[r] or abs(heading - headings[r]) > SAME_HEADING:
                scales[r], headings[r] = scale, heading
                patches[r] = boundary_patch(offsets, weights, heading, scale)
            box = _union(box, draw_blurred(shown, patches[r], x, y, spread, weight, scale))
        _draw_points(shown, corners, masses, in_place, step)
        box = _union(box, points_box)
        exists = np.float32(existence[step])
        _add_semantics(semantics[step], classes, shown, exists, box)
        for row in range_inside(box[0], box[1], size):
            for column in range_inside(box[2], box[3], size):
                cause = exists * min(shown[row, column], np.float32(1.0))
                occupancy[step, row, column] += (np.float32(1.0) - occupancy[step, row, column]) * cause
                shown[row, column] = np.float32(0.0)


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def draw_tracks(occupancy, surfaces, motions, resident, existence, semantics, classes):  # type: ignore[no-untyped-def]
    """`draw_track` for T tracks, with probabilities `existence` (T, n+1) and `classes` (T, C)."""
    for t in range(len(existence)):
        surface = slice(surfaces.bounds[t], surfaces.bounds[t + 1])
        seen = slice(resident.bounds[t], resident.bounds[t + 1])
        body = surfaces.offsets[surface], surfaces.weights[surface]
        motion = motions.poses[t], motions.covariances[t], motions.weights[t]
        points = resident.points[seen], resident.blur, resident.probability[seen]
        draw_track(occupancy, *body, *motion, *points, existence[t], semantics, classes[t])


@numba.njit(error_model="numpy", fastmath=True)
def _add_semantics(planes, classes, shown, exists, box):  # type: ignore[no-untyped-def]
    """Add `shown` (M, M) within `box` to `planes` (C, M, M), multiplied by P(class), `classes` (C,), and `exists`."""
    size = shown.shape[0]
    for k in range(len(classes)):
        share = exists * classes[k]
        for row in range_inside(box[0], box[1], size):
            for column in range_inside(box[2], box[3], size):
                planes[k, row, column] += share * min(shown[row, column], np.float32(1.0))


@numba.njit(error_model="numpy")
def _peak(mass, covariance):  # type: ignore[no-untyped-def]
    """Upper bound of the probability of a cell, for points of total weight `mass` blurred by `covariance`."""
    xx, xy, yy = covariance
    return min(1.0, mass / (2.0 * math.pi * math.sqrt(max(xx * yy - xy * xy, 1e-9))))


@numba.njit(error_model="numpy")
def _blurred_points(points, blur, size):  # type: ignore[no-untyped-def]
    """Corner (K, 2) and mass (K, W, W) of each of `points` (K, 2), x and y, blurred by `blur`; the box of all."""
    width = int(2.0 * WINDOW_SIGMAS * max(blur, MIN_BLUR)) + 2
    corners, masses = np.empty((len(points), 2), np.int64), np.zeros((len(points), width, width), np.float32)
    box = size, 0, size, 0
    for k in range(len(points)):
        first_row, rows = blur_window(points[k, 1], blur)
        first_column, columns = blur_window(points[k, 0], blur)
        corners[k, 0], corners[k, 1] = first_row, first_column
        for i in range(len(rows)):
            for j in range(len(columns)):
                masses[k, i, j] = rows[i] * columns[j]
        box = _union(box, (first_row, first_row + width, first_column, first_column + width))
    return corners, masses, box


@numba.njit(error_model="numpy", fastmath=True)
def _draw_points(shown, corners, masses, weights, step):  # type: ignore[no-untyped-def]
    """Add the `masses` (K, W, W) at `corners` (K, 2), times `weights` (K, n+1) at a step, to `shown` (M, M)."""
    size, width = shown.shape[0], masses.shape[1]
    for k in range(len(corners)):
        row, column, weight = corners[k, 0], corners[k, 1], weights[k, step]
        for i in range(max(0, -row), min(width, size - row)):
            for j in range(max(0, -column), min(width, size - column)):
                shown[row + i, column + j] += masses[k, i, j] * weight


@numba.njit(error_model="numpy")
def _union(box, other):  # type: ignore[no-untyped-def]
    """The bounding box of two boxes."""
    return min(box[0], other[0]), max(box[1], other[1]), min(box[2], other[2]), max(box[3], other[3])


@numba.njit(error_model="numpy")
def range_inside(first, last, size):  # type: ignore[no-untyped-def]
    """The rows, or columns, from `first` up to but not including `last` that are inside the grid."""
    return range(U(min(max(first, 0), size)), U(min(max(last, 0), size)))


@numba.njit(error_model="numpy")
def pixel_size(covariance):  # type: ignore[no-untyped-def]
    """Side of a pixel, in cells, for a body that is blurred with this `covariance`."""
    xx, xy, yy = covariance
    smallest = math.sqrt(max(0.5 * (xx + yy) - math.hypot(0.5 * (xx - yy), xy), 0.0))
    return max(1, int(smallest / PIXELS_PER_BLUR))


@numba.njit(error_model="numpy")
def boundary_patch(offsets, weights, heading, scale):  # type: ignore[no-untyped-def]
    """The boundary as a patch (A, B) float32 of pixels of `scale` cells, and the row and column of its corner.

    The position of the body is the centre of pixel (0, 0). Each point is distributed bilinearly to the four nearest
    pixels; the value of a pixel is the mean probability of its cells.
    """
    cosine, sine = math.cos(heading) / scale, math.sin(heading) / scale
    x, y = np.empty(len(offsets)), np.empty(len(offsets))
    least_x = least_y = np.inf
    most_x = most_y = -np.inf
    for j in range(len(offsets)):
        x[j] = cosine * offsets[j, 0] - sine * offsets[j, 1]
        y[j] = sine * offsets[j, 0] + cosine * offsets[j, 1]
        least_x, most_x = min(least_x, x[j]), max(most_x, x[j])
        least_y, most_y = min(least_y, y[j]), max(most_y, y[j])
    left, bottom = math.floor(least_x), math.floor(least_y)
    patch = np.zeros((math.floor(most_y) - bottom + 2, math.floor(most_x) - left + 2), np.float32)
    cells = scale * scale
    for j in range(len(offsets)):
        column, row = math.floor(x[j]), math.floor(y[j])
        right, up = x[j] - column, y[j] - row
        i, k = row - bottom, column - left
        share = weights[j] / cells
        patch[i, k] += share * (1.0 - up) * (1.0 - right)
        patch[i, k + 1] += share * (1.0 - up) * right
        patch[i + 1, k] += share * up * (1.0 - right)
        patch[i + 1, k + 1] += share * up * right
    for i in range(patch.shape[0]):
        for k in range(patch.shape[1]):
            patch[i, k] = min(patch[i, k], np.float32(1.0))
    return patch, (bottom, left)


@numba.njit(error_model="numpy", fastmath=True)
def draw_blurred(shown, body, x, y, covariance, weight, scale):  # type: ignore[no-untyped-def]
    """Add a blurred `body` (its patch and corner) at x, y, times `weight`, to `shown` (M, M).

    Returns the bounding box of the changed cells: first and last row, first and last column, the last ones excluded.
    """
    patch, corner = body
    image, row, column = _blurred(patch, corner, x / scale, y / scale, _pixel_covariance(covariance, scale), weight)
    box = row * scale, (row + image.shape[0]) * scale, column * scale, (column + image.shape[1]) * scale
    if scale == 1:
        _add(shown, image, row, column)
    else:
        _add_enlarged(shown, image, box, scale)
    return box


@numba.njit(error_model="numpy", fastmath=True)
def _add(shown, image, row, column):  # type: ignore[no-untyped-def]
    """Add the `image` (A, B) with its corner at this row and column to `shown` (M, M)."""
    size = len(shown)
    for i in range_inside(row, row + image.shape[0], size):
        for j in range_inside(column, column + image.shape[1], size):
            shown[i, j] += image[i - U(row), j - U(column)]


@numba.njit(error_model="numpy", fastmath=True)
def _add_enlarged(shown, image, box, scale):  # type: ignore[no-untyped-def]
    """Add the `image` (A, B) with pixels of `scale` cells, which cover the `box`, to `shown` (M, M)."""
    size = len(shown)
    wide = np.empty((image.shape[0], size), np.float32)
    for j in range_inside(box[2], box[3], size):
        x, aside = _pixel(j - U(box[2]), scale, image.shape[1])
        beside = min(x + U(1), U(image.shape[1] - 1))
        for i in range(U(len(image))):
            wide[i, j] = image[i, x] + (image[i, beside] - image[i, x]) * aside
    for i in range_inside(box[0], box[1], size):
        y, up = _pixel(i - U(box[0]), scale, len(image))
        above = min(y + U(1), U(len(image) - 1))
        for j in range_inside(box[2], box[3], size):
            shown[i, j] += wide[y, j] + (wide[above, j] - wide[y, j]) * up


@numba.njit(error_model="numpy")
def _pixel_covariance(covariance, scale):  # type: ignore[no-untyped-def]
    """The covariance in pixels, without the variance that the interpolation adds."""
    xx, xy, yy = covariance
    pixel, less = 1.0 / (scale * scale), 1.0 / 6.0 if scale > 1 else 0.0
    return xx * pixel - less, xy * pixel, yy * pixel - less


@numba.njit(error_model="numpy")
def _pixel(cell, scale, count):  # type: ignore[no-untyped-def]
    """The last of `count` pixels with its centre not beyond a cell's centre, and the fraction of the way to the
    next."""
    position = min(max((cell + 0.5) / scale - 0.5, 0.0), count - 1.0)
    return U(position), np.float32(position - math.floor(position))


@numba.njit(error_model="numpy", fastmath=True)
def _blurred(patch, corner, x, y, covariance, weight):  # type: ignore[no-untyped-def]
    """The patch (A, B) at x, y, blurred, times `weight`: an image and the row and column of its corner, in pixels.

    A blur along x precedes a blur along y, which shears the rows for the correlation of x and y.
    """
    xx, xy, yy = covariance
    var_x, var_y = max(xx, MIN_BLUR**2), max(yy, MIN_BLUR**2)
    slope = xy / var_y
    first_row, rows = blur_window(y, math.sqrt(var_y))
    first_column, columns = blur_window(x, math.sqrt(max(var_x - slope * slope * var_y, MIN_BLUR**2)))
    along = _blur_rows(patch, columns)
    most = abs(slope) * len(rows)
    margin = 0 if most < MIN_SHIFT else math.ceil(most) + 1
    width = along.shape[1] - 2
    image = np.zeros((patch.shape[0] + len(rows) - 1, width + 2 * margin), np.float32)
    for i in range(len(rows)):
        shift = slope * (first_row + i + 0.5 - y) if margin else 0.0
        left, aside = math.floor(shift), np.float32(shift - math.floor(shift))
        share = rows[i] * np.float32(weight)
        here, beside = share * (np.float32(1.0) - aside), share * aside
        for k in range(patch.shape[0]):
            target, source, first = U(i + k), U(k), U(margin + left)
            if margin:
                for j in range(U(width + 1)):
                    image[target, first + j] += here * along[source, j + U(1)] + beside * along[source, j]
            else:
                for j in range(U(width)):
                    image[target, j] += share * along[source, j + U(1)]
    return image, first_row + corner[0], first_column + corner[1] - margin


@numba.njit(error_model="numpy", fastmath=True)
def _blur_rows(image, kernel):  # type: ignore[no-untyped-def]
    """Full convolution of each row of `image` (A, B) with `kernel` (W,), padded by zeros: (A, B + W + 1)."""
    out = np.zeros((image.shape[0], image.shape[1] + kernel.size + 1), np.float32)
    for row in range(image.shape[0]):
        for column in range(image.shape[1]):
            value = image[row, column]
            if value != 0.0:
                k, first = U(row), U(column + 1)
                for i in range(U(kernel.size)):
                    out[k, first + i] += value * kernel[i]
    return out


@numba.njit(error_model="numpy", fastmath=True)
def blur_window(centre, deviation):  # type: ignore[no-untyped-def]
    """First cell of the window of a Gaussian along one axis around `centre`, in cells, and the mass of each cell."""
    sigma = max(deviation, MIN_BLUR)
    first = math.floor(centre - WINDOW_SIGMAS * sigma)
    mass = np.empty(math.floor(centre + WINDOW_SIGMAS * sigma) - first + 1, np.float32)
    cell = np.float32(1.0 / (sigma * math.sqrt(2.0)))
    begin = np.float32(first - centre) * cell
    for i in range(U(len(mass))):
        edge = begin + np.float32(i) * cell
        mass[i] = np.float32(0.5) * (_erf(edge + cell) - _erf(edge))
    return first, mass


@numba.njit(error_model="numpy", fastmath=True)
def _erf(x):  # type: ignore[no-untyped-def]
    """The error function, error 3e-7, without branch or exponential (Abramowitz and Stegun 1964, 7.1.28)."""
    y = abs(x)
    a, b, c, d, e, f = ERF_COEFFICIENTS
    power = np.float32(1.0) + y * (a + y * (b + y * (c + y * (d + y * (e + y * f)))))
    for _ in range(4):
        power *= power
    return math.copysign(np.float32(1.0) - np.float32(1.0) / power, x)

"""Rasterising: a body about an uncertain pose as probabilities of cells, step by step, in the window it can be in."""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from gridtrack.trackers.model_free.arrays import Array

U = np.uint64
"""An index in the loops that take the time: an unsigned one is never counted from the end, so that they vectorise on
whole arrays. A view of each row would do, but to count the references to it takes longer than the row."""

WINDOW_SIGMAS = 2.5
"""Half the width of the blur window; what lies beyond (1.2 %) is cut."""
SHARPEST = 0.2
"""Smallest standard deviation of the blur, in cells: below it the pixels' own size is what is seen."""
FINENESS = 1.1
"""A blur of so many pixels is drawn with bilinear interpolation between them."""
NEGLIGIBLE = 0.01
"""What makes no cell more probable than this is not drawn."""
LEAST_SHIFT = 0.2
"""Rows that the blur's slant shifts by fewer cells than this, from the first to the last, are not shifted."""
SAME_HEADING = 0.02
"""A body that has turned by less, radians, is drawn as it was."""
ERF = tuple(np.float32(a) for a in (0.0705230784, 0.0422820123, 0.0092705272, 0.0001520143, 0.0002765672, 0.0000430638))
"""Coefficients of `_erf`."""


class Surfaces(NamedTuple):
    """What T objects look like: points (N, 2) in the bodies' frames, their weights (N,), each object's `bounds` (T+1,).

    Here and below lengths are in cells, and positions from the grid's corner.
    """

    offsets: Array
    weights: Array
    bounds: NDArray[np.int64]


class Motions(NamedTuple):
    """Where T objects may be at n+1 steps, by each of R motions: mean poses (T, R, n+1, 3), the covariances of the
    positions (T, R, n+1, 2, 2), and how likely each is (T, R, n+1).
    """

    poses: Array
    covariances: Array
    weights: Array


class Staying(NamedTuple):
    """Where T objects were seen, `places` (K, 2) with a `blur`, each object's `bounds` (T+1,); P(still so) (K, n+1)."""

    places: Array
    bounds: NDArray[np.int64]
    still: NDArray[np.float32]
    blur: float


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def draw_tracks(occupancy, surfaces, motions, staying, existence, semantics, classes):  # type: ignore[no-untyped-def]
    """As `draw_track` for T tracks, each there with probability `existence` (T, n+1), of `classes` (T, C)."""
    for t in range(len(existence)):
        surface = slice(surfaces.bounds[t], surfaces.bounds[t + 1])
        seen = slice(staying.bounds[t], staying.bounds[t + 1])
        body = surfaces.offsets[surface], surfaces.weights[surface]
        motion = motions.poses[t], motions.covariances[t], motions.weights[t]
        places = staying.places[seen], staying.blur, staying.still[seen]
        draw_track(occupancy, *body, *motion, *places, existence[t], semantics, classes[t])


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def draw_track(  # type: ignore[no-untyped-def]
    occupancy, offsets, weights, poses, covariances, moved, places, blur, still, existence, semantics, classes
):
    """Combine into `occupancy` (n+1, M, M) float32, by noisy-or, what one track's object shows at each step.

    The object is there with probability `existence` (n+1,). Alternatives for its returns: by one of R motions, each
    with probability `moved` (R, n+1), they look as its boundary, `offsets` (N, 2) with `weights` (N,), at the mean
    `poses` (R, n+1, 3), x and y in cells, heading in radians, blurred by `covariances` (R, n+1, 2, 2) of the position.
    Or they are still at `places` (K, 2), each with probability `still` (K, n+1), blurred by `blur`. Lengths in cells
    from the grid's corner.

    What it shows is added to `semantics` (n+1, C, M, M) as well, shared out by P(class), `classes` (C,); C may be 0.
    """
    size = occupancy.shape[1]
    shown = np.zeros((size, size), np.float32)
    corners, masses, still_box = _points(places, blur, size)
    mass, scales, headings = weights.sum(), np.zeros(len(moved), np.int64), np.zeros(len(moved))
    patches = [(np.zeros((1, 1), np.float32), (0, 0)) for _ in headings]
    for step in range(occupancy.shape[0]):
        box = size, 0, size, 0
        for r in range(len(moved)):
            x, y, heading = poses[r, step, 0], poses[r, step, 1], poses[r, step, 2]
            spread = covariances[r, step, 0, 0], covariances[r, step, 0, 1], covariances[r, step, 1, 1]
            weight = moved[r, step]
            if weight * _densest(mass, spread) < NEGLIGIBLE:
                continue
            scale = _scale(spread)
            if scale != scales[r] or abs(heading - headings[r]) > SAME_HEADING:
                scales[r], headings[r] = scale, heading
                patches[r] = _patch(offsets, weights, heading, scale)
            box = _grown(box, _draw_blurred(shown, patches[r], x, y, spread, weight, scale))
        _draw_points(shown, corners, masses, still, step)
        box = _grown(box, still_box)
        exists = np.float32(existence[step])
        _share_out(semantics[step], classes, shown, exists, box)
        for row in _inside(box[0], box[1], size):
            for column in _inside(box[2], box[3], size):
                cause = exists * min(shown[row, column], np.float32(1.0))
                occupancy[step, row, column] += (np.float32(1.0) - occupancy[step, row, column]) * cause
                shown[row, column] = np.float32(0.0)


@numba.njit(error_model="numpy", fastmath=True)
def _share_out(planes, classes, shown, exists, box):  # type: ignore[no-untyped-def]
    """Add to `planes` (C, M, M), by P(class), `classes` (C,), what is `shown` (M, M) within a box, times `exists`."""
    size = shown.shape[0]
    for k in range(len(classes)):
        share = exists * classes[k]
        for row in _inside(box[0], box[1], size):
            for column in _inside(box[2], box[3], size):
                planes[k, row, column] += share * min(shown[row, column], np.float32(1.0))


@numba.njit(error_model="numpy")
def _inside(first, last, size):  # type: ignore[no-untyped-def]
    """Those of the rows, or columns, `first` to `last`, the last one excluded, that are inside the grid."""
    return range(U(min(max(first, 0), size)), U(min(max(last, 0), size)))


@numba.njit(error_model="numpy")
def _densest(mass, covariance):  # type: ignore[no-untyped-def]
    """No cell is more probable than this where points of so much `mass` together are blurred by a `covariance`."""
    xx, xy, yy = covariance
    return min(1.0, mass / (2.0 * math.pi * math.sqrt(max(xx * yy - xy * xy, 1e-9))))


@numba.njit(error_model="numpy")
def _scale(covariance):  # type: ignore[no-untyped-def]
    """In pixels of how many cells a body so blurred is drawn: as fine as the blur calls for."""
    xx, xy, yy = covariance
    smallest = math.sqrt(max(0.5 * (xx + yy) - math.hypot(0.5 * (xx - yy), xy), 0.0))
    return max(1, int(smallest / FINENESS))


@numba.njit(error_model="numpy")
def _patch(offsets, weights, heading, scale):  # type: ignore[no-untyped-def]
    """The boundary as a patch (A, B) float32 of pixels of `scale` cells; row and column of its corner, the middle of
    pixel (0, 0) being the position.

    Each point is shared bilinearly between the four nearest pixels; a pixel holds the mean over its cells of the
    probability of points that are independent.
    """
    cosine, sine = math.cos(heading) / scale, math.sin(heading) / scale
    x, y = np.empty((2, len(offsets)))
    for j in range(len(offsets)):
        x[j] = cosine * offsets[j, 0] - sine * offsets[j, 1]
        y[j] = sine * offsets[j, 0] + cosine * offsets[j, 1]
    left, bottom = math.floor(x.min()), math.floor(y.min())
    patch = np.zeros((math.floor(y.max()) - bottom + 2, math.floor(x.max()) - left + 2), np.float32)
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
    return np.minimum(patch, np.float32(1.0)), (bottom, left)


@numba.njit(error_model="numpy", fastmath=True)
def _draw_blurred(shown, body, x, y, covariance, weight, scale):  # type: ignore[no-untyped-def]
    """Add to `shown` (M, M) a `body`, its patch and corner, about x, y, blurred, times `weight`.

    Returns the box of cells that was touched: first and last row, first and last column, the last ones excluded.
    """
    patch, corner = body
    image, row, column = _blurred(patch, corner, x / scale, y / scale, _less_pixels(covariance, scale), weight)
    box = row * scale, (row + image.shape[0]) * scale, column * scale, (column + image.shape[1]) * scale
    if scale == 1:
        _add(shown, image, row, column)
    else:
        _add_enlarged(shown, image, box, scale)
    return box


@numba.njit(error_model="numpy", fastmath=True)
def _add(shown, image, row, column):  # type: ignore[no-untyped-def]
    """Add to `shown` (M, M) the `image` (A, B), whose corner is at this row and column."""
    size = len(shown)
    for i in _inside(row, row + image.shape[0], size):
        for j in _inside(column, column + image.shape[1], size):
            shown[i, j] += image[i - U(row), j - U(column)]


@numba.njit(error_model="numpy", fastmath=True)
def _add_enlarged(shown, image, box, scale):  # type: ignore[no-untyped-def]
    """Add to `shown` (M, M) the `image` (A, B), whose pixels are of `scale` cells and cover the `box`."""
    size = len(shown)
    wide = np.empty((image.shape[0], size), np.float32)
    for j in _inside(box[2], box[3], size):
        x, aside = _pixel(j - U(box[2]), scale, image.shape[1])
        beside = min(x + U(1), U(image.shape[1] - 1))
        for i in range(U(len(image))):
            wide[i, j] = image[i, x] + (image[i, beside] - image[i, x]) * aside
    for i in _inside(box[0], box[1], size):
        y, up = _pixel(i - U(box[0]), scale, len(image))
        above = min(y + U(1), U(len(image) - 1))
        for j in _inside(box[2], box[3], size):
            shown[i, j] += wide[y, j] + (wide[above, j] - wide[y, j]) * up


@numba.njit(error_model="numpy")
def _less_pixels(covariance, scale):  # type: ignore[no-untyped-def]
    """The covariance in pixels, less what interpolation between them adds."""
    xx, xy, yy = covariance
    pixel, less = 1.0 / (scale * scale), 1.0 / 6.0 if scale > 1 else 0.0
    return xx * pixel - less, xy * pixel, yy * pixel - less


@numba.njit(error_model="numpy")
def _pixel(cell, scale, count):  # type: ignore[no-untyped-def]
    """The pixel of `count` whose centre lies at or before that of a cell, and how far its is towards the next."""
    place = min(max((cell + 0.5) / scale - 0.5, 0.0), count - 1.0)
    return U(place), np.float32(place - math.floor(place))


@numba.njit(error_model="numpy", fastmath=True)
def _blurred(patch, corner, x, y, covariance, weight):  # type: ignore[no-untyped-def]
    """The patch (A, B) about x, y, blurred, times `weight`: an image, and the row and column of its corner; in pixels.

    The blur is one along x and then one along y, in which the rows shift sideways as the `covariance` says.
    """
    xx, xy, yy = covariance
    var_x, var_y = max(xx, SHARPEST**2), max(yy, SHARPEST**2)
    slope = xy / var_y
    first_row, rows = _blur_window(y, math.sqrt(var_y))
    first_column, columns = _blur_window(x, math.sqrt(max(var_x - slope * slope * var_y, SHARPEST**2)))
    along = _blur_rows(patch, columns)
    most = abs(slope) * len(rows)
    margin = 0 if most < LEAST_SHIFT else math.ceil(most) + 1
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
    """Full convolution of every row of `image` (A, B) with `kernel` (W,), a zero before and after: (A, B + W + 1)."""
    out = np.zeros((image.shape[0], image.shape[1] + kernel.size + 1), np.float32)
    for row in range(image.shape[0]):
        for column in range(image.shape[1]):
            value = image[row, column]
            if value != 0.0:
                k, first = U(row), U(column + 1)
                for i in range(U(kernel.size)):
                    out[k, first + i] += value * kernel[i]
    return out


@numba.njit(error_model="numpy")
def _points(places, blur, size):  # type: ignore[no-untyped-def]
    """Corner (K, 2) and mass (K, W, W) of each of `places` (K, 2), x and y, blurred by `blur`; and the box of all."""
    width = int(2.0 * WINDOW_SIGMAS * max(blur, SHARPEST)) + 2
    corners, masses = np.empty((len(places), 2), np.int64), np.zeros((len(places), width, width), np.float32)
    box = size, 0, size, 0
    for k in range(len(places)):
        first_row, rows = _blur_window(places[k, 1], blur)
        first_column, columns = _blur_window(places[k, 0], blur)
        corners[k, 0], corners[k, 1] = first_row, first_column
        for i in range(len(rows)):
            for j in range(len(columns)):
                masses[k, i, j] = rows[i] * columns[j]
        box = _grown(box, (first_row, first_row + width, first_column, first_column + width))
    return corners, masses, box


@numba.njit(error_model="numpy", fastmath=True)
def _draw_points(shown, corners, masses, weights, step):  # type: ignore[no-untyped-def]
    """Add to `shown` (M, M) the `masses` (K, W, W) at their `corners` (K, 2), times `weights` (K, n+1) at a step."""
    size, width = shown.shape[0], masses.shape[1]
    for k in range(len(corners)):
        row, column, weight = corners[k, 0], corners[k, 1], weights[k, step]
        for i in range(max(0, -row), min(width, size - row)):
            for j in range(max(0, -column), min(width, size - column)):
                shown[row + i, column + j] += masses[k, i, j] * weight


@numba.njit(error_model="numpy")
def _grown(box, other):  # type: ignore[no-untyped-def]
    """The box about two boxes."""
    return min(box[0], other[0]), max(box[1], other[1]), min(box[2], other[2]), max(box[3], other[3])


@numba.njit(error_model="numpy", fastmath=True)
def _blur_window(centre, deviation):  # type: ignore[no-untyped-def]
    """First cell and mass of each cell under a Gaussian along one axis, about `centre`, in cells."""
    sigma = max(deviation, SHARPEST)
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
    """The error function, to 3e-7, without a branch or an exponential (Abramowitz and Stegun 1964, 7.1.28)."""
    y = abs(x)
    a, b, c, d, e, f = ERF
    power = np.float32(1.0) + y * (a + y * (b + y * (c + y * (d + y * (e + y * f)))))
    for _ in range(4):
        power *= power
    return math.copysign(np.float32(1.0) - np.float32(1.0) / power, x)

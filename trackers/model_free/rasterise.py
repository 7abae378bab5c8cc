"""Rasterising: a body about an uncertain pose as probabilities of cells, step by step, in the window it can be in."""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

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
            pose, covariance, weight = poses[r, step], covariances[r, step], moved[r, step]
            if weight * _densest(mass, covariance) < NEGLIGIBLE:
                continue
            scale = _scale(covariance)
            if scale != scales[r] or abs(pose[2] - headings[r]) > SAME_HEADING:
                scales[r], headings[r] = scale, pose[2]
                patches[r] = _patch(offsets, weights, pose[2], scale)
            box = _grown(box, _draw_blurred(shown, patches[r], pose, covariance, weight, scale))
        for k in range(len(places)):
            _draw_point(shown, corners[k], masses[k], still[k, step])
        box = _grown(box, still_box)
        exists = np.float32(existence[step])
        _share_out(semantics[step], classes, shown, exists, box)
        for row in range(max(box[0], 0), min(box[1], size)):
            target, cause = occupancy[step, row], shown[row]
            for column in range(max(box[2], 0), min(box[3], size)):
                target[column] += (np.float32(1.0) - target[column]) * exists * min(cause[column], np.float32(1.0))
                cause[column] = np.float32(0.0)


@numba.njit(error_model="numpy", fastmath=True)
def _share_out(planes, classes, shown, exists, box):  # type: ignore[no-untyped-def]
    """Add to `planes` (C, M, M), by P(class), `classes` (C,), what is `shown` (M, M) within a box, times `exists`."""
    size = shown.shape[0]
    first, last = max(box[2], 0), min(box[3], size)
    if last <= first or not len(classes):
        return
    cause = np.empty(last - first, np.float32)
    for row in range(max(box[0], 0), min(box[1], size)):
        for j in range(len(cause)):
            cause[j] = exists * min(shown[row, first + j], np.float32(1.0))
        for k in range(len(classes)):
            plane, share = planes[k, row, first:last], classes[k]
            for j in range(len(cause)):
                plane[j] += share * cause[j]


@numba.njit(error_model="numpy")
def _densest(mass, covariance):  # type: ignore[no-untyped-def]
    """No cell is more probable than this where points of so much `mass` together are blurred by a `covariance`."""
    spread = covariance[0, 0] * covariance[1, 1] - covariance[0, 1] ** 2
    return min(1.0, mass / (2.0 * math.pi * math.sqrt(max(spread, 1e-9))))


@numba.njit(error_model="numpy")
def _scale(covariance):  # type: ignore[no-untyped-def]
    """In pixels of how many cells a body so blurred is drawn: as fine as the blur calls for."""
    xx, xy, yy = covariance[0, 0], covariance[0, 1], covariance[1, 1]
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
def _draw_blurred(shown, body, centre, covariance, weight, scale):  # type: ignore[no-untyped-def]
    """Add to `shown` (M, M) a `body`, its patch and corner, about `centre` (x, y, ...), blurred, times `weight`.

    Returns the box of cells that was touched: first and last row, first and last column, the last ones excluded.
    """
    (patch, corner), x, y = body, centre[0] / scale, centre[1] / scale
    image, row, column = _blurred(patch, corner, x, y, _less_pixels(covariance, scale), weight)
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
    first, last = max(0, -column), min(image.shape[1], size - column)
    for i in range(max(0, -row), min(image.shape[0], size - row)):
        target, source = shown[row + i], image[i]
        for j in range(first, last):
            target[column + j] += source[j]


@numba.njit(error_model="numpy", fastmath=True)
def _add_enlarged(shown, image, box, scale):  # type: ignore[no-untyped-def]
    """Add to `shown` (M, M) the `image` (A, B), whose pixels are of `scale` cells and cover the `box`."""
    first_row, last_row, first_column, last_column = box
    first, last = max(0, first_column), min(last_column, len(shown))
    if last <= first:
        return
    wide = np.zeros((image.shape[0], last - first), np.float32)
    for j in range(last - first):
        x, aside = _pixel(first + j - first_column, scale, image.shape[1])
        beside = min(x + 1, image.shape[1] - 1)
        for i in range(len(image)):
            wide[i, j] = image[i, x] + (image[i, beside] - image[i, x]) * aside
    for i in range(max(0, first_row), min(last_row, len(shown))):
        y, up = _pixel(i - first_row, scale, len(image))
        below, above, target = wide[y], wide[min(y + 1, len(image) - 1)], shown[i, first:last]
        for j in range(len(target)):
            target[j] += below[j] + (above[j] - below[j]) * up


@numba.njit(error_model="numpy")
def _less_pixels(covariance, scale):  # type: ignore[no-untyped-def]
    """The covariance (2, 2) in pixels, less what interpolation between them adds."""
    reduced = covariance / (scale * scale)
    if scale > 1:
        reduced[0, 0] -= 1.0 / 6.0
        reduced[1, 1] -= 1.0 / 6.0
    return reduced


@numba.njit(error_model="numpy")
def _pixel(cell, scale, count):  # type: ignore[no-untyped-def]
    """The pixel of `count` whose centre lies at or before that of a cell, and how far its is towards the next."""
    place = min(max((cell + 0.5) / scale - 0.5, 0.0), count - 1.0)
    return int(place), np.float32(place - int(place))


@numba.njit(error_model="numpy", fastmath=True)
def _blurred(patch, corner, x, y, covariance, weight):  # type: ignore[no-untyped-def]
    """The patch (A, B) about x, y, blurred, times `weight`: an image, and the row and column of its corner; in pixels.

    The blur is one along x and then one along y, in which the rows shift sideways as the covariance (2, 2) says.
    """
    var_x, var_y = max(covariance[0, 0], SHARPEST**2), max(covariance[1, 1], SHARPEST**2)
    slope = covariance[0, 1] / var_y
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
            source = along[k]
            target = image[i + k, margin + left : margin + left + width + 1]
            if margin:
                for j in range(len(target)):
                    target[j] += here * source[j + 1] + beside * source[j]
            else:
                for j in range(width):
                    target[j] += share * source[j + 1]
    return image, first_row + corner[0], first_column + corner[1] - margin


@numba.njit(error_model="numpy", fastmath=True)
def _blur_rows(image, kernel):  # type: ignore[no-untyped-def]
    """Full convolution of every row of `image` (A, B) with `kernel` (W,), a zero before and after: (A, B + W + 1)."""
    out = np.zeros((image.shape[0], image.shape[1] + kernel.size + 1), np.float32)
    for row in range(image.shape[0]):
        for column in range(image.shape[1]):
            value = image[row, column]
            if value != 0.0:
                target = out[row, column + 1 : column + 1 + kernel.size]
                for i in range(kernel.size):
                    target[i] += value * kernel[i]
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
def _draw_point(shown, corner, mass, weight):  # type: ignore[no-untyped-def]
    """Add to `shown` (M, M) the `mass` (W, W) at its `corner`, times `weight`."""
    size, row, column = shown.shape[0], corner[0], corner[1]
    for i in range(max(0, -row), min(len(mass), size - row)):
        for j in range(max(0, -column), min(len(mass), size - column)):
            shown[row + i, column + j] += mass[i, j] * np.float32(weight)


@numba.njit(error_model="numpy")
def _grown(box, other):  # type: ignore[no-untyped-def]
    """The box about two boxes."""
    return min(box[0], other[0]), max(box[1], other[1]), min(box[2], other[2]), max(box[3], other[3])


@numba.njit(error_model="numpy")
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

"""Rasterising: the expected occupancy of tracks with uncertain poses, as probabilities of cells at each step."""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from gridtrack.trackers.model_free.arrays import Array
from gridtrack.trackers.model_free.blurring import (
    MIN_BLUR,
    WINDOW_SIGMAS,
    blur_window,
    boundary_patch,
    draw_blurred,
    pixel_size,
    range_inside,
)

NEGLIGIBLE = 0.01
"""A motion that makes no cell more probable than this is not drawn."""
SAME_HEADING = 0.02
"""A body that has turned by less, radians, keeps its patch."""


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
    at `points` (K, 2), of probability `in_place` (K, n+1), blurred by `blur`. A position whose standard deviation is
    greater than the window's side is not drawn: the object is more probably outside, and the image of its blur would
    grow without a bound.

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

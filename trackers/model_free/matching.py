"""Scan matching: the pose at which a track's boundary points meet a cluster, and how well they settle it.

The boundary is a Gaussian mixture, and every return of the cluster is drawn from it or is an outlier; the pose of the
highest likelihood is found by expectation and maximisation, from a wide kernel to a narrow one (EM-ICP: Granger and
Pennec, ECCV 2002), and by Newton's method. The information is the curvature of that likelihood, so that a wall, which
looks the same wherever along it a return lies, says nothing of a motion along itself (the aperture problem).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

WIDEST = 4.0
"""The widest kernel, in surface widths; each is half as wide as the one before."""
ITERATIONS = 1
"""Of expectation and maximisation, with each kernel."""
NEWTON_STEPS = 2
"""Of Newton's method after them: expectation and maximisation creep where few returns say where a body ends."""
CUT = 0.02
"""What a return tells that meets a point at which the boundary is cut off, as a share of what it tells elsewhere."""
OUTLIER = math.exp(-4.5)
"""Likelihood of a return that is not of this boundary: that of one three kernel widths from a certain point."""
FURTHEST = -10.0
"""Exponent below which the kernel is nothing."""
UNKNOWN = (1e4, 1e4, 1e3)
"""Variance of a direction that the returns say nothing of, along x and y (m^2) and of the heading (rad^2)."""


TRUST = 5
"""The last column of what each return is expected of."""


class Match(NamedTuple):
    """A measured pose (3,): x, y, heading; its covariance (3, 3); and the `residual` of the returns.

    The residual is the mean over returns of the squared distance to the boundary in kernel widths, as the mixture sees
    it: 0 where they lie on it, 9 where none does.
    """

    pose: Array
    covariance: Array
    residual: float


def match(
    points: Array,
    offsets: Array,
    weights: Array,
    cut: Mask,
    starts: Array,
    unsure_m: float,
    surface_m: float,
    turns: bool,
) -> Match:
    """Match returns (K, 2) in the grid frame to a boundary `offsets` (N, 2) in the body's frame, `weights` (N,).

    Metres. Where the boundary is `cut` off (N,) it may go on unseen, and a return at such a point hardly tells.
    `surface_m` is the standard deviation of a return about the boundary. The best end of all `starts` (S, 3) is taken,
    each as uncertain as `unsure_m`: from a wide kernel, a body of which more has come into view than its boundary holds
    is drawn towards that; from a narrow one, a start that is far off finds nothing. Without `turns` the heading stays
    as at the start, and its variance is that of the unknown.
    """
    return Match(*_best_match(points, offsets, weights, cut, starts, unsure_m, surface_m, turns))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _best_match(points, offsets, weights, cut, starts, unsure_m, surface_m, turns):  # type: ignore[no-untyped-def]
    """Pose (3,), covariance (3, 3) and residual of the best match from any of the starts (S, 3)."""
    placed, expected = np.empty((2, len(offsets))), np.empty((len(points), 6))
    tells = np.where(cut, CUT, 1.0)
    best, information, residual = starts[0], np.empty((3, 3)), np.inf
    for s in range(len(starts)):
        pose = starts[s].copy()
        kernel = min(max(unsure_m / surface_m, 1.0), WIDEST)
        while kernel > 0.5:
            width = max(kernel, 1.0) * surface_m
            for step in range(ITERATIONS + NEWTON_STEPS):
                _place(offsets, pose, placed)
                _expect(points, placed, weights, tells, width, expected)
                if step < ITERATIONS:
                    _maximise(points, expected, turns, pose)
                else:
                    _newton(points, expected, width, turns, pose)
            kernel *= 0.5
        _place(offsets, pose, placed)
        misfit = _expect(points, placed, weights, tells, surface_m, expected)
        if misfit < residual:
            best, residual = pose, misfit
            information = _information(expected, pose, surface_m, turns)
    return best, _inverse(information), residual


@numba.njit(error_model="numpy")
def _place(offsets, pose, placed):  # type: ignore[no-untyped-def]
    """Write where `offsets` (N, 2) lie at `pose` (3,) into `placed` (2, N)."""
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    for j in range(len(offsets)):
        placed[0, j] = pose[0] + cosine * offsets[j, 0] - sine * offsets[j, 1]
        placed[1, j] = pose[1] + sine * offsets[j, 0] + cosine * offsets[j, 1]


@numba.njit(error_model="numpy", fastmath=True)
def _expect(points, placed, weights, tells, width, expected):  # type: ignore[no-untyped-def]
    """Write what each return is expected of into `expected` (K, 6), and return the residual.

    Of the boundary that it may be of the mean x, y and the covariance xx, xy, yy; then its TRUST, how far it tells: the
    probability that it is of this boundary, times how far that `tells` (N,).
    """
    scale = -0.5 / (width * width)
    misfit = 0.0
    for i in range(len(points)):
        total = telling = x = y = xx = xy = yy = 0.0
        for j in range(placed.shape[1]):
            dx, dy = placed[0, j] - points[i, 0], placed[1, j] - points[i, 1]
            share = weights[j] * _exp(scale * (dx * dx + dy * dy))
            sx, sy = share * dx, share * dy
            total += share
            x += sx
            y += sy
            xx += sx * dx
            xy += sx * dy
            yy += sy * dy
            telling += share * tells[j]
        each = expected[i]
        if total > 0.0:
            x, y = x / total, y / total
            xx, xy, yy = xx / total - x * x, xy / total - x * y, yy / total - y * y
        each[0], each[1] = points[i, 0] + x, points[i, 1] + y
        each[2], each[3], each[4] = xx, xy, yy
        each[TRUST] = telling / (total + OUTLIER)
        misfit -= 2.0 * math.log(min(total + OUTLIER, 1.0))
    return misfit / len(points)


@numba.njit(error_model="numpy", fastmath=True)
def _exp(x):  # type: ignore[no-untyped-def]
    """Exponential of `x` <= 0, to 1e-3 of itself where that is above exp(FURTHEST), and 0 beyond; it vectorises."""
    y = max(x, FURTHEST) / 16.0
    y = 1.0 + y * (1.0 + y * (0.5 + y * (1.0 / 6.0 + y * (1.0 / 24.0 + y / 120.0))))
    y *= y
    y *= y
    y *= y
    y *= y
    return y if x > FURTHEST else 0.0


@numba.njit(error_model="numpy")
def _maximise(points, expected, turns, pose):  # type: ignore[no-untyped-def]
    """Move `pose` (3,) so that the expected boundary falls on the returns: least squares by trust."""
    total = px = py = mx = my = 0.0
    for i in range(len(points)):
        trust = expected[i, TRUST]
        total += trust
        px, py = px + trust * points[i, 0], py + trust * points[i, 1]
        mx, my = mx + trust * expected[i, 0], my + trust * expected[i, 1]
    if total < 1e-6:
        return
    px, py, mx, my = px / total, py / total, mx / total, my / total
    turn = 0.0
    if turns:
        dot = cross = 0.0
        for i in range(len(points)):
            ax, ay = expected[i, 0] - mx, expected[i, 1] - my
            bx, by = points[i, 0] - px, points[i, 1] - py
            dot += expected[i, TRUST] * (ax * bx + ay * by)
            cross += expected[i, TRUST] * (ax * by - ay * bx)
        turn = math.atan2(cross, dot) if dot > 0.0 else 0.0
    cosine, sine = math.cos(turn), math.sin(turn)
    ox, oy = pose[0] - mx, pose[1] - my
    pose[0], pose[1] = px + cosine * ox - sine * oy, py + sine * ox + cosine * oy
    pose[2] += turn


@numba.njit(error_model="numpy")
def _newton(points, expected, width, turns, pose):  # type: ignore[no-untyped-def]
    """Move `pose` (3,) by one step of Newton's method, no further than the kernel's `width`."""
    gradient = np.zeros(3)
    for i in range(len(points)):
        x, y = expected[i, 0], expected[i, 1]
        scale = expected[i, TRUST] / (width * width)
        rx, ry = points[i, 0] - x, points[i, 1] - y
        gradient[0] += scale * rx
        gradient[1] += scale * ry
        if turns:
            gradient[2] += scale * ((x - pose[0]) * ry - (y - pose[1]) * rx)
    step = _inverse(_information(expected, pose, width, turns)) @ gradient
    pose += step * min(1.0, width / max(math.hypot(step[0], step[1]), 1e-9))


@numba.njit(error_model="numpy")
def _information(expected, pose, width, turns):  # type: ignore[no-untyped-def]
    """Curvature (3, 3) of minus the log likelihood at `pose` (3,), never negative, and what is known of the unknown."""
    total = np.zeros((3, 3))
    for axis in range(3):
        total[axis, axis] = 1.0 / UNKNOWN[axis]
    scale = 1.0 / (width * width)
    for i in range(len(expected)):
        x, y, xx, xy, yy, trust = expected[i]
        xx, xy, yy = _not_negative(scale * (1.0 - scale * xx), -scale * scale * xy, scale * (1.0 - scale * yy))
        dx, dy = x - pose[0], y - pose[1]
        total[0, 0] += trust * xx
        total[1, 1] += trust * yy
        total[0, 1] += trust * xy
        if turns:
            total[0, 2] += trust * (xy * dx - xx * dy)
            total[1, 2] += trust * (yy * dx - xy * dy)
            total[2, 2] += trust * (xx * dy * dy - 2.0 * xy * dx * dy + yy * dx * dx)
    total[1, 0], total[2, 0], total[2, 1] = total[0, 1], total[0, 2], total[1, 2]
    return total


@numba.njit(error_model="numpy")
def _inverse(a):  # type: ignore[no-untyped-def]
    """Inverse (3, 3) of a symmetric, positive definite matrix: its cofactors by its determinant."""
    inverse = np.empty((3, 3))
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        for m in range(3):
            n, o = (m + 1) % 3, (m + 2) % 3
            inverse[i, m] = a[j, n] * a[k, o] - a[j, o] * a[k, n]
    return inverse / (a[0, 0] * inverse[0, 0] + a[0, 1] * inverse[0, 1] + a[0, 2] * inverse[0, 2])


@numba.njit(error_model="numpy")
def _not_negative(xx, xy, yy):  # type: ignore[no-untyped-def]
    """The symmetric matrix xx, xy, yy with its negative eigenvalues set to zero."""
    middle, half = 0.5 * (xx + yy), math.hypot(0.5 * (xx - yy), xy)
    high, low = max(middle + half, 0.0), max(middle - half, 0.0)
    if half < 1e-12:
        return high, 0.0, high
    cosine, sine = 0.5 * (xx - yy) / half, xy / half  # of twice the angle of the first axis
    mean, difference = 0.5 * (high + low), 0.5 * (high - low)
    return mean + difference * cosine, difference * sine, mean - difference * cosine

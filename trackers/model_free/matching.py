"""Scan matching: the pose at which a track's boundary points meet a cluster, and how well they settle it.

The boundary is a Gaussian mixture, and every return of the cluster is drawn from it or is an outlier; and the other way
round for each boundary point that is in view, for where nothing is returned nothing is. The pose of the highest
likelihood is found by Newton's method, from a wide kernel to a narrow one (EM-ICP: Granger and Pennec, ECCV 2002).

What a pair tells of a motion in some direction is decided by the outline there, and not by the point: where it goes on
in that direction, nothing (generalised ICP: Segal, Haehnel and Thrun, RSS 2009; the aperture problem). The points
themselves lie in the middle of cells, and a side that glides past the grid would be held by it.
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
NEWTON_STEPS = 3
"""With each kernel."""
GOES_ON = 3.0
"""Where an outline goes on for so many surface widths either way, it tells nothing of a motion along itself."""
CUT = 0.02
"""What a point tells at which its outline is cut off, as a share of what it tells elsewhere."""
BACK = 2.0
"""What a boundary point without a return tells, against a return without a boundary point."""
OUTLIER = math.exp(-4.5)
"""Likelihood of a point that is not of the other outline: that of one three kernel widths from a certain point."""
FURTHEST = -10.0
"""Exponent below which the kernel is nothing."""
UNKNOWN = (1e4, 1e4, 1e3)
"""Variance of a direction that the returns say nothing of, along x and y (m^2) and of the heading (rad^2)."""


class Outline(NamedTuple):
    """Points (N, 2) in metres, how likely each is to be there (N,), and at which the outline is cut off (N,)."""

    points: Array
    weights: Array
    cut: Mask


class Match(NamedTuple):
    """A measured pose (3,): x, y, heading; its covariance (3, 3); and the `residual` of the returns.

    The residual is the mean over returns of the squared distance to the boundary in kernel widths, as the mixture sees
    it: 0 where they lie on it, 9 where none does.
    """

    pose: Array
    covariance: Array
    residual: float


def match(
    returns: Outline, boundary: Outline, seen: Mask, starts: Array, unsure_m: float, surface_m: float, turns: bool
) -> Match:
    """Match returns in the grid frame to a boundary in the body's frame, of which the points `seen` (N,) are in view.

    Where either is cut off it may go on unseen, and that end hardly tells. `surface_m` is the standard deviation of a
    return about the boundary. The best end of all `starts` (S, 3) is taken, each as uncertain as `unsure_m`, in metres:
    from a wide kernel, a body of which more has come into view than its boundary holds is drawn towards that; from a
    narrow one, a start that is far off finds nothing. Without `turns` the heading stays as at the start, and its
    variance is that of the unknown.
    """
    return Match(*_best_match(returns, boundary, seen, starts, unsure_m, surface_m, turns))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _best_match(returns, boundary, seen, starts, unsure_m, surface_m, turns):  # type: ignore[no-untyped-def]
    """Pose (3,), covariance (3, 3) and residual of the best match from any of the starts (S, 3)."""
    points, placed = np.ascontiguousarray(returns.points.T), np.empty((2, len(boundary.points)))
    _place(boundary.points, starts[0], placed)
    told = _telling(placed, boundary.weights, boundary.cut, GOES_ON * surface_m)
    telling = _telling(points, returns.weights, returns.cut, GOES_ON * surface_m)
    back = np.where(seen, BACK * boundary.weights, 0.0)
    met, meets = np.empty((points.shape[1], 6)), np.empty((placed.shape[1], 6))
    widths = _widths(unsure_m, surface_m)
    best, covariance, residual = starts[0], np.empty((3, 3)), np.inf
    for s in range(len(starts)):
        pose = starts[s].copy()
        for n in range(len(widths)):
            _place(boundary.points, pose, placed)
            _expect(points, returns.weights, placed, boundary.weights, told, widths[n], met)
            _expect(placed, back, points, returns.weights, telling, widths[n], meets)
            gradient, information = _curvature(points, met, placed, meets, pose, widths[n], turns)
            inverse = _inverse(information)
            if n < len(widths) - 1:
                step = inverse @ gradient
                pose += step * min(1.0, widths[n] / max(math.hypot(step[0], step[1]), 1e-9))
        misfit = -2.0 * np.log(np.minimum(met[:, 5], 1.0)).mean()
        if misfit < residual:
            best, covariance, residual = pose, inverse, misfit
    return best, covariance, residual


@numba.njit(error_model="numpy")
def _widths(unsure_m, surface_m):  # type: ignore[no-untyped-def]
    """The kernel's width, metres, at each step of Newton's method, and at last, where no step follows: (n+1,)."""
    kernel = min(max(unsure_m / surface_m, 1.0), WIDEST)
    kernels = 1 + math.ceil(math.log2(kernel))
    widths = np.full(kernels * NEWTON_STEPS + 1, surface_m)
    for n in range(kernels - 1):
        widths[n * NEWTON_STEPS : (n + 1) * NEWTON_STEPS] = surface_m * max(kernel / 2.0**n, 1.0)
    return widths


@numba.njit(error_model="numpy")
def _place(offsets, pose, placed):  # type: ignore[no-untyped-def]
    """Write where `offsets` (N, 2) lie at `pose` (3,) into `placed` (2, N)."""
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    for j in range(len(offsets)):
        placed[0, j] = pose[0] + cosine * offsets[j, 0] - sine * offsets[j, 1]
        placed[1, j] = pose[1] + sine * offsets[j, 0] + cosine * offsets[j, 1]


@numba.njit(error_model="numpy", fastmath=True)
def _telling(points, weights, cut, reach):  # type: ignore[no-untyped-def]
    """What each point (2, N) of an outline tells of a motion in each direction: matrices xx, xy, yy (3, N).

    One less the variance of the outline about it, in `reach` squared: 0 along a line that goes on, 1 across it, and
    next to 1 for what is small or ends there; hardly anything where the outline is cut off.
    """
    tells = np.empty((3, points.shape[1]))
    scale = 1.0 / (reach * reach)
    for i in range(points.shape[1]):
        total = x = y = xx = xy = yy = 0.0
        for j in range(points.shape[1]):
            dx, dy = points[0, j] - points[0, i], points[1, j] - points[1, i]
            share = weights[j] * _exp(-0.5 * scale * (dx * dx + dy * dy))
            total += share
            x += share * dx
            y += share * dy
            xx += share * dx * dx
            xy += share * dx * dy
            yy += share * dy * dy
        x, y = x / total, y / total
        xx, xy, yy = xx / total - x * x, xy / total - x * y, yy / total - y * y
        xx, xy, yy = _not_negative(1.0 - scale * xx, -scale * xy, 1.0 - scale * yy)
        share = CUT if cut[i] else 1.0
        tells[0, i], tells[1, i], tells[2, i] = share * xx, share * xy, share * yy
    return tells


@numba.njit(error_model="numpy", fastmath=True)
def _expect(points, trust, others, weights, tells, width, expected):  # type: ignore[no-untyped-def]
    """Write where each of `points` (2, K) is expected to be of the outline `others` (2, N) into `expected` (K, 6).

    How far from it along x and y, and what that tells, xx, xy, yy: what those points tell, `tells` (3, N), times the
    probability that it is of this outline, times `trust` (K,). At last its likelihood.
    """
    scale = -0.5 / (width * width)
    for i in range(points.shape[1]):
        total = x = y = xx = xy = yy = 0.0
        if trust[i] > 0.0:
            for j in range(others.shape[1]):
                dx, dy = others[0, j] - points[0, i], others[1, j] - points[1, i]
                share = weights[j] * _exp(scale * (dx * dx + dy * dy))
                total += share
                x += share * dx
                y += share * dy
                xx += share * tells[0, j]
                xy += share * tells[1, j]
                yy += share * tells[2, j]
        some, mixed = max(total, 1e-300), total + OUTLIER
        share = trust[i] / mixed
        each = expected[i]
        each[0], each[1], each[2], each[3], each[4] = x / some, y / some, share * xx, share * xy, share * yy
        each[5] = mixed


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
def _curvature(points, met, placed, meets, pose, width, turns):  # type: ignore[no-untyped-def]
    """Gradient (3,) of the log likelihood at `pose` (3,), and its negative curvature (3, 3), with the unknown's.

    Of the returns `points` (2, K), which expect the boundary to be `met` (K, 6), and of the boundary points `placed`
    (2, N), which expect returns where they are `meets` (N, 6).
    """
    gradient, total = np.zeros(3), np.zeros((3, 3))
    for i in range(points.shape[1]):
        dx, dy = met[i, 0], met[i, 1]
        x, y = points[0, i] + dx - pose[0], points[1, i] + dy - pose[1]
        _add_pair(x, y, -dx, -dy, met[i, 2:5], turns, gradient, total)
    for j in range(placed.shape[1]):
        x, y = placed[0, j] - pose[0], placed[1, j] - pose[1]
        _add_pair(x, y, meets[j, 0], meets[j, 1], meets[j, 2:5], turns, gradient, total)
    gradient /= width * width
    total /= width * width
    total[1, 0], total[2, 0], total[2, 1] = total[0, 1], total[0, 2], total[1, 2]
    for axis in range(3):
        total[axis, axis] += 1.0 / UNKNOWN[axis]
    return gradient, total


@numba.njit(error_model="numpy")
def _add_pair(x, y, rx, ry, tells, turns, gradient, total):  # type: ignore[no-untyped-def]
    """Add to `gradient` (3,) and the upper half of `total` (3, 3) a boundary point at x, y from the body's position.

    It belongs by rx, ry further on, which is told in the directions of the matrix `tells` (3,).
    """
    xx, xy, yy = tells
    fx, fy = xx * rx + xy * ry, xy * rx + yy * ry
    gradient[0] += fx
    gradient[1] += fy
    total[0, 0] += xx
    total[0, 1] += xy
    total[1, 1] += yy
    if turns:
        gradient[2] += x * fy - y * fx
        total[0, 2] += xy * x - xx * y
        total[1, 2] += yy * x - xy * y
        total[2, 2] += xx * y * y - 2.0 * xy * x * y + yy * x * x


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

"""Scan matching: the pose at which the boundary of a track fits a cluster of returns, and its covariance.

The boundary is a Gaussian mixture, and each return of the cluster is drawn from it or is an outlier; conversely, each
boundary point in view is drawn from the returns, because cells in view without a return are empty. The pose of maximum
likelihood is found by Newton's method, from a wide kernel to a narrow one (EM-ICP: Granger and Pennec, ECCV 2002).

The information of a pair of points about a motion in some direction depends on the outline around them: where the
outline continues in that direction, there is none (generalised ICP: Segal, Haehnel and Thrun, RSS 2009; the aperture
problem). The points themselves are cell centres, so that a side that slides along the grid would appear fixed to it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import Mask
from gridtrack.trackers.model_free.arrays import Array, bounds_of

WIDEST = 4.0
"""The widest kernel, in surface widths; each further kernel has half the width."""
NEWTON_STEPS = 3
"""Newton steps with each kernel."""
CONTINUES = 3.0
"""An outline that continues for this many surface widths both ways says nothing about a motion along itself."""
CUT, CUT_REACH = 0.02, 2.0
"""Information along an outline at a cut-off end, relative to a real end; and the distance over which it is reduced, in
multiples of CONTINUES."""
BACK = 2.0
"""Weight of a boundary point without a return, relative to a return without a boundary point."""
OUTLIER = math.exp(-4.5)
"""Likelihood of an outlier: the same as three kernel widths from a point of weight 1."""
MIN_EXPONENT = np.float32(-10.0)
"""Exponent below which the kernel is 0."""
MIN_LIKELIHOOD = np.float32(1e-30)
"""Smallest divisor in place of a likelihood of 0."""
ZERO, ONE, SIXTEENTH = np.float32(0.0), np.float32(1.0), np.float32(1.0 / 16.0)
SERIES = tuple(np.float32(1.0 / math.factorial(n)) for n in (2, 3, 4, 5))
"""Single precision: the sums over all pairs of points take a third of the time."""
NO_POINT = 1e12
"""Squared distance if there is no point, m^2."""
UNKNOWN = (1e4, 1e4, 1e3)
"""Variance of an unobserved direction: x and y (m^2) and heading (rad^2)."""


class Outlines(NamedTuple):
    """G concatenated outlines: points (N, 2), metres, their weights (N,), and where each outline is cut off (N,).

    The points of outline g are those from `bounds` (G+1,) [g] to [g+1]; a weight is the probability of a return there.
    """

    points: Array
    weights: Array
    cut: Mask
    bounds: NDArray[np.int64]

    @classmethod
    def of(cls, points: Sequence[Array], weights: Sequence[Array] | None, cut: Sequence[Mask]) -> Outlines:
        """The outlines, at least one, from points (N, 2), weights (N,), by default 1, and cut-off ends (N,) of each."""
        bounds = bounds_of(points)
        all_weights = np.ones(bounds[-1]) if weights is None else np.concatenate(weights)
        return cls(np.concatenate(points), all_weights, np.concatenate(cut), bounds)


class Match(NamedTuple):
    """A measured pose (3,): x, y, heading; its covariance (3, 3); and the `residual` of the returns.

    The residual is -2 times the mean log likelihood of the returns under the mixture, comparable to a squared distance
    in kernel widths: 0 if all lie on the boundary, 9 if none does.
    """

    pose: Array
    covariance: Array
    residual: float


class Matches(NamedTuple):
    """The matches of P pairs: `poses` (P, 3), `covariances` (P, 3, 3) and `residuals` (P,).

    `freedom` (P,): degrees of freedom, 3, or 2 if the heading is not observable: the heading of the start is kept.
    """

    poses: Array
    covariances: Array
    residuals: Array
    freedom: NDArray[np.int64]

    def of(self, pair: int) -> Match:
        """The match of one pair."""
        return Match(self.poses[pair], self.covariances[pair], float(self.residuals[pair]))


class Pairs(NamedTuple):
    """P pairs to match: `numbers` (P, 2) of the boundary and of the outline of returns, and `starts` (P, S, 3).

    A start is x, y and heading, ignored if not finite; `start_error_m` (P,) is its standard deviation in metres.
    Cut-off ends are considered only in pairs that are `extended` (P,): the hidden continuation of a small body is
    short. The heading is observable in pairs that are `oriented` (P,).
    """

    numbers: NDArray[np.int64]
    starts: Array
    start_error_m: Array
    extended: Mask
    oriented: Mask


def match(boundaries: Outlines, seen: Mask, returns: Outlines, pairs: Pairs, surface_noise_m: float) -> Matches:
    """Match boundaries, in body frames, to returns, in the fixed frame; the boundary points `seen` (N,) are in view.

    `surface_noise_m` is the standard deviation of a return about the boundary. Of the optima reached from all starts
    the best is returned: a wide kernel biases the pose towards parts of a body that its boundary does not contain yet;
    a narrow kernel does not converge from a distant start. A pair that is not oriented keeps the heading of the start,
    with the variance UNKNOWN.
    """
    pairs = pairs._replace(numbers=np.ascontiguousarray(pairs.numbers))
    poses, covariances, residuals = _match(boundaries, seen, returns, pairs, surface_noise_m)
    return Matches(poses, covariances, residuals, np.where(pairs.oriented, 3, 2))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _match(boundaries, seen, returns, pairs, surface_noise_m):  # type: ignore[no-untyped-def]
    """Poses (P, 3), covariances (P, 3, 3) and residuals (P,); see `match`."""
    count = len(pairs.numbers)
    poses, covariances, residuals = np.empty((count, 3)), np.empty((count, 3, 3)), np.empty(count)
    for p in range(count):
        b, r = pairs.numbers[p]
        own = slice(boundaries.bounds[b], boundaries.bounds[b + 1])
        theirs = slice(returns.bounds[r], returns.bounds[r + 1])
        poses[p], covariances[p], residuals[p] = _best_match(
            (boundaries.points[own], boundaries.weights[own], boundaries.cut[own] & pairs.extended[p]),
            seen[own],
            (returns.points[theirs], returns.weights[theirs], returns.cut[theirs] & pairs.extended[p]),
            pairs.starts[p],
            _widths(pairs.start_error_m[p], surface_noise_m),
            surface_noise_m,
            pairs.oriented[p],
        )
    return poses, covariances, residuals


@numba.njit(error_model="numpy")
def _best_match(boundary, seen, returns, starts, widths, surface_noise_m, oriented):  # type: ignore[no-untyped-def]
    """Pose (3,), covariance (3, 3) and residual of the best match of one pair from any of the starts (S, 3)."""
    (offsets, weights, cut), (positions, trust, returns_cut) = boundary, returns
    points, placed = np.empty((2, len(positions)), np.float32), np.empty((2, len(offsets)), np.float32)
    return_weights, boundary_weights = trust.astype(np.float32), weights.astype(np.float32)
    back = np.where(seen, BACK * weights, 0.0).astype(np.float32)
    at_returns, at_boundary = np.empty((6, len(positions)), np.float32), np.empty((6, len(offsets)), np.float32)
    _place(positions, -starts[0, 0], -starts[0, 1], 0.0, points)
    _place(offsets, 0.0, 0.0, starts[0, 2], placed)
    of_returns = _information(points, return_weights, returns_cut, CONTINUES * surface_noise_m)
    of_boundary = _information(placed, boundary_weights, cut, CONTINUES * surface_noise_m)
    best, covariance, residual = starts[0], np.empty((3, 3)), np.inf
    for start in starts[np.isfinite(starts[:, 0])]:
        moved = np.array([0.0, 0.0, start[2]])  # relative to the start, for single precision
        _place(positions, -start[0], -start[1], 0.0, points)
        for n in range(len(widths)):
            _place(offsets, moved[0], moved[1], moved[2], placed)
            _expectation(points, return_weights, placed, boundary_weights, of_boundary, widths[n], at_returns)
            _expectation(placed, back, points, return_weights, of_returns, widths[n], at_boundary)
            gradient, information = _derivatives(points, at_returns, placed, at_boundary, moved, widths[n], oriented)
            inverse = _covariance(information)
            if n < len(widths) - 1:
                step = inverse @ gradient
                moved += step * min(1.0, widths[n] / max(math.hypot(step[0], step[1]), 1e-9))
        misfit = -2.0 * np.log(np.minimum(at_returns[5], ONE)).mean()
        if misfit < residual:
            moved[:2] += start[:2]
            best, covariance, residual = moved, inverse, misfit
    return best, covariance, residual


@numba.njit(error_model="numpy")
def _widths(start_error_m, surface_noise_m):  # type: ignore[no-untyped-def]
    """Kernel width, metres, of each Newton step and of the final evaluation (n+1,)."""
    kernel = min(max(start_error_m / surface_noise_m, 1.0), WIDEST)
    kernels = 1 + math.ceil(math.log2(kernel))
    widths = np.full(kernels * NEWTON_STEPS + 1, surface_noise_m)
    for n in range(kernels - 1):
        widths[n * NEWTON_STEPS : (n + 1) * NEWTON_STEPS] = surface_noise_m * max(kernel / 2.0**n, 1.0)
    return widths


@numba.njit(error_model="numpy")
def _place(points, x, y, turn, placed):  # type: ignore[no-untyped-def]
    """Write `points` (N, 2), rotated by `turn` and then moved by x, y, into `placed` (2, N), in single precision."""
    cosine, sine = math.cos(turn), math.sin(turn)
    for j in range(len(points)):
        placed[0, j] = x + cosine * points[j, 0] - sine * points[j, 1]
        placed[1, j] = y + sine * points[j, 0] + cosine * points[j, 1]


@numba.njit(error_model="numpy", fastmath=True)
def _information(points, weights, cut, reach):  # type: ignore[no-untyped-def]
    """Information of each point (2, N) of an outline about a motion in each direction: matrices xx, xy, yy (3, N).

    Identity minus the covariance of the outline around the point, in units of `reach` squared: 0 along a line that
    continues, 1 across it, nearly 1 for small outlines and at ends; reduced along the outline where it is cut off.
    """
    information = np.empty((3, points.shape[1]), np.float32)
    scale, about, nearby = 1.0 / (reach * reach), _exponent(reach), _exponent(CUT_REACH * reach)
    ends = points[:, cut]
    for i in range(points.shape[1]):
        total = x = y = xx = xy = yy = ZERO
        for j in range(points.shape[1]):
            dx, dy = points[0, j] - points[0, i], points[1, j] - points[1, i]
            share = weights[j] * _exp(about * (dx * dx + dy * dy))
            total += share
            x += share * dx
            y += share * dy
            xx += share * dx * dx
            xy += share * dx * dy
            yy += share * dy * dy
        x, y = x / total, y / total
        xx, xy, yy = xx / total - x * x, xy / total - x * y, yy / total - y * y
        along = 1.0 - (1.0 - CUT) * _exp(nearby * _squared_distance(points[0, i], points[1, i], ends))
        information[0, i], information[1, i], information[2, i] = _scale_along(
            1.0 - scale * xx, -scale * xy, 1.0 - scale * yy, along
        )
    return information


@numba.njit(error_model="numpy")
def _squared_distance(x, y, points):  # type: ignore[no-untyped-def]
    """From x, y to the nearest of `points` (2, N); NO_POINT if there are none."""
    nearest = NO_POINT
    for j in range(points.shape[1]):
        dx, dy = points[0, j] - x, points[1, j] - y
        nearest = min(nearest, dx * dx + dy * dy)
    return nearest


@numba.njit(error_model="numpy", fastmath=True)
def _expectation(points, trust, others, weights, information, width, expected):  # type: ignore[no-untyped-def]
    """Expectation over the outline `others` (2, N) of the partner of each of `points` (2, K), into `expected` (6, K).

    Rows: the vector to the expected partner, x and y; its information xx, xy, yy, which is the mean of `information`
    (3, N) times the probability of an inlier and `trust` (K,); the likelihood of the point.
    """
    scale = _exponent(width)
    for i in range(points.shape[1]):
        total = x = y = xx = xy = yy = ZERO
        if trust[i] > ZERO:
            for j in range(others.shape[1]):
                dx, dy = others[0, j] - points[0, i], others[1, j] - points[1, i]
                share = weights[j] * _exp(scale * (dx * dx + dy * dy))
                total += share
                x += share * dx
                y += share * dy
                xx += share * information[0, j]
                xy += share * information[1, j]
                yy += share * information[2, j]
        divisor, likelihood = max(total, MIN_LIKELIHOOD), total + OUTLIER
        share = trust[i] / likelihood
        expected[0, i], expected[1, i] = x / divisor, y / divisor
        expected[2, i], expected[3, i], expected[4, i] = share * xx, share * xy, share * yy
        expected[5, i] = likelihood


@numba.njit(error_model="numpy")
def _exponent(width):  # type: ignore[no-untyped-def]
    """Factor of the squared distance in the exponent of a kernel of this width."""
    return np.float32(-0.5 / (width * width))


@numba.njit(error_model="numpy", fastmath=True)
def _exp(x):  # type: ignore[no-untyped-def]
    """Exponential of `x` <= 0, relative error 1e-3, and 0 below MIN_EXPONENT; vectorises."""
    y = max(x, MIN_EXPONENT) * SIXTEENTH
    y = ONE + y * (ONE + y * (SERIES[0] + y * (SERIES[1] + y * (SERIES[2] + y * SERIES[3]))))
    y *= y
    y *= y
    y *= y
    y *= y
    return y if x > MIN_EXPONENT else ZERO


@numba.njit(error_model="numpy")
def _derivatives(points, at_returns, placed, at_boundary, pose, width, oriented):  # type: ignore[no-untyped-def]
    """Gradient (3,) of the log likelihood at `pose` (3,), and its negative curvature (3, 3) with the prior UNKNOWN.

    Sum over the returns `points` (2, K), with their expectation on the boundary `at_returns` (6, K), and the boundary
    points `placed` (2, N), with their expectation among the returns `at_boundary` (6, N).
    """
    x, y, turn, xx, xy, yy, x_turn, y_turn, turn_turn = np.add(
        _sum_terms(points, at_returns, ONE, pose), _sum_terms(placed, at_boundary, ZERO, pose)
    ) / (width * width)
    if not oriented:
        turn = x_turn = y_turn = turn_turn = 0.0
    gradient = np.array([x, y, turn])
    total = np.array([[xx, xy, x_turn], [xy, yy, y_turn], [x_turn, y_turn, turn_turn]])
    for axis in range(3):
        total[axis, axis] += 1.0 / UNKNOWN[axis]
    return gradient, total


@numba.njit(error_model="numpy", fastmath=True)
def _sum_terms(points, expected, on_boundary, pose):  # type: ignore[no-untyped-def]
    """Contribution of `points` (2, N) with their expectation `expected` (6, N) to `_derivatives`, for kernel width 1.

    The expected point lies on the boundary for `on_boundary` 1 (`points` are returns); for 0 the point itself does.
    """
    x = y = turn = xx = xy = yy = x_turn = y_turn = turn_turn = ZERO
    pose_x, pose_y, sign = np.float32(pose[0]), np.float32(pose[1]), ONE - on_boundary - on_boundary
    for i in range(points.shape[1]):
        dx, dy, axx, axy, ayy = expected[0, i], expected[1, i], expected[2, i], expected[3, i], expected[4, i]
        bx, by = points[0, i] + on_boundary * dx - pose_x, points[1, i] + on_boundary * dy - pose_y
        fx, fy = sign * (axx * dx + axy * dy), sign * (axy * dx + ayy * dy)
        x += fx
        y += fy
        turn += bx * fy - by * fx
        xx += axx
        xy += axy
        yy += ayy
        x_turn += axy * bx - axx * by
        y_turn += ayy * bx - axy * by
        turn_turn += axx * by * by - (axy + axy) * bx * by + ayy * bx * bx
    return np.array([x, y, turn, xx, xy, yy, x_turn, y_turn, turn_turn])


@numba.njit(error_model="numpy")
def _covariance(information):  # type: ignore[no-untyped-def]
    """Inverse (3, 3) of the result of `_derivatives`: positive definite, about UNKNOWN for directions that were not
    observed.

    In exact arithmetic `information` is at least the prior. If a long body meets the returns in one place only, a
    turn about that place is the small difference of large sums; its rounding error in single precision exceeds the
    prior: the difference to the prior is then added, in the directions that lack it.
    """
    if not _is_below_prior(information):
        return _inverse(information)
    deviations = np.sqrt(np.array(UNKNOWN))
    scales = np.outer(deviations, deviations)  # in these units the prior is the identity
    shares, axes = np.linalg.eigh(information * scales)
    return axes / np.maximum(shares, 1.0) @ axes.T * scales


@numba.njit(error_model="numpy")
def _is_below_prior(a):  # type: ignore[no-untyped-def]
    """Whether the symmetric `a` (3, 3) has less than half the information of the prior UNKNOWN in some direction."""
    xx, yy, zz = a[0, 0] - 0.5 / UNKNOWN[0], a[1, 1] - 0.5 / UNKNOWN[1], a[2, 2] - 0.5 / UNKNOWN[2]
    xy, xz, yz = a[0, 1], a[0, 2], a[1, 2]
    plane = xx * yy - xy * xy
    return xx <= 0.0 or plane <= 0.0 or plane * zz + xz * (xy * yz - yy * xz) - yz * (xx * yz - xy * xz) <= 0.0


@numba.njit(error_model="numpy")
def _inverse(a):  # type: ignore[no-untyped-def]
    """Inverse (3, 3) of a symmetric, positive definite matrix: its cofactors divided by its determinant."""
    inverse = np.empty((3, 3))
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        for m in range(3):
            n, o = (m + 1) % 3, (m + 2) % 3
            inverse[i, m] = a[j, n] * a[k, o] - a[j, o] * a[k, n]
    return inverse / (a[0, 0] * inverse[0, 0] + a[0, 1] * inverse[0, 1] + a[0, 2] * inverse[0, 2])


@numba.njit(error_model="numpy")
def _scale_along(xx, xy, yy, share):  # type: ignore[no-untyped-def]
    """The symmetric matrix xx, xy, yy with its lower eigenvalue times `share`, and no negative eigenvalue."""
    middle, half = 0.5 * (xx + yy), math.hypot(0.5 * (xx - yy), xy)
    high, low = max(middle + half, 0.0), share * max(middle - half, 0.0)
    if half < 1e-12:
        return low, 0.0, low
    cosine, sine = 0.5 * (xx - yy) / half, xy / half  # of twice the angle of the first axis
    mean, difference = 0.5 * (high + low), 0.5 * (high - low)
    return mean + difference * cosine, difference * sine, mean - difference * cosine

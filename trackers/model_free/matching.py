"""Scan matching: the pose at which the boundary of a track fits a cluster of returns, and its covariance.

The boundary is a Gaussian mixture, and each return of the cluster is drawn from it or is an outlier; conversely, each
boundary point in view is drawn from the returns, because cells in view without a return are empty. The pose of maximum
likelihood is found by Newton's method, from a wide kernel to a narrow one (EM-ICP: Granger and Pennec, ECCV 2002).

A pair of points has no information about a motion along a direction in which the outline around them continues
(generalised ICP: Segal, Haehnel and Thrun, RSS 2009; the aperture problem). Without this, a side that slides along the
grid would appear fixed to it, because the points are cell centres.
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
"""Single precision, because the sums over all pairs of points then take a third of the time."""
NO_POINT = 1e12
"""Squared distance if there is no point, m^2."""
UNKNOWN = (1e4, 1e4, 1e3)
"""Variance of an unobserved direction: x and y (m^2) and heading (rad^2)."""
JACOBI_SWEEPS = 8
"""Sweeps of Jacobi's method: five leave nothing of a symmetric (3, 3) besides its diagonal."""


class Outlines(NamedTuple):
    """G concatenated outlines: points (N, 2), metres, their weights (N,), and where each outline is cut off (N,).

    The points of outline g are from `bounds` (G+1,) [g] to [g+1]; a weight is the probability of a return there.
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

    `surface_noise_m` is the standard deviation of a return about the boundary. The result is the best optimum from all
    starts: a wide kernel biases the pose towards parts of a body that its boundary does not contain yet, and a narrow
    kernel does not converge from a distant start. A pair that is not oriented keeps the heading of the start, with the
    variance UNKNOWN.
    """
    pairs = pairs._replace(numbers=np.ascontiguousarray(pairs.numbers))
    back = np.where(seen, BACK * boundaries.weights, 0.0).astype(np.float32)
    boundaries = boundaries._replace(weights=boundaries.weights.astype(np.float32))
    returns = returns._replace(weights=returns.weights.astype(np.float32))
    poses, covariances, residuals = _match(boundaries, returns, back, pairs, surface_noise_m)
    return Matches(poses, covariances, residuals, np.where(pairs.oriented, 3, 2))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _match(boundaries, returns, back, pairs, surface_noise_m):  # type: ignore[no-untyped-def]
    """Poses (P, 3), covariances (P, 3, 3) and residuals (P,); see `match`. `back` (N,): weights of `_expectation`."""
    count = len(pairs.numbers)
    poses, covariances, residuals = np.empty((count, 3)), np.empty((count, 3, 3)), np.empty(count)
    for p in range(count):
        b, r = pairs.numbers[p, 0], pairs.numbers[p, 1]
        own = slice(boundaries.bounds[b], boundaries.bounds[b + 1])
        theirs = slice(returns.bounds[r], returns.bounds[r + 1])
        residuals[p] = _best_match(
            (boundaries.points[own], boundaries.weights[own], boundaries.cut[own]),
            back[own],
            (returns.points[theirs], returns.weights[theirs], returns.cut[theirs]),
            pairs.starts[p],
            _widths(pairs.start_error_m[p], surface_noise_m),
            surface_noise_m,
            pairs.extended[p],
            pairs.oriented[p],
            poses[p],
            covariances[p],
        )
    return poses, covariances, residuals


@numba.njit(error_model="numpy")
def _best_match(  # type: ignore[no-untyped-def]
    boundary, back, returns, starts, widths, surface_noise_m, extended, oriented, pose, covariance
):
    """Write the best match of one pair from any of the starts (S, 3) into `pose` (3,) and `covariance` (3, 3).

    Returns its residual.
    """
    (offsets, weights, cut), (positions, trust, returns_cut) = boundary, returns
    points, placed = np.empty((2, len(positions)), np.float32), np.empty((2, len(offsets)), np.float32)
    at_returns, at_boundary = np.empty((6, len(positions)), np.float32), np.empty((6, len(offsets)), np.float32)
    _place(positions, -starts[0, 0], -starts[0, 1], 0.0, points)
    _place(offsets, 0.0, 0.0, starts[0, 2], placed)
    of_returns = _information(points, trust, returns_cut, extended, CONTINUES * surface_noise_m)
    of_boundary = _information(placed, weights, cut, extended, CONTINUES * surface_noise_m)
    gradient, inverse = np.empty(3), np.empty((3, 3))
    pose[0], pose[1], pose[2] = starts[0, 0], starts[0, 1], starts[0, 2]
    residual = np.inf
    for s in range(len(starts)):
        if not math.isfinite(starts[s, 0]):
            continue
        x, y, turn = 0.0, 0.0, starts[s, 2]  # relative to the start, for single precision
        _place(positions, -starts[s, 0], -starts[s, 1], 0.0, points)
        for n in range(len(widths)):
            _place(offsets, x, y, turn, placed)
            _expectation(points, trust, placed, weights, of_boundary, widths[n], at_returns)
            _expectation(placed, back, points, trust, of_returns, widths[n], at_boundary)
            first, second = _sum_terms(points, at_returns, ONE, x, y), _sum_terms(placed, at_boundary, ZERO, x, y)
            _derivatives(first, second, widths[n], oriented, gradient, inverse)
            _invert(inverse)
            if n < len(widths) - 1:
                step_x, step_y, step_turn = _product(inverse, gradient)
                share = min(1.0, widths[n] / max(math.hypot(step_x, step_y), 1e-9))
                x, y, turn = x + share * step_x, y + share * step_y, turn + share * step_turn
        misfit = _misfit(at_returns)
        if misfit < residual:
            residual = misfit
            pose[0], pose[1], pose[2] = starts[s, 0] + x, starts[s, 1] + y, turn
            for i in range(3):
                for j in range(3):
                    covariance[i, j] = inverse[i, j]
    return residual


@numba.njit(error_model="numpy")
def _misfit(at_returns):  # type: ignore[no-untyped-def]
    """-2 times the mean log likelihood of the returns, from their expectation (6, K)."""
    total = ZERO
    for i in range(at_returns.shape[1]):
        total += math.log(min(at_returns[5, i], ONE))
    return -2.0 * (total / at_returns.shape[1])


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
def _information(points, weights, cut, extended, reach):  # type: ignore[no-untyped-def]
    """Information of each point (2, N) of an outline about a motion in each direction: matrices xx, xy, yy (3, N).

    Identity minus the covariance of the outline around the point, in units of `reach` squared: 0 along a line that
    continues, 1 across it, nearly 1 for small outlines and at ends; reduced along an `extended` outline where it is
    `cut` off (N,).
    """
    information = np.empty((3, points.shape[1]), np.float32)
    scale, about, nearby = 1.0 / (reach * reach), _exponent(reach), _exponent(CUT_REACH * reach)
    ends, count = np.empty_like(points), 0
    for i in range(points.shape[1]):
        if extended and cut[i]:
            ends[0, count], ends[1, count] = points[0, i], points[1, i]
            count += 1
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
        along = 1.0 - (1.0 - CUT) * _exp(nearby * _squared_distance(points[0, i], points[1, i], ends, count))
        information[0, i], information[1, i], information[2, i] = _scale_along(
            1.0 - scale * xx, -scale * xy, 1.0 - scale * yy, along
        )
    return information


@numba.njit(error_model="numpy")
def _squared_distance(x, y, points, count):  # type: ignore[no-untyped-def]
    """From x, y to the nearest of the first `count` of `points` (2, N); NO_POINT if there are none."""
    nearest = NO_POINT
    for j in range(count):
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
def _derivatives(of_returns, of_boundary, width, oriented, gradient, information):  # type: ignore[no-untyped-def]
    """Write the `gradient` (3,) of the log likelihood, and its negative curvature `information` (3, 3).

    From `_sum_terms` of the returns and of the boundary points; the curvature includes the prior UNKNOWN.
    """
    terms = np.empty(9)
    for i in range(9):
        terms[i] = (of_returns[i] + of_boundary[i]) / (width * width)
    if not oriented:
        terms[2] = terms[6] = terms[7] = terms[8] = 0.0
    gradient[0], gradient[1], gradient[2] = terms[0], terms[1], terms[2]
    information[0, 0], information[1, 1] = terms[3] + 1.0 / UNKNOWN[0], terms[5] + 1.0 / UNKNOWN[1]
    information[2, 2] = terms[8] + 1.0 / UNKNOWN[2]
    information[0, 1] = information[1, 0] = terms[4]
    information[0, 2] = information[2, 0] = terms[6]
    information[1, 2] = information[2, 1] = terms[7]


@numba.njit(error_model="numpy", fastmath=True)
def _sum_terms(points, expected, on_boundary, around_x, around_y):  # type: ignore[no-untyped-def]
    """Contribution of `points` (2, N) with their expectation `expected` (6, N) to `_derivatives`, for kernel width 1.

    Returns the gradient by x, y and turn, and the curvature xx, xy, yy, x_turn, y_turn, turn_turn; a turn is about the
    position `around_x`, `around_y`.

    The expected point lies on the boundary for `on_boundary` 1 (`points` are returns); for 0 the point itself does.
    """
    x = y = turn = xx = xy = yy = x_turn = y_turn = turn_turn = ZERO
    pose_x, pose_y, sign = np.float32(around_x), np.float32(around_y), ONE - on_boundary - on_boundary
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
    return x, y, turn, xx, xy, yy, x_turn, y_turn, turn_turn


@numba.njit(error_model="numpy")
def _invert(information):  # type: ignore[no-untyped-def]
    """Invert the result (3, 3) of `_derivatives` in place: positive definite, about UNKNOWN in unobserved directions.

    In exact arithmetic `information` is at least the prior. But if a long body meets the returns in one place only, a
    turn about that place is the small difference of large sums, with a rounding error above the prior in single
    precision. The information is then raised to the prior in the directions that have less.
    """
    if not _is_below_prior(information):
        _invert_positive(information)
        return
    axes = np.empty((3, 3))
    for i in range(3):  # to units in which the prior is the identity
        for j in range(3):
            information[i, j] *= math.sqrt(UNKNOWN[i]) * math.sqrt(UNKNOWN[j])
    _diagonalise(information, axes)
    shares = max(information[0, 0], 1.0), max(information[1, 1], 1.0), max(information[2, 2], 1.0)
    for i in range(3):
        for j in range(3):
            information[i, j] = (
                math.sqrt(UNKNOWN[i])
                * math.sqrt(UNKNOWN[j])
                * (
                    axes[i, 0] * axes[j, 0] / shares[0]
                    + axes[i, 1] * axes[j, 1] / shares[1]
                    + axes[i, 2] * axes[j, 2] / shares[2]
                )
            )


@numba.njit(error_model="numpy")
def _diagonalise(a, axes):  # type: ignore[no-untyped-def]
    """Jacobi's method: replace the symmetric `a` (3, 3) by `axes`^T a `axes`, with its eigenvalues on the diagonal.

    The eigenvectors are the columns of `axes` (3, 3). Each of the JACOBI_SWEEPS sweeps squares the off-diagonal rest
    (Golub and Van Loan, section 8.5).
    """
    for i in range(3):
        for j in range(3):
            axes[i, j] = 1.0 if i == j else 0.0
    for turn in range(3 * JACOBI_SWEEPS):
        p, q = turn % 3, (turn + 1) % 3
        if a[p, q] == 0.0:
            continue
        ratio = 0.5 * (a[q, q] - a[p, p]) / a[p, q]
        tangent = math.copysign(1.0, ratio) / (abs(ratio) + math.hypot(1.0, ratio))
        cosine = 1.0 / math.hypot(1.0, tangent)
        sine = tangent * cosine
        for k in range(3):
            a[k, p], a[k, q] = cosine * a[k, p] - sine * a[k, q], sine * a[k, p] + cosine * a[k, q]
            axes[k, p], axes[k, q] = cosine * axes[k, p] - sine * axes[k, q], sine * axes[k, p] + cosine * axes[k, q]
        for k in range(3):
            a[p, k], a[q, k] = cosine * a[p, k] - sine * a[q, k], sine * a[p, k] + cosine * a[q, k]


@numba.njit(error_model="numpy")
def _is_below_prior(a):  # type: ignore[no-untyped-def]
    """Whether the symmetric `a` (3, 3) has less than half the information of the prior UNKNOWN in some direction."""
    xx, yy, zz = a[0, 0] - 0.5 / UNKNOWN[0], a[1, 1] - 0.5 / UNKNOWN[1], a[2, 2] - 0.5 / UNKNOWN[2]
    xy, xz, yz = a[0, 1], a[0, 2], a[1, 2]
    plane = xx * yy - xy * xy
    return xx <= 0.0 or plane <= 0.0 or plane * zz + xz * (xy * yz - yy * xz) - yz * (xx * yz - xy * xz) <= 0.0


@numba.njit(error_model="numpy")
def _invert_positive(a):  # type: ignore[no-untyped-def]
    """Invert a symmetric, positive definite matrix (3, 3) in place: its cofactors divided by its determinant."""
    cofactors = np.empty((3, 3))
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        for m in range(3):
            n, o = (m + 1) % 3, (m + 2) % 3
            cofactors[i, m] = a[j, n] * a[k, o] - a[j, o] * a[k, n]
    determinant = a[0, 0] * cofactors[0, 0] + a[0, 1] * cofactors[0, 1] + a[0, 2] * cofactors[0, 2]
    for i in range(3):
        for m in range(3):
            a[i, m] = cofactors[i, m] / determinant


@numba.njit(error_model="numpy")
def _product(a, b):  # type: ignore[no-untyped-def]
    """The three numbers of the matrix `a` (3, 3) times `b` (3,)."""
    return (
        a[0, 0] * b[0] + a[0, 1] * b[1] + a[0, 2] * b[2],
        a[1, 0] * b[0] + a[1, 1] * b[1] + a[1, 2] * b[2],
        a[2, 0] * b[0] + a[2, 1] * b[1] + a[2, 2] * b[2],
    )


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

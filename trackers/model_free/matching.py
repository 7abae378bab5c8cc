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

import numba
import numpy as np

from gridtrack.common.grid import Mask
from gridtrack.trackers.model_free.matches import Matches, Outlines, Pairs

WIDEST = 4.0
"""The widest kernel, in surface widths; each is half as wide as the one before."""
NEWTON_STEPS = 3
"""With each kernel."""
GOES_ON = 3.0
"""Where an outline goes on for so many surface widths either way, it tells nothing of a motion along itself."""
CUT, CUT_REACH = 0.02, 2.0
"""Where an outline is cut off, what it tells of a motion along itself as a share of what an end tells; and how far from
there that holds, as a share of how far an outline must go on."""
BACK = 2.0
"""What a boundary point without a return tells, against a return without a boundary point."""
OUTLIER = math.exp(-4.5)
"""Likelihood of a point that is not of the other outline: that of one three kernel widths from a certain point."""
FURTHEST = np.float32(-10.0)
"""Exponent below which the kernel is nothing."""
LEAST = np.float32(1e-30)
"""Likelihood in whose place nothing else can be divided by."""
ZERO, ONE, SIXTEENTH = np.float32(0.0), np.float32(1.0), np.float32(1.0 / 16.0)
SERIES = tuple(np.float32(1.0 / math.factorial(n)) for n in (2, 3, 4, 5))
"""Single precision, by which the sums over all pairs of points take a third of the time."""
NOWHERE = 1e12
"""Squared distance from what is not there, m^2."""
UNKNOWN = (1e4, 1e4, 1e3)
"""Variance of a direction that the returns say nothing of, along x and y (m^2) and of the heading (rad^2)."""


def match(boundaries: Outlines, seen: Mask, returns: Outlines, pairs: Pairs, surface_noise_m: float) -> Matches:
    """Match boundaries, in body frames, to returns, in the grid frame; the boundary points `seen` (N,) are in view.

    `surface_noise_m` is the standard deviation of a return about the boundary. Of the optima reached from all starts
    the best is returned: a wide kernel biases the pose towards parts of a body that its boundary does not contain yet;
    a narrow kernel does not converge from a distant start. A pair that does not turn keeps the heading of the start,
    with the variance UNKNOWN.
    """
    pairs = pairs._replace(numbers=np.ascontiguousarray(pairs.numbers))
    poses, covariances, residuals = _match(boundaries, seen, returns, pairs, surface_noise_m)
    return Matches(poses, covariances, residuals, np.where(pairs.turns, 3, 2))


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
            (boundaries.points[own], boundaries.weights[own], boundaries.cut[own] & pairs.goes_on[p]),
            seen[own],
            (returns.points[theirs], returns.weights[theirs], returns.cut[theirs] & pairs.goes_on[p]),
            pairs.starts[p],
            _widths(pairs.unsure_m[p], surface_noise_m),
            surface_noise_m,
            pairs.turns[p],
        )
    return poses, covariances, residuals


@numba.njit(error_model="numpy")
def _best_match(boundary, seen, returns, starts, widths, surface_noise_m, turns):  # type: ignore[no-untyped-def]
    """Pose (3,), covariance (3, 3) and residual of the best match of one pair from any of the starts (S, 3)."""
    (offsets, weights, cut), (positions, trust, returns_cut) = boundary, returns
    points, placed = np.empty((2, len(positions)), np.float32), np.empty((2, len(offsets)), np.float32)
    there, likely = trust.astype(np.float32), weights.astype(np.float32)
    back = np.where(seen, BACK * weights, 0.0).astype(np.float32)
    met, meets = np.empty((6, len(positions)), np.float32), np.empty((6, len(offsets)), np.float32)
    _place(positions, -starts[0, 0], -starts[0, 1], 0.0, points)
    _place(offsets, 0.0, 0.0, starts[0, 2], placed)
    telling = _telling(points, there, returns_cut, GOES_ON * surface_noise_m)
    told = _telling(placed, likely, cut, GOES_ON * surface_noise_m)
    best, covariance, residual = starts[0], np.empty((3, 3)), np.inf
    for start in starts[np.isfinite(starts[:, 0])]:
        moved = np.array([0.0, 0.0, start[2]])  # from the start, for single precision
        _place(positions, -start[0], -start[1], 0.0, points)
        for n in range(len(widths)):
            _place(offsets, moved[0], moved[1], moved[2], placed)
            _expect(points, there, placed, likely, told, widths[n], met)
            _expect(placed, back, points, there, telling, widths[n], meets)
            gradient, information = _curvature(points, met, placed, meets, moved, widths[n], turns)
            inverse = _inverse(information)
            if n < len(widths) - 1:
                step = inverse @ gradient
                moved += step * min(1.0, widths[n] / max(math.hypot(step[0], step[1]), 1e-9))
        misfit = -2.0 * np.log(np.minimum(met[5], ONE)).mean()
        if misfit < residual:
            moved[:2] += start[:2]
            best, covariance, residual = moved, inverse, misfit
    return best, covariance, residual


@numba.njit(error_model="numpy")
def _widths(unsure_m, surface_noise_m):  # type: ignore[no-untyped-def]
    """The kernel's width, metres, at each step of Newton's method, and at last, where no step follows: (n+1,)."""
    kernel = min(max(unsure_m / surface_noise_m, 1.0), WIDEST)
    kernels = 1 + math.ceil(math.log2(kernel))
    widths = np.full(kernels * NEWTON_STEPS + 1, surface_noise_m)
    for n in range(kernels - 1):
        widths[n * NEWTON_STEPS : (n + 1) * NEWTON_STEPS] = surface_noise_m * max(kernel / 2.0**n, 1.0)
    return widths


@numba.njit(error_model="numpy")
def _place(points, x, y, turn, placed):  # type: ignore[no-untyped-def]
    """Write `points` (N, 2), turned and then moved by x, y, into `placed` (2, N), in single precision."""
    cosine, sine = math.cos(turn), math.sin(turn)
    for j in range(len(points)):
        placed[0, j] = x + cosine * points[j, 0] - sine * points[j, 1]
        placed[1, j] = y + sine * points[j, 0] + cosine * points[j, 1]


@numba.njit(error_model="numpy", fastmath=True)
def _telling(points, weights, cut, reach):  # type: ignore[no-untyped-def]
    """What each point (2, N) of an outline tells of a motion in each direction: matrices xx, xy, yy (3, N).

    One less the variance of the outline about it, in `reach` squared: 0 along a line that goes on, 1 across it, and
    next to 1 for what is small or ends there; hardly anything along it where it is cut off.
    """
    tells = np.empty((3, points.shape[1]), np.float32)
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
        tells[0, i], tells[1, i], tells[2, i] = _less_along(1.0 - scale * xx, -scale * xy, 1.0 - scale * yy, along)
    return tells


@numba.njit(error_model="numpy")
def _squared_distance(x, y, points):  # type: ignore[no-untyped-def]
    """From x, y to the nearest of `points` (2, N); NOWHERE where there are none."""
    nearest = NOWHERE
    for j in range(points.shape[1]):
        dx, dy = points[0, j] - x, points[1, j] - y
        nearest = min(nearest, dx * dx + dy * dy)
    return nearest


@numba.njit(error_model="numpy", fastmath=True)
def _expect(points, trust, others, weights, tells, width, expected):  # type: ignore[no-untyped-def]
    """Write where each of `points` (2, K) is expected to be of the outline `others` (2, N) into `expected` (6, K).

    How far from it along x and y, and what that tells, xx, xy, yy: what those points tell, `tells` (3, N), times the
    probability that it is of this outline, times `trust` (K,). At last its likelihood.
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
                xx += share * tells[0, j]
                xy += share * tells[1, j]
                yy += share * tells[2, j]
        some, mixed = max(total, LEAST), total + OUTLIER
        share = trust[i] / mixed
        expected[0, i], expected[1, i] = x / some, y / some
        expected[2, i], expected[3, i], expected[4, i] = share * xx, share * xy, share * yy
        expected[5, i] = mixed


@numba.njit(error_model="numpy")
def _exponent(width):  # type: ignore[no-untyped-def]
    """What a squared distance is multiplied by in the exponent of a kernel of this width."""
    return np.float32(-0.5 / (width * width))


@numba.njit(error_model="numpy", fastmath=True)
def _exp(x):  # type: ignore[no-untyped-def]
    """Exponential of `x` <= 0, to 1e-3 of itself where that is above exp(FURTHEST), and 0 beyond; it vectorises."""
    y = max(x, FURTHEST) * SIXTEENTH
    y = ONE + y * (ONE + y * (SERIES[0] + y * (SERIES[1] + y * (SERIES[2] + y * SERIES[3]))))
    y *= y
    y *= y
    y *= y
    y *= y
    return y if x > FURTHEST else ZERO


@numba.njit(error_model="numpy")
def _curvature(points, met, placed, meets, pose, width, turns):  # type: ignore[no-untyped-def]
    """Gradient (3,) of the log likelihood at `pose` (3,), and its negative curvature (3, 3), with the unknown's.

    Of the returns `points` (2, K), which expect the boundary to be `met` (6, K), and of the boundary points `placed`
    (2, N), which expect returns where they are `meets` (6, N).
    """
    x, y, turn, xx, xy, yy, x_turn, y_turn, turn_turn = np.add(
        _pulls(points, met, ONE, pose), _pulls(placed, meets, ZERO, pose)
    ) / (width * width)
    if not turns:
        turn = x_turn = y_turn = turn_turn = 0.0
    gradient = np.array([x, y, turn])
    total = np.array([[xx, xy, x_turn], [xy, yy, y_turn], [x_turn, y_turn, turn_turn]])
    for axis in range(3):
        total[axis, axis] += 1.0 / UNKNOWN[axis]
    return gradient, total


@numba.njit(error_model="numpy", fastmath=True)
def _pulls(points, expected, on_boundary, pose):  # type: ignore[no-untyped-def]
    """What `points` (2, N) and what they expect, `expected` (6, N), add to `_curvature`, before its width.

    What they expect is where the boundary lies, or where they are `on_boundary` 0 themselves, where it belongs.
    """
    x = y = turn = xx = xy = yy = x_turn = y_turn = turn_turn = ZERO
    pose_x, pose_y, pull = np.float32(pose[0]), np.float32(pose[1]), ONE - on_boundary - on_boundary
    for i in range(points.shape[1]):
        dx, dy, axx, axy, ayy = expected[0, i], expected[1, i], expected[2, i], expected[3, i], expected[4, i]
        bx, by = points[0, i] + on_boundary * dx - pose_x, points[1, i] + on_boundary * dy - pose_y
        fx, fy = pull * (axx * dx + axy * dy), pull * (axy * dx + ayy * dy)
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
def _less_along(xx, xy, yy, share):  # type: ignore[no-untyped-def]
    """The symmetric matrix xx, xy, yy with this share of its lower eigenvalue, and nothing that is negative."""
    middle, half = 0.5 * (xx + yy), math.hypot(0.5 * (xx - yy), xy)
    high, low = max(middle + half, 0.0), share * max(middle - half, 0.0)
    if half < 1e-12:
        return low, 0.0, low
    cosine, sine = 0.5 * (xx - yy) / half, xy / half  # of twice the angle of the first axis
    mean, difference = 0.5 * (high + low), 0.5 * (high - low)
    return mean + difference * cosine, difference * sine, mean - difference * cosine

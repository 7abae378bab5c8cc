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
"""Exponent of the kernel below which a boundary point is not looked at."""
UNKNOWN = (1e4, 1e4, 1e3)
"""Variance of a direction that the returns say nothing of, along x and y (m^2) and of the heading (rad^2)."""


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
    placed, means, trust = np.empty_like(offsets), np.empty_like(points), np.empty(len(points))
    best, residual = starts[0].copy(), np.inf
    for s in range(len(starts)):
        pose = starts[s].copy()
        kernel = min(max(unsure_m / surface_m, 1.0), WIDEST)
        while kernel > 0.5:
            width = max(kernel, 1.0) * surface_m
            for step in range(ITERATIONS + NEWTON_STEPS):
                _place(offsets, pose, placed)
                _expect(points, placed, weights, cut, width, means, trust)
                if step < ITERATIONS:
                    _maximise(points, means, trust, turns, pose)
                else:
                    _newton(points, placed, weights, means, trust, width, turns, pose)
            kernel *= 0.5
        _place(offsets, pose, placed)
        misfit = _expect(points, placed, weights, cut, surface_m, means, trust)
        if misfit < residual:
            best, residual = pose, misfit
    _place(offsets, best, placed)
    _expect(points, placed, weights, cut, surface_m, means, trust)
    information = _information(points, placed, weights, means, trust, best, surface_m, turns)
    return best, np.linalg.inv(information), residual


@numba.njit(error_model="numpy")
def _place(offsets, pose, placed):  # type: ignore[no-untyped-def]
    """Write where `offsets` (N, 2) lie at `pose` (3,) into `placed` (N, 2)."""
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    for j in range(len(offsets)):
        placed[j, 0] = pose[0] + cosine * offsets[j, 0] - sine * offsets[j, 1]
        placed[j, 1] = pose[1] + sine * offsets[j, 0] + cosine * offsets[j, 1]


@numba.njit(error_model="numpy")
def _expect(points, placed, weights, cut, width, means, trust):  # type: ignore[no-untyped-def]
    """Write the boundary that each return is expected of, `means` (K, 2), and how far it tells, `trust` (K,).

    That is the probability that it is of this boundary, where that is not cut off. Returns the residual.
    """
    scale = -0.5 / (width * width)
    misfit = 0.0
    for i in range(len(points)):
        total = telling = x = y = 0.0
        for j in range(len(placed)):
            dx, dy = points[i, 0] - placed[j, 0], points[i, 1] - placed[j, 1]
            exponent = scale * (dx * dx + dy * dy)
            if exponent > FURTHEST:
                share = weights[j] * math.exp(exponent)
                total += share
                x += share * placed[j, 0]
                y += share * placed[j, 1]
                if not cut[j]:
                    telling += share
        trust[i] = (telling + CUT * (total - telling)) / (total + OUTLIER)
        means[i, 0], means[i, 1] = (x / total, y / total) if total > 0.0 else (points[i, 0], points[i, 1])
        misfit -= 2.0 * math.log(min(total + OUTLIER, 1.0))
    return misfit / len(points)


@numba.njit(error_model="numpy")
def _maximise(points, means, trust, turns, pose):  # type: ignore[no-untyped-def]
    """Move `pose` (3,) so that the expected boundary `means` (K, 2) falls on the returns: least squares by `trust`."""
    total = trust.sum()
    if total < 1e-6:
        return
    px, py = (trust * points[:, 0]).sum() / total, (trust * points[:, 1]).sum() / total
    mx, my = (trust * means[:, 0]).sum() / total, (trust * means[:, 1]).sum() / total
    turn = 0.0
    if turns:
        dot = cross = 0.0
        for i in range(len(points)):
            ax, ay = means[i, 0] - mx, means[i, 1] - my
            bx, by = points[i, 0] - px, points[i, 1] - py
            dot += trust[i] * (ax * bx + ay * by)
            cross += trust[i] * (ax * by - ay * bx)
        turn = math.atan2(cross, dot) if dot > 0.0 else 0.0
    cosine, sine = math.cos(turn), math.sin(turn)
    ox, oy = pose[0] - mx, pose[1] - my
    pose[0], pose[1] = px + cosine * ox - sine * oy, py + sine * ox + cosine * oy
    pose[2] += turn


@numba.njit(error_model="numpy")
def _newton(points, placed, weights, means, trust, width, turns, pose):  # type: ignore[no-untyped-def]
    """Move `pose` (3,) by one step of Newton's method, no further than the kernel's `width`."""
    gradient = np.zeros(3)
    for i in range(len(points)):
        scale = trust[i] / (width * width)
        rx, ry = points[i, 0] - means[i, 0], points[i, 1] - means[i, 1]
        gradient[0] += scale * rx
        gradient[1] += scale * ry
        if turns:
            gradient[2] += scale * ((means[i, 0] - pose[0]) * ry - (means[i, 1] - pose[1]) * rx)
    step = np.linalg.solve(_information(points, placed, weights, means, trust, pose, width, turns), gradient)
    pose += step * min(1.0, width / max(math.hypot(step[0], step[1]), 1e-9))


@numba.njit(error_model="numpy")
def _information(points, placed, weights, means, trust, pose, width, turns):  # type: ignore[no-untyped-def]
    """Curvature (3, 3) of minus the log likelihood at `pose` (3,), never negative, and what is known of the unknown."""
    total = np.zeros((3, 3))
    for axis in range(3):
        total[axis, axis] = 1.0 / UNKNOWN[axis]
    scale = 1.0 / (width * width)
    for i in range(len(points)):
        xx, xy, yy = _spread(points[i], placed, weights, means[i], width)
        xx, xy, yy = _not_negative(scale * (1.0 - scale * xx), -scale * scale * xy, scale * (1.0 - scale * yy))
        dx, dy = means[i, 0] - pose[0], means[i, 1] - pose[1]
        total[0, 0] += trust[i] * xx
        total[1, 1] += trust[i] * yy
        total[0, 1] += trust[i] * xy
        if turns:
            total[0, 2] += trust[i] * (xy * dx - xx * dy)
            total[1, 2] += trust[i] * (yy * dx - xy * dy)
            total[2, 2] += trust[i] * (xx * dy * dy - 2.0 * xy * dx * dy + yy * dx * dx)
    total[1, 0], total[2, 0], total[2, 1] = total[0, 1], total[0, 2], total[1, 2]
    return total


@numba.njit(error_model="numpy")
def _spread(point, placed, weights, mean, width):  # type: ignore[no-untyped-def]
    """Covariance xx, xy, yy of the boundary that one return may be of, about its `mean` (2,)."""
    scale = -0.5 / (width * width)
    total = xx = xy = yy = 0.0
    for j in range(len(placed)):
        dx, dy = point[0] - placed[j, 0], point[1] - placed[j, 1]
        exponent = scale * (dx * dx + dy * dy)
        if exponent > FURTHEST:
            share = weights[j] * math.exp(exponent)
            ex, ey = placed[j, 0] - mean[0], placed[j, 1] - mean[1]
            total += share
            xx += share * ex * ex
            xy += share * ex * ey
            yy += share * ey * ey
    if total == 0.0:
        return 0.0, 0.0, 0.0
    return xx / total, xy / total, yy / total


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

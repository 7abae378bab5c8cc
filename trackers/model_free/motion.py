"""The motion model: rigid planar motion with a coordinated turn, predicted over whole periods.

State (6,): x, y, heading, vx, vy, turn rate; metres, radians and seconds in the fixed frame. In continuous time, with J
a quarter turn and w white noise (white-noise acceleration: Bar-Shalom, Li and Kirubarajan 2001, section 6.2.2; with an
unknown turn rate: their chapter 11; both rates are Ornstein-Uhlenbeck processes here):

    d position = v dt     dv = (turn_rate J v - v / velocity_memory_s) dt + acceleration dw + speed_noise v dw
    d heading = turn_rate dt     d turn_rate = -turn_rate / turn_memory_s dt + turn_acceleration dw
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, NamedTuple

import numba
import numpy as np

from gridtrack.common.geometry import wrap_angle
from gridtrack.trackers.model_free.arrays import Array

INLINED = numba.njit(inline="always", error_model="numpy")
"""For functions in inner loops: without inlining, counting the references to arguments takes as long as the rest."""
wrapped: Any = numba.njit(wrap_angle)
"""`wrap_angle` for compiled functions."""


class MotionModel(NamedTuple):
    """Process noise and initial uncertainty of the motion of an object; every number positive and finite."""

    acceleration: float
    """White-noise acceleration along each axis: square root of its density, m/s^2 per sqrt(Hz)."""
    speed_noise: float
    """White noise of the relative change of speed: fast objects accelerate and brake harder; 1/s per sqrt(Hz)."""
    turn_acceleration: float
    """White-noise acceleration of the turn rate, rad/s^2 per sqrt(Hz)."""
    velocity_memory_s: float
    """Correlation time of the velocity; large: nearly constant velocity."""
    turn_memory_s: float
    """Correlation time of the turn rate."""
    initial_speed: float
    """Standard deviation of a new track's velocity along each axis, m/s."""
    initial_turn_rate: float
    """Standard deviation of a new track's turn rate, rad/s."""
    period_s: float
    """Period of the frames."""


class StateLimits(NamedTuple):
    """Limits of the state of an object that was just measured, in a window with frames of one period.

    All its poses lie in the window: two poses are at most its diagonal apart, and its speed is at most a diagonal in a
    period. A turn of more than half a circle in a period looks like a turn the other way.
    """

    distance_m: float
    """Largest distance of the position from the measured one."""
    speed: float
    """Largest speed, m/s."""
    turn_rate: float
    """Largest turn rate either way, rad/s."""

    @classmethod
    def of(cls, window_m: float, period_s: float) -> StateLimits:
        """The limits in a window with sides of `window_m`."""
        diagonal_m = math.sqrt(2.0) * window_m
        return cls(diagonal_m, diagonal_m / period_s, math.pi / period_s)


class Regimes(NamedTuple):
    """The motion model of each regime, the transition probabilities `switching` (2, 2) in a period, and the limits."""

    models: tuple[MotionModel, MotionModel]
    switching: tuple[tuple[float, float], tuple[float, float]]
    limits: StateLimits

    @classmethod
    def of(
        cls,
        steady: MotionModel,
        manoeuvre_noise: float,
        steady_duration_s: float,
        manoeuvre_duration_s: float,
        window_m: float,
    ) -> Regimes:
        """`steady`, and a manoeuvre with `manoeuvre_noise` times its process noise; mean durations in seconds.

        `window_m` is the side of the window in which the objects are measured.
        """
        manoeuvre = steady._replace(
            acceleration=steady.acceleration * manoeuvre_noise,
            speed_noise=steady.speed_noise * manoeuvre_noise,
            turn_acceleration=steady.turn_acceleration * manoeuvre_noise,
        )
        starts, ends = (-math.expm1(-steady.period_s / mean_s) for mean_s in (steady_duration_s, manoeuvre_duration_s))
        switching = (1.0 - starts, starts), (ends, 1.0 - ends)
        return cls((steady, manoeuvre), switching, StateLimits.of(window_m, steady.period_s))


class Discretisation(NamedTuple):
    """The model over one period, at three Gauss-Legendre nodes and the end of the period (4,), and its noise.

    The velocity is rotated by the turn rate times `turning` and scaled by `keeping`; the position is its integral.
    """

    weights: Array
    """Weight of each node in that integral, s; 0 for the end (4,)."""
    keeping: Array
    """Remaining share of the velocity at each node (4,)."""
    turning: Array
    """Integral of the remaining share of the turn rate up to each node, s (4,)."""
    turn_keeping: float
    """Remaining share of the turn rate at the end."""
    noise: Array
    """Covariance (6, 6) of the acceleration noise of one period."""
    speed_covariance: Array
    """Covariance (2, 2) of the integrals of the speed noise: of its effect on the position, and on the velocity."""
    turn_noise: Array
    """Covariance (3, 3) of the integrals of the turn acceleration: effect on the position, heading, turn rate."""


@lru_cache(maxsize=64)
def discretise(model: MotionModel) -> Discretisation:
    """The model over one period. Raises ValueError if one of its numbers is not positive and finite."""
    for name, value in model._asdict().items():
        if not (value > 0.0 and math.isfinite(value)):
            raise ValueError(f"motion model: {name} is {value}; give a positive, finite number")
    nodes, weights = np.polynomial.legendre.leggauss(3)
    times = np.append((nodes + 1.0) / 2.0, 1.0) * model.period_s
    keeping, _, _ = _memory(times, model.velocity_memory_s)
    turn_keeping, turning, _ = _memory(times, model.turn_memory_s)
    unit = _integrals(model.period_s, model.velocity_memory_s)[1:, 1:]
    turned = _integrals(model.period_s, model.turn_memory_s) * model.turn_acceleration**2
    noise = np.zeros((6, 6))
    for axis in (0, 1):
        noise[np.ix_((axis, axis + 3), (axis, axis + 3))] = unit * model.acceleration**2
    return Discretisation(
        np.append(weights / 2.0, 0.0) * model.period_s,
        keeping,
        turning,
        float(turn_keeping[-1]),
        noise,
        unit * model.speed_noise**2,
        turned,
    )


def _memory(times: Array, memory_s: float) -> tuple[Array, Array, Array]:
    """Remaining share of a rate after `times` (N,), its integral, and the integral of that, each (N,)."""
    left = np.exp(-times / memory_s)
    integral = memory_s * -np.expm1(-times / memory_s)
    return left, integral, memory_s * (times - integral)


def _integrals(period_s: float, memory_s: float) -> Array:
    """Covariance (3, 3) of a rate driven by unit white noise: of its double integral, its integral and itself."""
    nodes, weights = np.polynomial.legendre.leggauss(8)
    left, integral, twice = _memory((nodes + 1.0) / 2.0 * period_s, memory_s)
    impulses = np.stack([twice, integral, left])
    return np.asarray(impulses * (weights / 2.0 * period_s) @ impulses.T)


@INLINED
def _transition(mean, step, moved, jacobian):  # type: ignore[no-untyped-def]
    """Write `mean` (6,) one period ahead into `moved` (6,), and its derivative by `mean` into `jacobian` (6, 6)."""
    vx, vy, rate = mean[3], mean[4], mean[5]
    jacobian[:] = 0.0
    x, y = mean[0], mean[1]
    stretched = turned = dx = dy = 0.0
    for node in range(4):
        weight, turning = step.weights[node], step.turning[node]
        cosine = step.keeping[node] * math.cos(rate * turning)
        sine = step.keeping[node] * math.sin(rate * turning)
        ux, uy = cosine * vx - sine * vy, sine * vx + cosine * vy
        x, y = x + weight * ux, y + weight * uy
        stretched, turned = stretched + weight * cosine, turned + weight * sine
        dx, dy = dx - weight * turning * uy, dy + weight * turning * ux
    jacobian[0, 3], jacobian[0, 4], jacobian[0, 5] = stretched, -turned, dx
    jacobian[1, 3], jacobian[1, 4], jacobian[1, 5] = turned, stretched, dy
    jacobian[3, 3], jacobian[3, 4], jacobian[3, 5] = cosine, -sine, -turning * uy
    jacobian[4, 3], jacobian[4, 4], jacobian[4, 5] = sine, cosine, turning * ux
    jacobian[0, 0], jacobian[1, 1], jacobian[2, 2] = 1.0, 1.0, 1.0
    jacobian[2, 5], jacobian[5, 5] = turning, step.turn_keeping
    moved[0], moved[1], moved[2] = x, y, mean[2] + turning * rate
    moved[3], moved[4], moved[5] = ux, uy, step.turn_keeping * rate


@INLINED
def _process_noise(moved, step, noise):  # type: ignore[no-untyped-def]
    """Write the process noise of one period into `noise` (6, 6); `moved` (6,) is the state at its end.

    The turn acceleration rotates heading and velocity by the same angle, and the speed noise scales the velocity: both
    terms grow with the speed, the first across the motion, the second along it.
    """
    for i in range(6):
        for j in range(6):
            noise[i, j] = step.noise[i, j]
    speed_noise, turn = step.speed_covariance, step.turn_noise
    along, across = (moved[3], moved[4]), (-moved[4], moved[3])
    for a in range(2):  # 0 for the position and the heading, 1 for their rates
        for b in range(2):
            for i in range(2):
                for j in range(2):
                    noise[i + 3 * a, j + 3 * b] += (
                        speed_noise[a, b] * along[i] * along[j] + turn[a, b] * across[i] * across[j]
                    )
                noise[i + 3 * a, 2 + 3 * b] = noise[2 + 3 * b, i + 3 * a] = turn[a, b + 1] * across[i]
            noise[2 + 3 * a, 2 + 3 * b] = turn[a + 1, b + 1]


@INLINED
def _add_transformed(jacobian, covariance, total):  # type: ignore[no-untyped-def]
    """Add J C J^T to `total`, all (6, 6), exactly symmetric; the first three columns of J are from the identity."""
    half = np.empty((6, 6))
    for i in range(6):
        for m in range(6):
            half[i, m] = covariance[i, m] if i < 3 else 0.0
            for k in range(3, 6):
                half[i, m] += jacobian[i, k] * covariance[k, m]
    for i in range(6):
        for j in range(i + 1):
            value = half[i, j] if j < 3 else 0.0
            for m in range(3, 6):
                value += half[i, m] * jacobian[j, m]
            total[i, j] += value
            total[j, i] = total[i, j]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def transition(mean, steps, step):  # type: ignore[no-untyped-def]
    """`mean` (6,) after `steps` periods, heading unwrapped, and its derivative (6, 6) by `mean`."""
    moved, following, jacobian, one = mean.copy(), np.empty(6), np.eye(6), np.empty((6, 6))
    column = np.empty(6)
    for _ in range(steps):
        _transition(moved, step, following, one)
        for j in range(6):
            for i in range(6):
                column[i] = 0.0
                for k in range(6):
                    column[i] += one[i, k] * jacobian[k, j]
            for i in range(6):
                jacobian[i, j] = column[i]
        for i in range(6):
            moved[i] = following[i]
    return moved, jacobian


def predict_state(mean: Array, covariance: Array, step: Discretisation) -> tuple[Array, Array]:
    """`mean` (6,) and `covariance` (6, 6) one period ahead, heading unwrapped."""
    means, covariances = propagate_all(mean[None], covariance[None], 1, step)
    return means[0, 1], covariances[0, 1]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def propagate_all(means, covariances, steps, step):  # type: ignore[no-untyped-def]
    """`propagate` with a discretised model."""
    tracks = means.shape[0]
    all_means, all_covariances = np.empty((tracks, steps + 1, 6)), np.empty((tracks, steps + 1, 6, 6))
    jacobian = np.empty((6, 6))
    for track in range(tracks):
        mean, spread = all_means[track], all_covariances[track]
        for i in range(6):
            mean[0, i] = means[track, i]
            for j in range(6):
                spread[0, i, j] = covariances[track, i, j]
        for n in range(steps):
            _transition(mean[n], step, mean[n + 1], jacobian)
            _process_noise(mean[n + 1], step, spread[n + 1])
            _add_transformed(jacobian, spread[n], spread[n + 1])
    return all_means, all_covariances


def propagate(means: Array, covariances: Array, steps: int, model: MotionModel) -> tuple[Array, Array]:
    """Means (T, steps+1, 6) and covariances (T, steps+1, 6, 6) at steps 0..steps, for all tracks at once.

    From the present `means` (T, 6) and `covariances` (T, 6, 6). Headings are unwrapped.
    """
    means, covariances = np.ascontiguousarray(means), np.ascontiguousarray(covariances)
    forecast: tuple[Array, Array] = propagate_all(means, covariances, steps, discretise(model))
    return forecast

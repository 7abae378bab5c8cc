"""A fixed-lag smoother of an object's motion: a factor graph with robust measurements, by gtsam.

One variable a measured frame, the state; between two of them the motion model, by the extended Kalman filter's
discretisation but linearised where smoothing has put them; on each a measured pose with a Cauchy kernel (Wang, Posner
and Newman 2015; Dellaert and Kaess 2017). What a gross error may do is decided where its state is linearised first.
"""

from __future__ import annotations

from typing import Any

import gtsam
import numba
import numpy as np

from gridtrack.common.geometry import wrap_angle
from gridtrack.trackers.model_free.arrays import Array
from gridtrack.trackers.model_free.motion.estimator import checked, first_state, is_positive_definite
from gridtrack.trackers.model_free.motion.model import (
    Discretisation,
    advance,
    discretise,
    propagate_all,
    transition,
)
from gridtrack.trackers.model_free.motion.parameters import MotionModel

LAG_S = 1.0
"""For how long a state can be revised; older ones are summed up in a prior."""
CAUCHY = 5.0
"""A measurement this many standard deviations off counts half. Geman-McClure's kernel of this width lets go of more:
it never caught up with an object much faster than expected."""
GATE = 21.1
"""Squared Mahalanobis distance of a pose from its prediction that one in ten thousand exceeds: chi-square, three
degrees of freedom. Within it the measurement is believed at first, beyond it the prediction."""

MEASURED, ITSELF = np.eye(3, 6), np.eye(6)
"""The derivatives by a state of its measured pose, and of itself."""


class FactorGraphEstimator:
    """Fixed-lag smoother: a MotionEstimator. `mean` (6,) and `covariance` (6, 6) are those of the newest frame.

    `restarts` counts how often gtsam found the system singular or indeterminate: then the frame's measurement is left
    out, and a new graph begins with the prediction. Raises ValueError as `update` does.
    """

    gate = GATE

    def __init__(self, pose: Array, covariance: Array, model: MotionModel) -> None:
        self._step, self._period_s = discretise(model), model.period_s
        self._frame = self.restarts = 0
        self._settle(*first_state(*checked(pose, covariance), model))
        self._begin()

    def predict(self) -> None:
        """Move on by one period; the graph hears of it with the next measurement."""
        self._frame += 1
        self._settle(*advance(self._mean, self.covariance, self._step))

    def update(self, pose: Array, covariance: Array) -> None:
        """Take in a measured pose (3,) and its covariance (3, 3)."""
        pose, covariance = checked(pose, covariance)
        nearest = np.array([pose[0], pose[1], self._mean[2] + wrap_angle(pose[2] - self._mean[2])])
        try:
            state = self._smoothed(nearest, covariance)
        except RuntimeError:  # what gtsam raises
            self.restarts += 1
            self._begin()
        else:
            self._settle(*state)
            self._newest, self._newest_mean = self._frame, self._mean

    def _smoothed(self, pose: Array, covariance: Array) -> tuple[Array, Array]:
        """The newest state's mean and covariance, given its pose too; raises RuntimeError where there is none."""
        factors, guesses, stamps = _additions()
        if self._frame > self._newest:
            guess = first_guess(self._mean, self.covariance, pose, covariance)
            factors.add(motion_factor(self._newest, self._frame, self._newest_mean, self._step))
            guesses.insert(self._frame, guess)
            stamps.insert((self._frame, self._frame * self._period_s))
        factors.add(pose_factor(self._frame, pose, covariance))
        return self._solved(factors, guesses, stamps)

    def begin_anew(self, mean: Array, covariance: Array) -> None:
        """Forget everything but this state (6,) and its covariance (6, 6)."""
        self._settle(mean.copy(), covariance.copy())
        self._begin()

    def _begin(self) -> None:
        """A new graph that knows the present mean and covariance, and nothing before."""
        parameters = gtsam.ISAM2Params()
        parameters.findUnusedFactorSlots = True  # else they grow for ever
        parameters.setFactorization("QR")  # steady motion is known to a millimetre, a heading at times not at all
        parameters.relinearizeSkip = 1  # a state is linearised again in the frame in which it has moved by 0.1
        self._smoother = gtsam.IncrementalFixedLagSmoother(LAG_S, parameters)
        self._newest, self._newest_mean = self._frame, self._mean
        factors, guesses, stamps = _additions()
        noise = gtsam.noiseModel.Gaussian.Covariance(self.covariance)
        factors.add(gtsam.PriorFactorVector(self._frame, self._mean, noise))
        guesses.insert(self._frame, self._mean)
        stamps.insert((self._frame, self._frame * self._period_s))
        self._smoother.update(factors, guesses, stamps)

    def _solved(self, factors: Any, guesses: Any, stamps: Any) -> tuple[Array, Array]:
        self._smoother.update(factors, guesses, stamps)
        mean = self._smoother.calculateEstimateVector(self._frame)
        covariance = self._smoother.marginalCovariance(self._frame)
        covariance = np.ascontiguousarray((covariance + covariance.T) / 2.0)
        if not (np.isfinite(mean).all() and is_positive_definite(covariance)):
            raise RuntimeError("the smoothed state is not finite or its covariance not positive definite")
        return mean, covariance

    def _settle(self, mean: Array, covariance: Array) -> None:
        """Keep the heading as the graph has it, not wrapped, and show it wrapped."""
        self._mean, self.covariance = mean, covariance
        self.mean = mean.copy()
        self.mean[2] = wrap_angle(mean[2])


def _additions() -> tuple[Any, Any, Any]:
    """What a smoother is told in one go: factors, first guesses of new variables, and their stamps in seconds."""
    return gtsam.NonlinearFactorGraph(), gtsam.Values(), gtsam.FixedLagSmootherKeyTimestampMap()


def motion_factor(past: int, now: int, mean: Array, step: Discretisation) -> Any:
    """The motion from frame `past`, where the state was about `mean` (6,), to frame `now`, as one factor.

    Frames between them, in which nothing was measured, need no variable: their noise is summed up.
    """
    _, noise = propagate_all(mean[None], np.zeros((1, 6, 6)), now - past, step)

    def residual(_: Any, values: Any, jacobians: Any) -> Array:
        moved, jacobian = transition(values.atVector(past), now - past, step)
        if jacobians is not None:
            jacobians[0], jacobians[1] = -jacobian, ITSELF
        return np.asarray(values.atVector(now) - moved)

    return gtsam.CustomFactor(gtsam.noiseModel.Gaussian.Covariance(noise[0, -1]), [past, now], residual)


def pose_factor(frame: int, pose: Array, covariance: Array) -> Any:
    """A measured pose (3,) with its covariance (3, 3), the heading not wrapped, robust against gross errors."""

    def residual(_: Any, values: Any, jacobians: Any) -> Array:
        if jacobians is not None:
            jacobians[0] = MEASURED
        return np.asarray(values.atVector(frame)[:3] - pose)

    noise = gtsam.noiseModel.Gaussian.Covariance(covariance)
    kernel = gtsam.noiseModel.mEstimator.Cauchy.Create(CAUCHY)
    return gtsam.CustomFactor(gtsam.noiseModel.Robust.Create(kernel, noise), [frame], residual)


@numba.njit(cache=True, nogil=True)
def first_guess(mean, covariance, pose, pose_covariance):  # type: ignore[no-untyped-def]
    """Where the new state (6,) is linearised first, which decides the first weight of its measurement.

    Within the gate it is the Kalman filter's estimate, near the measurement; beyond it the prediction, `mean` (6,) with
    its `covariance` (6, 6), so that a gross error is recognised as such. A robust measurement far from the prediction
    has a minimum at either.
    """
    innovation = pose - mean[:3]
    weighted = np.linalg.solve(covariance[:3, :3] + pose_covariance, innovation)
    return mean.copy() if innovation @ weighted > GATE else mean + weighted @ covariance[:3]

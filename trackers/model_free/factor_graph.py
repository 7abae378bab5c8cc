"""A fixed-lag smoother of an object's motion: a factor graph with robust measurements, by gtsam.

Each measured frame has one variable, the state. Two consecutive states are connected by the motion model, discretised
as in the extended Kalman filter but linearised at the smoothed states; each state has a measured pose with a Cauchy
kernel (Wang, Posner and Newman 2015; Dellaert and Kaess 2017). The first linearisation point of a state determines the
effect of a gross error.
"""

from __future__ import annotations

from typing import Any

import gtsam
import numpy as np

from gridtrack.common.geometry import wrap_angle
from gridtrack.trackers.model_free.arrays import Array
from gridtrack.trackers.model_free.estimators import (
    POSE_JACOBIAN,
    MotionEstimator,
    is_positive_definite,
    validated_measurement,
)
from gridtrack.trackers.model_free.motion import (
    Discretisation,
    MotionModel,
    predict_state,
    propagate_all,
    transition,
)
from gridtrack.trackers.model_free.tracker import ModelFreeTracker

LAG_S = 1.0
"""Duration of the smoothed states; older ones are marginalised into a prior."""
CAUCHY_WIDTH = 5.0
"""A measurement at this many standard deviations has half its weight. A Geman-McClure kernel of this width rejects
more, and never converged to an object much faster than expected."""
GATE = 21.1
"""Squared Mahalanobis distance of a pose from its prediction, which valid poses exceed with probability 1e-4:
chi-square, three degrees of freedom. Within it a state is linearised first at the measurement, beyond it at the
prediction."""

STATE_JACOBIAN = np.eye(6)
"""Jacobian of the state by itself."""


class FactorGraphEstimator(MotionEstimator):
    """Fixed-lag smoother; `mean` (6,) and `covariance` (6, 6) are at the newest frame.

    `restarts` counts singular or indeterminate systems: the measurement of the frame is then ignored, and a new graph
    starts from the prediction.
    """

    gate = GATE

    def __init__(self, pose: Array, covariance: Array, model: MotionModel) -> None:
        self._frame, self._period_s = 0, model.period_s
        super().__init__(pose, covariance, model)

    def predict(self) -> None:
        """Predict the state one period ahead; the graph is extended by the next measurement."""
        self._frame += 1
        self._store(*predict_state(self._mean, self.covariance, self._step))

    def update(self, pose: Array, covariance: Array) -> None:
        """Update with a measured pose (3,) and its covariance (3, 3)."""
        pose, covariance = validated_measurement(pose, covariance)
        measured = np.array([pose[0], pose[1], self._mean[2] + wrap_angle(pose[2] - self._mean[2])])
        try:
            state = self._smoothed(measured, covariance)
        except RuntimeError:  # raised by gtsam
            self.restarts += 1
            self._reset_graph()
        else:
            self._store(*state)
            self._newest, self._newest_mean = self._frame, self._mean

    def _smoothed(self, pose: Array, covariance: Array) -> tuple[Array, Array]:
        """Mean and covariance of the newest state after its measured pose; raises RuntimeError if gtsam fails."""
        factors, values, stamps = _new_factors()
        if self._frame > self._newest:
            linearisation = linearisation_point(self._mean, self.covariance, pose, covariance)
            factors.add(motion_factor(self._newest, self._frame, self._newest_mean, self._step))
            values.insert(self._frame, linearisation)
            stamps.insert((self._frame, self._frame * self._period_s))
        factors.add(pose_factor(self._frame, pose, covariance))
        return self._solved(factors, values, stamps)

    def reinitialise(self, mean: Array, covariance: Array) -> None:
        """Replace the estimate by this state (6,) and its covariance (6, 6), without earlier measurements."""
        self._store(mean.copy(), covariance.copy())
        self._reset_graph()

    def _reset_graph(self) -> None:
        """Start a new graph with the present mean and covariance as prior."""
        parameters = gtsam.ISAM2Params()
        parameters.findUnusedFactorSlots = True  # otherwise their number grows without bound
        parameters.setFactorization("QR")  # variances differ by orders of magnitude
        parameters.relinearizeSkip = 1  # check in each frame; threshold 0.1
        self._smoother = gtsam.IncrementalFixedLagSmoother(LAG_S, parameters)
        self._newest, self._newest_mean = self._frame, self._mean
        factors, values, stamps = _new_factors()
        noise = gtsam.noiseModel.Gaussian.Covariance(self.covariance)
        factors.add(gtsam.PriorFactorVector(self._frame, self._mean, noise))
        values.insert(self._frame, self._mean)
        stamps.insert((self._frame, self._frame * self._period_s))
        self._smoother.update(factors, values, stamps)

    def _solved(self, factors: Any, values: Any, stamps: Any) -> tuple[Array, Array]:
        self._smoother.update(factors, values, stamps)
        mean = self._smoother.calculateEstimateVector(self._frame)
        covariance = self._smoother.marginalCovariance(self._frame)
        covariance = np.ascontiguousarray((covariance + covariance.T) / 2.0)
        if not (np.isfinite(mean).all() and is_positive_definite(covariance)):
            raise RuntimeError("the smoothed state is not finite or its covariance not positive definite")
        return mean, covariance

    def _store(self, mean: Array, covariance: Array) -> None:
        """Store the state with the unwrapped heading of the graph; `mean` has it wrapped."""
        self._mean, self.covariance = mean, covariance
        self.mean = mean.copy()
        self.mean[2] = wrap_angle(mean[2])


def _new_factors() -> tuple[Any, Any, Any]:
    """Empty inputs of one smoother update: factors, initial values of new variables, and their stamps in seconds."""
    return gtsam.NonlinearFactorGraph(), gtsam.Values(), gtsam.FixedLagSmootherKeyTimestampMap()


def motion_factor(past: int, now: int, mean: Array, step: Discretisation) -> Any:
    """The motion factor from frame `past`, with a state near `mean` (6,), to frame `now`.

    Frames between them without a measurement have no variable: their noise is accumulated.
    """
    _, noise = propagate_all(mean[None], np.zeros((1, 6, 6)), now - past, step)

    def residual(_: Any, values: Any, jacobians: Any) -> Array:
        moved, jacobian = transition(values.atVector(past), now - past, step)
        if jacobians is not None:
            jacobians[0], jacobians[1] = -jacobian, STATE_JACOBIAN
        return np.asarray(values.atVector(now) - moved)

    return gtsam.CustomFactor(gtsam.noiseModel.Gaussian.Covariance(noise[0, -1]), [past, now], residual)


def pose_factor(frame: int, pose: Array, covariance: Array) -> Any:
    """The factor of a measured pose (3,), heading unwrapped, with its covariance (3, 3) and a Cauchy kernel."""

    def residual(_: Any, values: Any, jacobians: Any) -> Array:
        if jacobians is not None:
            jacobians[0] = POSE_JACOBIAN
        return np.asarray(values.atVector(frame)[:3] - pose)

    noise = gtsam.noiseModel.Gaussian.Covariance(covariance)
    kernel = gtsam.noiseModel.mEstimator.Cauchy.Create(CAUCHY_WIDTH)
    return gtsam.CustomFactor(gtsam.noiseModel.Robust.Create(kernel, noise), [frame], residual)


def linearisation_point(mean: Array, covariance: Array, pose: Array, pose_covariance: Array) -> Array:
    """The first linearisation point (6,) of the new state, which determines the initial weight of its measurement.

    Within the gate it is the estimate of the Kalman filter, near the measurement; beyond it the prediction, `mean` (6,)
    with `covariance` (6, 6), so that a gross error is rejected. The cost of a robust measurement far from the
    prediction has a minimum at each of the two.
    """
    innovation = pose - mean[:3]
    weighted = np.linalg.solve(covariance[:3, :3] + pose_covariance, innovation)
    return mean.copy() if innovation @ weighted > GATE else np.asarray(mean + weighted @ covariance[:3])


class FactorGraphTracker(ModelFreeTracker):
    """The pipeline with fixed-lag smoothers and robust measurements."""

    estimator = staticmethod(FactorGraphEstimator)

"""The fixed-lag smoother: equal to the Kalman filter without gross errors, better with them, and restartable."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

from gridtrack.trackers.model_free.factor_graph import LAG_S, FactorGraphEstimator
from gridtrack.trackers.model_free.kalman import KalmanEstimator
from gridtrack.trackers.model_free.motion import MotionModel, propagate

MODEL = MotionModel(
    acceleration=0.5,
    speed_noise=0.001,
    turn_acceleration=0.3,
    velocity_memory_s=5.0,
    turn_memory_s=2.0,
    initial_speed=2.0,
    initial_turn_rate=0.3,
    period_s=0.125,
)
LASER = np.diag([0.03, 0.03, 0.02]) ** 2


def circle(frames, speed=2.0, turn_rate=0.4):
    """True states (N, 6) on a circle, headings not wrapped."""
    angle = turn_rate * MODEL.period_s * np.arange(frames)
    place = speed / turn_rate * np.stack([np.sin(angle), 1 - np.cos(angle)], axis=1)
    velocity = speed * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.column_stack([place, angle, velocity, np.full(frames, turn_rate)])


def follow(estimator, poses):
    """Means (N, 6) and covariances (N, 6, 6) after each pose (N, 3)."""
    track = estimator(poses[0], LASER, MODEL)
    found = [(track.mean, track.covariance)]
    for pose in poses[1:]:
        track.predict()
        track.update(pose, LASER)
        found.append((track.mean, track.covariance))
    means, covariances = zip(*found, strict=True)
    return np.array(means), np.array(covariances)


def measured(truth, seed):
    return truth[:, :3] + np.random.default_rng(seed).multivariate_normal(np.zeros(3), LASER, len(truth))


def test_without_gross_errors_both_estimators_agree():
    truth = circle(60)
    for seed in range(10):
        poses = measured(truth, seed)
        kalman, smoothed = follow(KalmanEstimator, poses), follow(FactorGraphEstimator, poses)
        deviations = np.sqrt(np.diagonal(kalman[1], axis1=1, axis2=2))
        apart = np.abs(kalman[0] - smoothed[0])
        apart[:, 2] = np.minimum(apart[:, 2], 2 * np.pi - apart[:, 2])
        assert np.median(apart / deviations) < 0.1
        assert (apart / deviations).max() < 1.0
        ratio = np.diagonal(smoothed[1], axis1=1, axis2=2) / deviations**2
        assert 0.95 < np.median(ratio) < 1.15


def test_one_gross_error_in_twenty_measurements_hardly_moves_the_smoother():
    squares = {KalmanEstimator: [], FactorGraphEstimator: []}
    truth = circle(80)
    for seed in range(20):
        poses, rng = measured(truth, seed), np.random.default_rng(100 + seed)
        wrong = (rng.random(len(truth)) < 0.05) & (np.arange(len(truth)) > 3)
        poses[wrong, :2] += rng.uniform(-1.5, 1.5, (wrong.sum(), 2))
        for estimator, kept in squares.items():
            off = follow(estimator, poses)[0][8:] - truth[8:]
            kept.append([(off[:, :2] ** 2).sum(axis=1).mean(), (off[:, 3:5] ** 2).sum(axis=1).mean()])
    kalman, smoother = (np.sqrt(np.mean(kept, axis=0)) for kept in squares.values())
    assert smoother[0] < 0.5 * kalman[0]
    assert smoother[1] < 0.5 * kalman[1]


def test_the_smoother_converges_to_an_object_much_faster_than_expected():
    truth = circle(24, speed=8.0, turn_rate=0.01)
    means, _ = follow(FactorGraphEstimator, measured(truth, 0))
    assert np.hypot(*(means[-1] - truth[-1])[3:5]) < 0.7


def test_a_second_measurement_in_the_same_frame_sharpens_the_first():
    truth = circle(10)
    poses = measured(truth, 0)
    track = FactorGraphEstimator(poses[0], LASER, MODEL)
    track.update(poses[0], LASER)
    for pose in poses[1:]:
        track.predict()
        track.update(pose, LASER)
    before = track.covariance
    track.update(poses[-1], LASER)
    assert track.covariance[0, 0] < 0.8 * before[0, 0]
    assert track.restarts == 0


def test_the_graph_contains_only_the_states_within_its_lag():
    track = FactorGraphEstimator(np.zeros(3), LASER, MODEL)
    slots = []
    for frame in range(300):
        track.predict()
        if frame % 50 < 40:
            track.update(np.array([0.1 * frame, 0.0, 0.0]), LASER)
        slots.append(track._smoother.getFactors().size())
    states = LAG_S / MODEL.period_s + 2
    assert max(slots) <= 3 * states
    assert len(track._smoother.timestamps()) <= states


class Failing:
    """A smoother that raises the error of gtsam."""

    def update(self, *_):
        raise RuntimeError("Indeterminate linear system detected while working near variable 7")


class Unsound:
    """A smoother with a result that is not a number."""

    def update(self, *_):
        """Nothing."""

    def calculateEstimateVector(self, key):
        return np.full(6, np.nan)

    def marginalCovariance(self, key):
        return np.eye(6)


def without_prior():
    """An empty smoother of gtsam: the motion factor refers to an unknown state."""
    return gtsam.IncrementalFixedLagSmoother(LAG_S)


@pytest.mark.parametrize("broken", [Failing, Unsound, without_prior])
def test_after_a_failure_the_smoother_restarts_from_its_prediction_and_counts_it(broken):
    truth = circle(60)
    poses = measured(truth, 0)
    track = FactorGraphEstimator(poses[0], LASER, MODEL)
    for frame, pose in enumerate(poses[1:], 1):
        if frame == 20:
            means, covariances = propagate(track.mean[None], track.covariance[None], 1, MODEL)
            track._smoother = broken()
        track.predict()
        track.update(pose, LASER)
        if frame == 20:
            assert np.allclose(track.mean, means[0, 1])
            assert np.allclose(track.covariance, covariances[0, 1])
        assert track.restarts == (frame >= 20)
    assert np.hypot(*(track.mean - truth[-1])[:2]) < 0.1
    assert np.hypot(*(track.mean - truth[-1])[3:5]) < 0.5

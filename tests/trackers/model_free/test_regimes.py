"""Motion regimes: steady motion and manoeuvres are distinguished, each with its own accuracy."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("filterpy")
pytest.importorskip("gtsam")
from gridtrack.common.geometry import wrap_angle
from gridtrack.trackers.model_free.estimators import IMPROBABLE, SwitchingEstimator
from gridtrack.trackers.model_free.factor_graph import FactorGraphEstimator
from gridtrack.trackers.model_free.kalman import KalmanEstimator
from gridtrack.trackers.model_free.motion import MotionModel, Regimes

PERIOD_S = 0.125
STEADY = MotionModel(
    acceleration=0.06,
    speed_noise=0.04,
    turn_acceleration=0.04,
    velocity_memory_s=50.0,
    turn_memory_s=1.0,
    initial_speed=3.0,
    initial_turn_rate=0.1,
    period_s=PERIOD_S,
)
REGIMES = Regimes.of(STEADY, manoeuvre_noise=10.0, steady_duration_s=6.0, manoeuvre_duration_s=1.0, window_m=20.0)
NOISE = np.diag([0.08, 0.08, 0.05]) ** 2
ESTIMATORS = pytest.mark.parametrize("begin", [KalmanEstimator, FactorGraphEstimator])


def followed(begin, speeds, seed, gross=0.0):
    """After each frame the velocity estimate and P(steady) of an object that moves along x at `speeds`.

    The share `gross` of the poses after the first eight is anywhere within a metre.
    """
    random = np.random.default_rng(seed)
    x, seen = 0.0, []
    estimator = SwitchingEstimator(begin, np.zeros(3), NOISE, REGIMES)
    for speed in speeds:
        x += speed * PERIOD_S
        estimator.predict()
        pose = np.array([x, 0.0, 0.0]) + random.normal(0.0, np.sqrt(np.diag(NOISE)))
        if len(seen) >= 8 and random.random() < gross:
            pose[:2] += random.uniform(-1.0, 1.0, 2)
        estimator.update(pose, NOISE)
        seen.append((estimator.mean[3], estimator.probabilities[0]))
    return np.array(seen), estimator


def test_the_probabilities_of_switching_are_those_of_the_mean_durations():
    (stays, leaves), (settles, goes_on) = REGIMES.switching
    assert stays + leaves == pytest.approx(1.0)
    assert stays ** (6.0 / PERIOD_S) == pytest.approx(np.exp(-1))
    assert goes_on ** (1.0 / PERIOD_S) == pytest.approx(np.exp(-1))
    assert settles == pytest.approx(1.0 - goes_on)


@ESTIMATORS
def test_constant_velocity_is_steady_motion_and_braking_is_a_manoeuvre(begin):
    braking = np.concatenate([np.full(40, 6.0), np.maximum(6.0 - 3.0 * PERIOD_S * np.arange(1, 17), 0.0)])
    runs = np.array([followed(begin, braking, seed)[0] for seed in range(20)])
    assert runs[:, 30:40, 1].mean() > 0.8
    assert runs[:, 46:54, 1].mean() < 0.3


@ESTIMATORS
def test_the_velocity_in_steady_motion_has_a_smaller_error_than_with_the_manoeuvre_model_alone(begin):
    errors = {"switching": [], "agile": []}
    for seed in range(20):
        seen, estimator = followed(begin, np.full(48, 1.3), seed)
        errors["switching"].append(seen[-1, 0] - 1.3)
        errors["agile"].append(estimator.estimators[1].mean[3] - 1.3)
    switching, agile = (np.sqrt(np.mean(np.square(each))) for each in errors.values())
    assert switching < 0.6 * agile


@ESTIMATORS
def test_the_steady_estimator_recovers_after_braking(begin):
    speeds = np.concatenate([np.full(40, 6.0), np.maximum(6.0 - 3.0 * PERIOD_S * np.arange(1, 17), 0.0), np.zeros(32)])
    final = [followed(begin, speeds, seed) for seed in range(10)]
    assert np.mean([seen[-1, 1] for seen, _ in final]) > 0.7
    assert np.abs([estimator.estimators[0].mean[3] for _, estimator in final]).max() < 0.2


@ESTIMATORS
def test_an_improbable_regime_is_re_initialised_from_the_other(begin):
    estimator = SwitchingEstimator(begin, np.zeros(3), NOISE, REGIMES)
    x, disproved = 0.0, []
    for speed in [6.0] * 30 + [3.0] * 10:
        x += speed * PERIOD_S
        estimator.predict()
        estimator.update(np.array([x, 0.0, 0.0]), NOISE)
        if estimator.probabilities.min() < IMPROBABLE:
            one, other = estimator.estimators
            assert np.array_equal(one.mean, other.mean)
            assert np.array_equal(one.covariance, other.covariance)
            disproved.append(estimator.probabilities.argmin())
    assert 0 in disproved


@ESTIMATORS
def test_its_covariance_is_nearly_that_of_its_errors_on_objects_that_switch(begin):
    """Estimators without mixing are slightly overconfident: at most a sixth above the expected value of 6."""
    runs, frames, rng = 200, 30, np.random.default_rng(5)
    squared = []
    for _ in range(runs):
        truth = switching_walk(frames, rng)
        estimator = SwitchingEstimator(
            begin, truth[0, :3] + rng.multivariate_normal(np.zeros(3), NOISE), NOISE, REGIMES
        )
        for state in truth[1:]:
            estimator.predict()
            estimator.update(state[:3] + rng.multivariate_normal(np.zeros(3), NOISE), NOISE)
            off = estimator.mean - state
            off[2] = wrap_angle(off[2])
            squared.append(off @ np.linalg.solve(estimator.covariance, off))
    assert 5.5 < np.mean(squared) < 7.0


def switching_walk(frames, rng, substeps=10):
    """True states (frames, 6), drawn from the equations of both regimes and their transition probabilities."""
    state = rng.standard_normal(6) * [0, 0, 1, *[STEADY.initial_speed] * 2, STEADY.initial_turn_rate]
    regime, dt, kept = int(rng.random() < 1.0 / 7.0), PERIOD_S / substeps, [state]
    for _ in range(frames - 1):
        regime = int(rng.random() < REGIMES.switching[regime][1])
        model = REGIMES.models[regime]
        for _ in range(substeps):
            _, _, _, vx, vy, rate = state
            memory = -state[3:] / [*[model.velocity_memory_s] * 2, model.turn_memory_s]
            drift = np.array([vx, vy, rate, *(np.array([-rate * vy, rate * vx, 0.0]) + memory)])
            noise = rng.standard_normal(4) * np.sqrt(dt)
            state = state + drift * dt
            state[3:] += noise[:3] * [*[model.acceleration] * 2, model.turn_acceleration]
            state[3:5] += model.speed_noise * noise[3] * np.array([vx, vy])
        kept.append(state)
    return np.array(kept)


def test_a_gross_error_makes_the_steady_regime_improbable_for_a_kalman_filter_and_not_for_a_robust_smoother():
    squares = {
        begin: [np.square(followed(begin, np.full(72, 6.0), seed, gross=0.05)[0][16:, 0] - 6.0) for seed in range(10)]
        for begin in (KalmanEstimator, FactorGraphEstimator)
    }
    gaussian, robust = (np.sqrt(np.mean(each)) for each in squares.values())
    assert robust < 0.7 * gaussian


def test_mean_and_covariance_are_those_of_the_mixture():
    _, estimator = followed(KalmanEstimator, np.full(5, 2.0), 0)
    random = np.random.default_rng(1)
    parts = [
        random.multivariate_normal(each.mean, each.covariance, round(200_000 * p))
        for each, p in zip(estimator.estimators, estimator.probabilities, strict=True)
    ]
    samples = np.concatenate(parts)
    assert estimator.mean == pytest.approx(samples.mean(axis=0), abs=0.02)
    assert estimator.covariance == pytest.approx(np.cov(samples.T), abs=0.02)


def test_headings_near_pi_and_minus_pi_are_close():
    estimator = SwitchingEstimator(KalmanEstimator, np.zeros(3), NOISE, REGIMES)
    for each, heading in zip(estimator.estimators, (np.pi - 0.1, -np.pi + 0.1), strict=True):
        each.reinitialise(np.array([0.0, 0.0, heading, 0.0, 0.0, 0.0]), np.eye(6))
    estimator.predict()
    assert abs(abs(estimator.mean[2]) - np.pi) < 0.1
    assert estimator.covariance[2, 2] < 1.2


SEARCHED = Regimes.of(
    STEADY._replace(speed_noise=0.24, turn_acceleration=0.38, velocity_memory_s=3.7, initial_speed=3.7),
    manoeuvre_noise=35.0,
    steady_duration_s=1.1,
    manoeuvre_duration_s=2.1,
    window_m=20.0,
)
"""Much noise, within the ranges of the search."""


def test_an_estimator_that_diverges_begins_anew_from_the_measurement():
    """A vehicle, often not measured along its side, with wrong headings: its speed once grew to 10^15 m/s."""
    random = np.random.default_rng(0)
    side = np.diag([2.0, 0.0, 0.0]) ** 2
    estimator = SwitchingEstimator(KalmanEstimator, np.zeros(3), NOISE, SEARCHED)
    for frame in range(1, 400):
        estimator.predict()
        pose = np.array([8.0 * PERIOD_S * frame, 0.0, 0.0]) + 3.0 * random.normal(0.0, np.sqrt(np.diag(NOISE)))
        if random.random() < 0.1:
            pose[2] += random.normal()
        estimator.update(pose, NOISE + side if random.random() < 0.3 else NOISE)
        for one in estimator.estimators:
            assert np.hypot(*(one.mean[:2] - pose[:2])) < 10.0
            assert np.hypot(*one.mean[3:5]) <= SEARCHED.limits.speed
            assert np.linalg.eigvalsh(one.covariance).min() > 0.0
    assert 0 < estimator.restarts < 40


@ESTIMATORS
@pytest.mark.parametrize(("index", "value"), [(0, 1e18), (1, -60.0), (3, 1e6), (5, 30.0)])
def test_a_state_that_the_window_does_not_allow_is_that_of_the_measurement_with_an_unknown_velocity(
    begin, index, value
):
    _, estimator = followed(begin, np.full(40, 1.3), seed=0)
    diverged = estimator.mean.copy()
    diverged[index] += value
    estimator.reinitialise(diverged, estimator.covariance)
    pose = np.array([5.3, 0.0, 0.0])
    estimator.update(pose, NOISE)
    assert estimator.mean == pytest.approx([*pose, 0.0, 0.0, 0.0])
    assert np.sqrt(estimator.covariance[3, 3]) == pytest.approx(STEADY.initial_speed)
    assert estimator.restarts == 2
    for frame in range(1, 17):
        estimator.predict()
        estimator.update(pose + np.array([1.3 * PERIOD_S * frame, 0.0, 0.0]), NOISE)
    assert estimator.mean[3:5] == pytest.approx([1.3, 0.0], abs=0.1)
    assert estimator.restarts == 2

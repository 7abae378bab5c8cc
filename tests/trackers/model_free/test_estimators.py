"""State estimators on objects of known motion: errors, covariances, gross errors, and the switching of regimes."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from scipy.stats import chi2

from gridtrack.common.geometry import wrap_angle
from gridtrack.trackers.model_free.estimators import IMPROBABLE, SwitchingEstimator
from gridtrack.trackers.model_free.factor_graph import LAG_S, FactorGraphEstimator
from gridtrack.trackers.model_free.kalman import KalmanEstimator
from gridtrack.trackers.model_free.motion import MotionModel, Regimes, propagate
from tests.trackers.model_free.test_motion import simulate

PERIOD_S = 0.125


def model(acceleration, speed_noise, turn_acceleration, velocity_memory_s, turn_memory_s, speed, turn_rate):
    """A motion model; `speed` and `turn_rate` are standard deviations for a new track."""
    noises = acceleration, speed_noise, turn_acceleration
    return MotionModel(*noises, velocity_memory_s, turn_memory_s, speed, turn_rate, PERIOD_S)


MODEL = model(0.1, 0.001, 0.1, 100.0, 5.0, 3.0, 0.3)
AGILE = model(0.7, 0.001, 0.4, 4.0, 2.0, 2.0, 0.3)
MIXED = model(0.5, 0.001, 0.3, 5.0, 2.0, 2.0, 0.3)
STEADY = model(0.06, 0.04, 0.04, 50.0, 1.0, 3.0, 0.1)
REGIMES = Regimes.of(STEADY, manoeuvre_noise=10.0, steady_duration_s=6.0, manoeuvre_duration_s=1.0, window_m=20.0)
LASER = np.diag([0.03, 0.03, 0.02]) ** 2
"""Covariance of a pose measured from raw returns, metres and radians."""
NOISE = np.diag([0.08, 0.08, 0.05]) ** 2


@pytest.fixture(params=[KalmanEstimator, FactorGraphEstimator])
def begin(request):
    return request.param


def moving(frames, speed, turn_rate, heading=0.0):
    """True states (frames, 6) of an object on a circle or a straight line."""
    time = np.arange(frames) * PERIOD_S
    angle = heading + turn_rate * time
    velocity = speed * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    place = velocity[:1] * time[:, None]
    if turn_rate:
        place = speed / turn_rate * np.stack([np.sin(angle), -np.cos(angle)], axis=1)
    return np.column_stack([place, [wrap_angle(a) for a in angle], velocity, np.full(frames, turn_rate)])


def walks(model, runs, frames, rng):
    """True states (runs, frames, 6) drawn from the differential equations of the model."""
    states = [rng.standard_normal((runs, 6)) * ([0, 0, 1] + [model.initial_speed] * 2 + [model.initial_turn_rate])]
    for _ in range(frames - 1):
        states.append(simulate(states[-1], PERIOD_S, model, rng, 10))
    return np.stack(states, axis=1)


def measurements(truth, covariance, rng):
    """Measured poses (N, 3) of true states (N, 6), headings wrapped."""
    poses = truth[:, :3] + rng.multivariate_normal(np.zeros(3), covariance, len(truth))
    poses[:, 2] = (poses[:, 2] + np.pi) % (2 * np.pi) - np.pi
    return poses


def follow(begin, poses, covariance, model=MODEL):
    """Means (N, 6) and covariances (N, 6, 6) after each pose (N, 3)."""
    track = begin(poses[0], covariance, model)
    means, covariances = [track.mean], [track.covariance]
    for pose in poses[1:]:
        track.predict()
        track.update(pose, covariance)
        means.append(track.mean)
        covariances.append(track.covariance)
    return np.array(means), np.array(covariances)


def error(means, truth):
    """Estimate minus truth (..., 6), with the heading difference wrapped."""
    off = means - truth
    off[..., 2] = (off[..., 2] + np.pi) % (2 * np.pi) - np.pi
    return off


@pytest.mark.parametrize("moving_as", [MODEL, AGILE], ids=["steady", "agile"])
def test_its_covariance_is_the_covariance_of_its_errors(begin, moving_as):
    runs, frames, rng = 80, 30, np.random.default_rng(5)
    squared = np.empty((runs, frames))
    for run, truth in enumerate(walks(moving_as, runs, frames, rng)):
        means, covariances = follow(begin, measurements(truth, LASER, rng), LASER, moving_as)
        off = error(means, truth)
        squared[run] = np.einsum("ni,nij,nj->n", off, np.linalg.inv(covariances), off)
    low, high = chi2.ppf([0.025, 0.975], 6 * runs) / runs
    by_frame = squared.mean(axis=0)
    assert np.mean((low < by_frame) & (by_frame < high)) >= 0.8, by_frame
    assert low < by_frame.mean() < high


def test_a_heading_is_followed_over_pi(begin):
    truth, rng = moving(97, 2.0, 0.8, heading=0.3), np.random.default_rng(0)
    means, _ = follow(begin, measurements(truth, LASER, rng), LASER)
    assert (np.abs(means[:, 2]) <= np.pi).all()
    assert np.ptp(truth[:, 2]) > 6.0
    assert np.abs(error(means, truth)[16:, [2, 5]]).max() < 0.15


def test_an_unobserved_direction_keeps_its_prediction(begin):
    """A wall along its length: the position across it is observed, along it is not."""
    truth, rng = moving(33, 1.0, 0.0, heading=0.5), np.random.default_rng(0)
    along, across = np.array([np.cos(0.5), np.sin(0.5)]), np.array([-np.sin(0.5), np.cos(0.5)])
    blind = LASER.copy()
    blind[:2, :2] = 1e3 * np.outer(along, along) + 0.03**2 * np.outer(across, across)
    track = begin(truth[0, :3], LASER, MODEL)
    for frame, state in enumerate(truth[1:], 1):
        track.predict()
        predicted, spread = track.mean, track.covariance
        pose = measurements(state[None], LASER, rng)[0]
        if frame <= 16:
            track.update(pose, LASER)
            continue
        pose[:2] += 2.0 * along
        track.update(pose, blind)
        assert abs((track.mean - predicted)[:2] @ along) < 0.01
        assert along @ track.covariance[:2, :2] @ along == pytest.approx(along @ spread[:2, :2] @ along, rel=0.05)
        assert np.sqrt(across @ track.covariance[:2, :2] @ across) < 0.03
    assert abs((track.mean - state)[:2] @ across) < 0.1


def test_an_object_is_re_acquired_after_two_seconds_without_measurements(begin):
    truth, rng = moving(49, 2.0, 0.2, heading=0.3), np.random.default_rng(0)
    poses = measurements(truth, LASER, rng)
    track = begin(poses[0], LASER, AGILE)
    spreads = []
    for frame, pose in enumerate(poses[1:], 1):
        track.predict()
        if not 16 <= frame < 32:
            track.update(pose, LASER)
        spreads.append(np.sqrt(track.covariance[0, 0]))
        if frame == 31:
            lost = error(track.mean, truth[frame])
            assert lost @ np.linalg.inv(track.covariance) @ lost < chi2.ppf(0.999, 6)
    assert spreads[30] > 10 * spreads[14]
    assert np.hypot(*error(track.mean, truth[-1])[:2]) < 0.1
    assert np.hypot(*error(track.mean, truth[-1])[3:5]) < 0.5
    assert track.restarts == 0


def test_a_measurement_is_accepted_after_a_minute_without_any(begin):
    track = begin(np.zeros(3), LASER, MODEL)
    for _ in range(480):
        track.predict()
    assert np.isfinite(track.covariance).all()
    track.update(np.array([3.0, -2.0, 1.0]), LASER)
    assert np.allclose(track.mean[:3], [3.0, -2.0, 1.0], atol=0.01)
    assert track.restarts == 0


INDEFINITE = np.diag([1.0, 1.0, -1.0])
ASYMMETRIC = np.array([[1.0, 0.1, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize(
    ("pose", "covariance", "complaint"),
    [
        ([0.0, np.nan, 0.0], LASER, "measured pose"),
        ([0.0, 0.0], LASER, "measured pose"),
        ([0.0, 0.0, 0.0], np.full((3, 3), np.nan), "positive definite"),
        ([0.0, 0.0, 0.0], np.diag([np.inf, 1.0, 1.0]), "positive definite"),
        ([0.0, 0.0, 0.0], np.zeros((3, 3)), "positive definite"),
        ([0.0, 0.0, 0.0], INDEFINITE, "positive definite"),
        ([0.0, 0.0, 0.0], ASYMMETRIC, "positive definite"),
        ([0.0, 0.0, 0.0], np.eye(2), "positive definite"),
    ],
)
def test_an_invalid_measurement_is_refused_and_changes_nothing(begin, pose, covariance, complaint):
    track = begin(np.zeros(3), LASER, MODEL)
    track.predict()
    mean, spread = track.mean.copy(), track.covariance.copy()
    with pytest.raises(ValueError, match=complaint):
        track.update(np.array(pose), covariance)
    with pytest.raises(ValueError, match=complaint):
        begin(np.array(pose), covariance, MODEL)
    assert np.array_equal(track.mean, mean)
    assert np.array_equal(track.covariance, spread)


def measured(truth, seed):
    return measurements(truth, LASER, np.random.default_rng(seed))


def test_without_gross_errors_both_estimators_agree():
    truth = moving(60, 2.0, 0.4)
    for seed in range(4):
        poses = measured(truth, seed)
        kalman, smoothed = (
            follow(KalmanEstimator, poses, LASER, MIXED),
            follow(FactorGraphEstimator, poses, LASER, MIXED),
        )
        deviations = np.sqrt(np.diagonal(kalman[1], axis1=1, axis2=2))
        apart = np.abs(kalman[0] - smoothed[0])
        apart[:, 2] = np.minimum(apart[:, 2], 2 * np.pi - apart[:, 2])
        assert np.median(apart / deviations) < 0.1
        assert (apart / deviations).max() < 1.0
        ratio = np.diagonal(smoothed[1], axis1=1, axis2=2) / deviations**2
        assert 0.95 < np.median(ratio) < 1.15


def test_one_gross_error_in_twenty_measurements_hardly_moves_the_smoother():
    squares = {KalmanEstimator: [], FactorGraphEstimator: []}
    truth = moving(80, 2.0, 0.4)
    for seed in range(8):
        poses, rng = measured(truth, seed), np.random.default_rng(100 + seed)
        wrong = (rng.random(len(truth)) < 0.05) & (np.arange(len(truth)) > 3)
        poses[wrong, :2] += rng.uniform(-1.5, 1.5, (wrong.sum(), 2))
        for begin, kept in squares.items():
            off = follow(begin, poses, LASER, MIXED)[0][8:] - truth[8:]
            kept.append([(off[:, :2] ** 2).sum(axis=1).mean(), (off[:, 3:5] ** 2).sum(axis=1).mean()])
    kalman, smoother = (np.sqrt(np.mean(kept, axis=0)) for kept in squares.values())
    assert smoother[0] < 0.5 * kalman[0]
    assert smoother[1] < 0.5 * kalman[1]


def test_the_smoother_converges_to_an_object_much_faster_than_expected():
    truth = moving(24, 8.0, 0.01)
    means, _ = follow(FactorGraphEstimator, measured(truth, 0), LASER, MIXED)
    assert np.hypot(*(means[-1] - truth[-1])[3:5]) < 0.7


def test_a_second_measurement_in_the_same_frame_sharpens_the_first():
    truth = moving(10, 2.0, 0.4)
    poses = measured(truth, 0)
    track = FactorGraphEstimator(poses[0], LASER, MIXED)
    track.update(poses[0], LASER)
    for pose in poses[1:]:
        track.predict()
        track.update(pose, LASER)
    before = track.covariance
    track.update(poses[-1], LASER)
    assert track.covariance[0, 0] < 0.8 * before[0, 0]
    assert track.restarts == 0


def test_the_graph_contains_only_the_states_within_its_lag():
    track = FactorGraphEstimator(np.zeros(3), LASER, MIXED)
    slots = []
    for frame in range(300):
        track.predict()
        if frame % 50 < 40:
            track.update(np.array([0.1 * frame, 0.0, 0.0]), LASER)
        slots.append(track._smoother.getFactors().size())
    states = LAG_S / PERIOD_S + 2
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
    truth = moving(60, 2.0, 0.4)
    poses = measured(truth, 0)
    track = FactorGraphEstimator(poses[0], LASER, MIXED)
    for frame, pose in enumerate(poses[1:], 1):
        if frame == 20:
            means, covariances = propagate(track.mean[None], track.covariance[None], 1, MIXED)
            track._smoother = broken()
        track.predict()
        track.update(pose, LASER)
        if frame == 20:
            assert np.allclose(track.mean, means[0, 1])
            assert np.allclose(track.covariance, covariances[0, 1])
        assert track.restarts == (frame >= 20)
    assert np.hypot(*(track.mean - truth[-1])[:2]) < 0.1
    assert np.hypot(*(track.mean - truth[-1])[3:5]) < 0.5


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


def test_the_probabilities_of_switching_follow_from_the_mean_durations():
    (stays, leaves), (settles, goes_on) = REGIMES.switching
    assert stays + leaves == pytest.approx(1.0)
    assert stays ** (6.0 / PERIOD_S) == pytest.approx(np.exp(-1))
    assert goes_on ** (1.0 / PERIOD_S) == pytest.approx(np.exp(-1))
    assert settles == pytest.approx(1.0 - goes_on)


def test_constant_velocity_is_steady_motion_and_braking_is_a_manoeuvre(begin):
    braking = np.concatenate([np.full(40, 6.0), np.maximum(6.0 - 3.0 * PERIOD_S * np.arange(1, 17), 0.0)])
    runs = np.array([followed(begin, braking, seed)[0] for seed in range(8)])
    assert runs[:, 30:40, 1].mean() > 0.8
    assert runs[:, 46:54, 1].mean() < 0.3


def test_the_velocity_in_steady_motion_has_a_smaller_error_than_with_the_manoeuvre_model_alone(begin):
    errors = {"switching": [], "agile": []}
    for seed in range(20):
        seen, estimator = followed(begin, np.full(48, 1.3), seed)
        errors["switching"].append(seen[-1, 0] - 1.3)
        errors["agile"].append(estimator.estimators[1].mean[3] - 1.3)
    switching, agile = (np.sqrt(np.mean(np.square(each))) for each in errors.values())
    assert switching < 0.6 * agile


def test_the_steady_estimator_recovers_after_braking(begin):
    speeds = np.concatenate([np.full(40, 6.0), np.maximum(6.0 - 3.0 * PERIOD_S * np.arange(1, 17), 0.0), np.zeros(32)])
    final = [followed(begin, speeds, seed) for seed in range(10)]
    assert np.mean([seen[-1, 1] for seen, _ in final]) > 0.7
    assert np.abs([estimator.estimators[0].mean[3] for _, estimator in final]).max() < 0.2


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


def test_its_covariance_is_nearly_right_on_objects_that_switch(begin):
    """Estimators without mixing are slightly overconfident: at most a sixth above the expected value of 6."""
    runs, frames, rng = 80, 30, np.random.default_rng(5)
    squared = []
    for _ in range(runs):
        truth = switching_walk(frames, rng)
        estimator = SwitchingEstimator(
            begin, truth[0, :3] + rng.multivariate_normal(np.zeros(3), NOISE), NOISE, REGIMES
        )
        for state in truth[1:]:
            estimator.predict()
            estimator.update(state[:3] + rng.multivariate_normal(np.zeros(3), NOISE), NOISE)
            off = error(estimator.mean, state)
            squared.append(off @ np.linalg.solve(estimator.covariance, off))
    assert 5.5 < np.mean(squared) < 7.0


def switching_walk(frames, rng):
    """True states (frames, 6), drawn from the equations of both regimes and their transition probabilities."""
    states, regime = [walks(STEADY, 1, 1, rng)[:, 0]], int(rng.random() < 1.0 / 7.0)
    for _ in range(frames - 1):
        regime = int(rng.random() < REGIMES.switching[regime][1])
        states.append(simulate(states[-1], PERIOD_S, REGIMES.models[regime], rng, 10))
    return np.concatenate(states)


def test_a_gross_error_makes_the_steady_regime_improbable_for_a_kalman_filter_and_not_for_a_robust_smoother():
    squares = {
        begin: [np.square(followed(begin, np.full(72, 6.0), seed, gross=0.05)[0][16:, 0] - 6.0) for seed in range(10)]
        for begin in (KalmanEstimator, FactorGraphEstimator)
    }
    gaussian, robust = (np.sqrt(np.mean(each)) for each in squares.values())
    assert robust < 0.7 * gaussian


def test_mean_and_covariance_are_the_mixtures():
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


@pytest.mark.parametrize(("index", "value"), [(0, 1e18), (1, -60.0), (3, 1e6), (5, 30.0)])
def test_a_state_outside_the_limits_is_replaced_by_the_measurement_with_an_unknown_velocity(begin, index, value):
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

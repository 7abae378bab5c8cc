"""State estimators on objects of known motion: their errors and their covariances."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from gridtrack.common.geometry import wrap_angle
from gridtrack.trackers.model_free.estimators import warm_up
from gridtrack.trackers.model_free.factor_graph import FactorGraphEstimator
from gridtrack.trackers.model_free.kalman import KalmanEstimator
from gridtrack.trackers.model_free.motion import MotionModel

PERIOD_S = 0.125
MODEL = MotionModel(
    acceleration=0.1,
    speed_noise=0.001,
    turn_acceleration=0.1,
    velocity_memory_s=100.0,
    turn_memory_s=5.0,
    initial_speed=3.0,
    initial_turn_rate=0.3,
    period_s=PERIOD_S,
)
AGILE = MotionModel(
    acceleration=0.7,
    speed_noise=0.001,
    turn_acceleration=0.4,
    velocity_memory_s=4.0,
    turn_memory_s=2.0,
    initial_speed=2.0,
    initial_turn_rate=0.3,
    period_s=PERIOD_S,
)
LASER, GRID = np.diag([0.03, 0.03, 0.02]) ** 2, np.diag([0.06, 0.06, 0.04]) ** 2
"""Covariance of a pose measured from raw returns, and of one from cells of 0.1 m; metres and radians."""


@pytest.fixture(params=[KalmanEstimator, FactorGraphEstimator])
def estimator(request):
    return request.param


def moving(seconds, speed, turn_rate, heading=0.3):
    """True states (N, 6) of an object on a circle or a straight line."""
    time = np.arange(round(seconds / PERIOD_S) + 1) * PERIOD_S
    angle = heading + turn_rate * time
    velocity = speed * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    place = velocity[:1] * time[:, None]
    if turn_rate:
        place = speed / turn_rate * np.stack([np.sin(angle), -np.cos(angle)], axis=1)
    return np.column_stack([place, [wrap_angle(a) for a in angle], velocity, np.full(len(time), turn_rate)])


def walks(model, runs, frames, rng, substeps=10):
    """True states (runs, frames, 6) drawn from the model's own differential equations in small steps."""
    states = rng.standard_normal((runs, 6)) * ([0, 0, 1] + [model.initial_speed] * 2 + [model.initial_turn_rate])
    dt, kept = PERIOD_S / substeps, [states]
    for _ in range(frames - 1):
        for _ in range(substeps):
            _, _, _, vx, vy, rate = states.T
            memory = -states[:, 3:] / ([model.velocity_memory_s] * 2 + [model.turn_memory_s])
            drift = np.column_stack([vx, vy, rate, -rate * vy, rate * vx, np.zeros(runs)])
            drift[:, 3:] += memory
            noise = rng.standard_normal((runs, 3)) * ([model.acceleration] * 2 + [model.turn_acceleration])
            states = states + drift * dt
            states[:, 3:] += noise * np.sqrt(dt)
        kept.append(states)
    return np.stack(kept, axis=1)


def measurements(truth, covariance, rng):
    """Measured poses (N, 3) of true states (N, 6), headings wrapped."""
    poses = truth[:, :3] + rng.multivariate_normal(np.zeros(3), covariance, len(truth))
    poses[:, 2] = (poses[:, 2] + np.pi) % (2 * np.pi) - np.pi
    return poses


def follow(estimator, poses, covariance, model=MODEL):
    """Means (N, 6) and covariances (N, 6, 6) after each pose (N, 3)."""
    track = estimator(poses[0], covariance, model)
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


@pytest.mark.parametrize(("covariance", "limit"), [(LASER, 0.1), (GRID, 0.2)], ids=["laser", "grid"])
@pytest.mark.parametrize(("speed", "turn_rate"), [(1.5, 0.0), (8.0, 0.0), (1.5, 0.4), (5.0, 0.3)])
def test_after_a_second_the_velocity_is_known(estimator, covariance, limit, speed, turn_rate):
    rng, truth = np.random.default_rng(0), moving(1.0, speed, turn_rate)
    ends = [follow(estimator, measurements(truth, covariance, rng), covariance)[0][-1] for _ in range(100)]
    off = error(np.array(ends), truth[-1])[:, 3:5]
    assert np.sqrt((off**2).sum(axis=1).mean()) <= limit


@pytest.mark.parametrize("model", [MODEL, AGILE], ids=["steady", "agile"])
def test_its_covariance_is_that_of_its_errors(estimator, model):
    runs, frames, rng = 200, 30, np.random.default_rng(5)
    squared = np.empty((runs, frames))
    for run, truth in enumerate(walks(model, runs, frames, rng)):
        means, covariances = follow(estimator, measurements(truth, LASER, rng), LASER, model)
        off = error(means, truth)
        squared[run] = np.einsum("ni,nij,nj->n", off, np.linalg.inv(covariances), off)
    low, high = chi2.ppf([0.025, 0.975], 6 * runs) / runs
    by_frame = squared.mean(axis=0)
    assert np.mean((low < by_frame) & (by_frame < high)) >= 0.8, by_frame
    assert low < by_frame.mean() < high


def test_a_heading_is_followed_over_pi(estimator):
    truth, rng = moving(12.0, 2.0, 0.8), np.random.default_rng(0)
    means, _ = follow(estimator, measurements(truth, LASER, rng), LASER)
    assert (np.abs(means[:, 2]) <= np.pi).all()
    assert np.ptp(truth[:, 2]) > 6.0
    assert np.abs(error(means, truth)[16:, [2, 5]]).max() < 0.15


def test_an_unobserved_direction_keeps_its_prediction(estimator):
    """A wall along its length: the position across it is observed, along it is not."""
    truth, rng = moving(4.0, 1.0, 0.0, heading=0.5), np.random.default_rng(0)
    along, across = np.array([np.cos(0.5), np.sin(0.5)]), np.array([-np.sin(0.5), np.cos(0.5)])
    blind = LASER.copy()
    blind[:2, :2] = 1e3 * np.outer(along, along) + 0.03**2 * np.outer(across, across)
    track = estimator(truth[0, :3], LASER, MODEL)
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


def test_an_object_is_re_acquired_after_two_seconds_without_measurements(estimator):
    truth, rng = moving(6.0, 2.0, 0.2), np.random.default_rng(0)
    poses = measurements(truth, LASER, rng)
    track = estimator(poses[0], LASER, AGILE)
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


def test_a_measurement_is_accepted_after_a_minute_without_any(estimator):
    track = estimator(np.zeros(3), LASER, MODEL)
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
def test_an_invalid_measurement_is_refused_and_changes_nothing(estimator, pose, covariance, complaint):
    track = estimator(np.zeros(3), LASER, MODEL)
    track.predict()
    mean, spread = track.mean.copy(), track.covariance.copy()
    with pytest.raises(ValueError, match=complaint):
        track.update(np.array(pose), covariance)
    with pytest.raises(ValueError, match=complaint):
        estimator(np.array(pose), covariance, MODEL)
    assert np.array_equal(track.mean, mean)
    assert np.array_equal(track.covariance, spread)


def test_warm_up_runs_every_function_once(estimator):
    warm_up(estimator, MODEL)

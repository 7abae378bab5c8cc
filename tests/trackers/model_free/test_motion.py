"""The motion model: its discretisation against fine simulation, numerical differentiation and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from filterpy.common import van_loan_discretization

from gridtrack.trackers.model_free.motion import MotionModel, discretise, propagate, propagate_all, transition

MODEL = MotionModel(
    acceleration=0.8,
    speed_noise=0.1,
    turn_acceleration=0.6,
    velocity_memory_s=4.0,
    turn_memory_s=1.5,
    initial_speed=2.0,
    initial_turn_rate=0.5,
    period_s=0.125,
)
TURNING = np.array([1.0, -2.0, 3.0, 6.0, 4.0, 1.2])
NOTHING = np.zeros((1, 6, 6))


def simulate(states, seconds, model, rng, substeps):
    """Euler-Maruyama: states (S, 6) after `seconds`, straight from the differential equations."""
    dt = seconds / substeps
    memory = np.array([model.velocity_memory_s, model.velocity_memory_s, model.turn_memory_s])
    for _ in range(substeps):
        _, _, _, vx, vy, rate = states.T
        drift = np.stack([vx, vy, rate, -rate * vy, rate * vx, np.zeros(len(states))], axis=1)
        drift[:, 3:] -= states[:, 3:] / memory
        noise = np.zeros_like(states)
        noise[:, 3:5] = model.acceleration * rng.standard_normal((len(states), 2))
        noise[:, 5] = model.turn_acceleration * rng.standard_normal(len(states))
        noise[:, 3:5] += model.speed_noise * rng.standard_normal((len(states), 1)) * states[:, 3:5]
        states = states + drift * dt + noise * np.sqrt(dt)
    return states


def test_mean_and_noise_of_one_period_follow_from_the_differential_equations():
    samples = simulate(np.tile(TURNING, (20_000, 1)), MODEL.period_s, MODEL, np.random.default_rng(0), 100)
    means, covariances = propagate(TURNING[None], NOTHING, 1, MODEL)
    spread = samples.std(axis=0)
    off = (covariances[0, 1] - np.cov(samples.T)) / np.outer(spread, spread)
    assert np.allclose(means[0, 1], samples.mean(axis=0), atol=5 * spread.max() / 20_000**0.5)
    assert np.abs(off).max() < 0.06  # how far the noise itself turns within the period is left out


def test_the_mean_follows_a_turning_object_for_a_second():
    still = MODEL._replace(acceleration=1e-9, speed_noise=1e-9, turn_acceleration=1e-9)
    (truth,) = simulate(TURNING[None], 1.0, still, np.random.default_rng(0), 20_000)
    means, _ = propagate(TURNING[None], NOTHING, 8, MODEL)
    assert np.allclose(means[0, 8], truth, atol=1e-3)


def test_a_turn_with_infinite_correlation_times_is_a_circle():
    endless = MODEL._replace(velocity_memory_s=1e6, turn_memory_s=1e6)
    means, _ = propagate(np.array([[0.0, 0.0, 0.0, 2.0, 0.0, 0.5]]), NOTHING, 40, endless)
    angle = 0.5 * 0.125 * np.arange(41)
    assert np.allclose(means[0, :, :2], 4.0 * np.stack([np.sin(angle), 1.0 - np.cos(angle)], axis=1), atol=1e-4)
    assert np.allclose(means[0, :, 2], angle, atol=1e-4)


@pytest.mark.parametrize("steps", [1, 3])
def test_the_derivative_is_the_numerical_one(steps):
    step = discretise(MODEL)
    _, jacobian = transition(TURNING, steps, step)
    nudges = 1e-6 * np.eye(6)
    ahead = [transition(TURNING + nudge, steps, step)[0] for nudge in nudges]
    behind = [transition(TURNING - nudge, steps, step)[0] for nudge in nudges]
    assert np.allclose(jacobian, (np.array(ahead) - np.array(behind)).T / 2e-6, atol=1e-8)


def test_at_rest_the_model_is_linear_and_agrees_with_van_loan():
    drift, noise = np.zeros((6, 6)), np.zeros((6, 3))
    drift[:3, 3:] = np.eye(3)
    drift[3:, 3:] = -np.diag([1 / MODEL.velocity_memory_s] * 2 + [1 / MODEL.turn_memory_s])
    noise[3:] = np.diag([MODEL.acceleration] * 2 + [MODEL.turn_acceleration])
    expected, added = van_loan_discretization(drift, noise, MODEL.period_s)
    standing = np.array([3.0, 4.0, 1.0, 0.0, 0.0, 0.0])
    moved, jacobian = transition(standing, 1, discretise(MODEL))
    _, covariances = propagate(standing[None], NOTHING, 1, MODEL)
    assert np.allclose(moved, standing)
    assert np.allclose(jacobian, expected, atol=1e-12)
    assert np.allclose(covariances[0, 1], added, atol=1e-12)


def test_the_prediction_of_all_tracks_equals_predictions_of_each_step_by_step():
    rng = np.random.default_rng(1)
    means = rng.standard_normal((4, 6))
    factors = rng.standard_normal((4, 6, 6))
    covariances = factors @ factors.transpose(0, 2, 1)
    means_ahead, covariances_ahead = propagate(means, covariances, 5, MODEL)
    assert means_ahead.shape == (4, 6, 6)
    assert covariances_ahead.shape == (4, 6, 6, 6)
    step = discretise(MODEL)
    for track in range(4):
        mean, covariance = means[track], covariances[track]
        for n in range(5):
            assert np.allclose(means_ahead[track, n], mean)
            assert np.allclose(covariances_ahead[track, n], covariance)
            noise = propagate_all(mean[None], NOTHING, 1, step)[1][0, 1]
            mean, jacobian = transition(mean, 1, step)
            covariance = jacobian @ covariance @ jacobian.T + noise


@pytest.mark.parametrize("wrong", [0.0, -1.0, np.inf, np.nan])
def test_a_model_with_a_number_that_is_not_positive_and_finite_is_refused_by_name(wrong):
    with pytest.raises(ValueError, match="turn_memory_s"):
        discretise(MODEL._replace(turn_memory_s=wrong))

"""The spread between trainings against hand-computed cases, a two-way analysis of variance, and simulated trainings."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import t as student

from gridtrack.evaluation.regression.spread import beyond_spread
from gridtrack.evaluation.statistics.training_spread import PRIOR_FREEDOM, Spread, spread_between


def trainings_of(recalls, occupied=100_000.0):
    """2 TP and 2 TP + FN (K, U, R, 2) of units with the same occupied cells, recalls (K, U, R) and no false alarm."""
    tp = occupied * np.asarray(recalls, float)
    return np.stack([2 * tp, tp + occupied], axis=-1)


def drawn(rng, trainings, units, between, within):
    """Recalls (K, U, R) with the standard deviations `between` (R,) trainings and `within` (R,), between units."""
    level = between * rng.standard_normal((trainings, 1, len(between)))
    return 0.5 + level + within * rng.standard_normal((trainings, units, len(between)))


def test_with_one_row_the_spread_is_the_plain_standard_deviation_of_f1():
    trainings = trainings_of(drawn(np.random.default_rng(0), 3, 20, np.array([0.01]), np.array([0.01])))
    part, whole = np.moveaxis(trainings.sum(axis=1), -1, 0)
    f1 = part / whole
    assert spread_between(trainings).deviation == pytest.approx(np.std(f1, axis=0, ddof=1))


def test_rows_are_shrunk_towards_the_mean_ratio_of_the_two_variances_of_a_two_way_table():
    # recalls near 1/2 without false alarms: F1 = 2r / (1 + r) is as good as linear in so small deviations
    rng = np.random.default_rng(1)
    scale = 1e-4
    recalls = drawn(rng, 4, 25, scale * np.array([3.0, 0.1, 10.0]), scale * np.array([1.0, 2.0, 3.0]))
    slope = 2 / 1.5**2
    between = slope**2 * recalls.mean(axis=1).var(axis=0, ddof=1)
    left = recalls - recalls.mean(axis=0) - recalls.mean(axis=1, keepdims=True) + recalls.mean(axis=(0, 1))
    within = slope**2 * (left**2).sum(axis=(0, 1)) / (3 * 24) / 25
    ratio = between / within
    expected = within * (PRIOR_FREEDOM * ratio.mean() + 3 * ratio) / (PRIOR_FREEDOM + 3)
    np.testing.assert_allclose(spread_between(trainings_of(recalls)).deviation ** 2, expected, rtol=5e-3)


def test_p_is_students_t_of_one_more_training_times_the_family():
    spread = Spread(np.array([0.01, 0.01, 0.0, 0.0]), trainings=3, freedom=4.5)
    p = beyond_spread(np.array([0.08, -0.01, 0.001, 0.0]), spread, family=4)
    error = 0.01 * np.sqrt(1 + 1 / 3)
    assert p[0] == pytest.approx(4 * student.sf(0.08 / error, 4.5))
    assert p[1:].tolist() == [1.0, 0.0, 1.0]


@pytest.mark.parametrize("trainings", [2, 3, 5])
def test_the_error_rate_of_one_more_training_is_near_the_level(trainings):
    # rows of different spread with correlated changes: the most difficult case for pooling over rows
    rng = np.random.default_rng(trainings)
    called, draws = 0, 400
    for _ in range(draws):
        common, own = (rng.standard_normal((trainings + 1, 1, rows)) for rows in (1, 4))
        level = np.array([0.002, 0.004, 0.008, 0.003]) * (0.8 * common + 0.6 * own)
        counts = trainings_of(0.5 + level + 0.004 * rng.standard_normal((trainings + 1, 20, 4)))
        spread = spread_between(counts[:-1])
        part, whole = np.moveaxis(counts.sum(axis=1), -1, 0)
        f1 = part / whole
        called += (beyond_spread(f1[:-1].mean(axis=0) - f1[-1], spread, 4) <= 0.05).any()
    assert called <= 0.08 * draws


def test_rows_without_occupied_cells_and_equal_trainings_have_no_spread():
    trainings = trainings_of(np.full((3, 20, 2), 0.5))
    trainings[:, :, 1] = 0.0
    spread = spread_between(trainings)
    assert spread.deviation.tolist() == [0.0, 0.0]

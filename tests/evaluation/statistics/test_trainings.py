"""Trainings of a tracker: differences that are judged over units and over trainings."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from gridtrack.evaluation.scores.definition import Ratio
from gridtrack.evaluation.statistics.jackknife import ratio_replicates
from gridtrack.evaluation.statistics.trainings import Trainings, training_differences


def trainings_of(recalls, learned=True, occupied=1000.0):
    """Trainings by F1 of units with the same occupied cells, recalls (K, U, R) and no false alarm."""
    tp = occupied * np.asarray(recalls, float)
    return Trainings(
        tuple(ratio_replicates(Ratio(2 * own, whole)) for own, whole in zip(tp, tp + occupied, strict=True)), learned
    )


def test_the_variance_is_the_sum_over_units_and_over_both_trackers_trainings():
    rng = np.random.default_rng(3)
    own, other = (0.5 + 1e-4 * rng.standard_normal((3, 20, 1)) for _ in range(2))
    own[0] += 3e-4  # one training is better everywhere
    found = training_differences(trainings_of(own, True), trainings_of(other, True))
    slope = 2 / 1.5**2  # F1 = 2r / (1 + r), as good as linear in so small deviations
    values = slope * own.mean(axis=1)[:, 0], slope * other.mean(axis=1)[:, 0]
    units = slope * (own.mean(axis=0) - other.mean(axis=0))[:, 0]
    parts = [(units.var(ddof=1) / 20, 19.0), *((v.var(ddof=1) / 3, 3.5) for v in values)]
    variance = sum(part for part, _ in parts)
    freedom = variance**2 / sum(part**2 / df for part, df in parts)
    reach = stats.t.ppf(0.975, freedom) * np.sqrt(variance)
    assert found.value[0] == pytest.approx(values[0].mean() - values[1].mean(), rel=1e-3)
    assert found.high[0] - found.value[0] == pytest.approx(reach, rel=1e-2)
    assert found.p[0] == pytest.approx(2 * stats.t.sf(abs(found.value[0]) / np.sqrt(variance), freedom), rel=2e-2)


def test_intervals_cover_the_true_difference_of_drawn_trainings_and_units():
    rng, covered, draws = np.random.default_rng(0), 0, 400
    for _ in range(draws):
        difficulty = 0.04 * rng.standard_normal((1, 20, 1))
        sides = []
        for _ in range(2):
            level = 0.01 * rng.standard_normal((3, 1, 1))
            own = 0.01 * rng.standard_normal((1, 20, 1)) + 0.005 * rng.standard_normal((3, 20, 1))
            sides.append(trainings_of(0.6 + difficulty + level + own, True))
        found = training_differences(*sides)
        covered += bool(found.low[0] <= 0.0 <= found.high[0])
    assert 0.93 <= covered / draws <= 0.99


def test_the_freedom_over_units_is_their_effective_number_less_one():
    rng = np.random.default_rng(5)
    sizes = np.where(np.arange(20) < 3, 3000.0, 100.0)[None, :, None]
    sides = [trainings_of(0.6 + 0.01 * rng.standard_normal((1, 20, 1)), False, sizes[0]) for _ in "ab"]
    found = training_differences(*sides)
    wholes = [side.each[0].ratio.whole[:, 0] for side in sides]
    freedom = min(whole.sum() ** 2 / (whole**2).sum() for whole in wholes) - 1
    assert 2 < freedom < 4
    parts, (value,) = [side.each[0].ratio.part[:, 0] for side in sides], found.value
    f1 = [(part.sum() - part) / (whole.sum() - whole) for part, whole in zip(parts, wholes, strict=True)]
    error = np.sqrt(19 / 20 * ((f1[0] - f1[1] - np.mean(f1[0] - f1[1])) ** 2).sum())
    assert found.p[0] == pytest.approx(2 * stats.t.sf(abs(value) / error, freedom))
    assert found.high[0] - value == pytest.approx(stats.t.ppf(0.975, freedom) * error)


def test_a_difference_there_is_not_is_found_as_seldom_as_it_should_be_where_units_are_of_unlike_size():
    rng = np.random.default_rng(1)
    sizes = np.where(np.arange(20) < 3, 3000.0, 100.0)[None, :, None]
    drawn = [0.01 * rng.standard_normal((1, 20, 4000)) + 0.002 * rng.standard_normal((3, 20, 4000)) for _ in "ab"]
    p = training_differences(*(trainings_of(0.6 + own, True, sizes) for own in drawn)).p
    assert 0.03 <= np.mean(p < 0.05) <= 0.08, "with 19 degrees of freedom 0.13"


def test_trainings_with_equal_counts_do_not_differ_though_their_mean_is_rounded():
    rng = np.random.default_rng(4)
    recalls = 0.6 + 0.1 * rng.standard_normal((1, 20, 400))
    found = training_differences(trainings_of(np.repeat(recalls, 7, axis=0)), trainings_of(recalls, False))
    assert (found.p == 1.0).all()


def test_an_unknown_spread_gives_no_interval():
    one, three = trainings_of(np.full((1, 20, 2), 0.5)), trainings_of(np.full((3, 20, 2), 0.6))
    found = training_differences(one, three)
    assert np.isfinite(found.value).all()
    assert np.isnan(found.low).all()
    assert np.isnan(found.p).all()


def test_trainings_of_a_ratio_of_whole_numbers_are_compared():
    """Contacts are counted in integers: with three trainings the summary of a run that they led ended in an error."""
    hits = np.random.default_rng(4).integers(20, 60, (2, 3, 20, 1))
    met = np.full((20, 1), 100)
    mine, theirs = (Trainings(tuple(ratio_replicates(Ratio(own, met)) for own in each), True) for each in hits)
    found = training_differences(mine, theirs)
    assert found.value[0] == pytest.approx((hits[0].mean() - hits[1].mean()) / 100)
    assert found.low[0] < found.value[0] < found.high[0]

"""Several trainings of a tracker: the spread between them, and differences that are judged with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from gridtrack.evaluation.statistics.summary import summarise
from gridtrack.evaluation.statistics.training_differences import Trainings, training_differences

from scenes import synthetic_run as synthetic

RECORDINGS = [f"seed-{i:02}" for i in range(20)]


def sums_of(recalls, occupied=1000.0):
    """2 TP and 2 TP + FN (K, U, R, 2) of units with the same occupied cells, recalls (K, U, R) and no false alarm."""
    tp = occupied * np.asarray(recalls, float)
    return np.stack([2 * tp, tp + occupied], axis=-1)


def test_the_variance_is_that_over_units_and_that_of_both_means_over_trainings():
    rng = np.random.default_rng(3)
    own, other = (0.5 + 1e-4 * rng.standard_normal((3, 20, 1)) for _ in range(2))
    own[0] += 3e-4  # one training is better everywhere
    found = training_differences(Trainings(sums_of(own), True), Trainings(sums_of(other), True))
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
            sides.append(Trainings(sums_of(0.6 + difficulty + level + own), True))
        found = training_differences(*sides)
        covered += bool(found.low[0] <= 0.0 <= found.high[0])
    assert 0.93 <= covered / draws <= 0.99


def test_units_alone_would_cover_too_little_of_the_same_draws():
    rng, covered, draws = np.random.default_rng(0), 0, 200
    for _ in range(draws):
        sides = [0.6 + 0.01 * rng.standard_normal((1, 1, 1)) + 0.005 * rng.standard_normal((1, 20, 1)) for _ in "ab"]
        found = training_differences(*(Trainings(sums_of(side), False) for side in sides))
        covered += bool(found.low[0] <= 0.0 <= found.high[0])
    assert covered / draws < 0.5


def test_an_unknown_spread_gives_no_interval():
    one, three = Trainings(sums_of(np.full((1, 20, 2), 0.5)), True), Trainings(sums_of(np.full((3, 20, 2), 0.6)), True)
    found = training_differences(one, three)
    assert np.isfinite(found.value).all()
    assert np.isnan(found.low).all()
    assert np.isnan(found.p).all()


@pytest.fixture
def trials(tmp_path):
    """Persistence, two trainings of a network that differ by a tenth, and one row with the weights of the first."""
    rows = {"persistence": (0.5, ""), "net": (0.6, "a" * 64), "net 2": (0.7, "b" * 64), "net again": (0.6, "a" * 64)}
    found = []
    for number, name in enumerate(RECORDINGS):
        for label, (skill, weights) in rows.items():
            ended = synthetic.write_trial(tmp_path, label, name, skill, seed=number, frames=4, tracker=label.split()[0])
            found.append(replace(ended, record=ended.record.model_copy(update={"weights_sha256": weights})))
    return found


def test_rows_of_a_tracker_with_other_weights_are_its_trainings(trials):
    described = {name: synthetic.description(4) for name in RECORDINGS}
    summary = summarise(described, trials, [], False)
    floor, net = summary.trainings
    assert (floor.tracker, floor.labels, floor.reference) == ("persistence", ("persistence",), "persistence")
    assert (net.tracker, net.labels, net.units, net.interval) == ("net", ("net", "net 2"), 20, "")
    first = net.scores[0]
    pooled = [summary.trackers[label].pooled.strata[first.stratum].f1[first.step] for label in net.labels]
    assert first.f1 == pytest.approx(pooled, abs=1e-6)
    assert first.f1_mean == pytest.approx(np.mean(pooled), abs=1e-6)
    assert first.f1_spread == pytest.approx(np.std(pooled, ddof=1), rel=0.2), "shrunk towards the rows' mean ratio"
    assert floor.scores[0].verdict == ""
    assert floor.scores[0].f1_spread is None
    assert first.difference == pytest.approx(first.f1_mean - floor.scores[0].f1_mean, abs=1e-6)
    of_rows = {one.tracker: one for one in summary.differences}["net"].headline[0]
    assert first.difference_high - first.difference_low > of_rows.f1_high - of_rows.f1_low
    assert first.p_holm >= first.difference_p


def test_a_run_with_one_training_of_each_tracker_says_nothing_of_trainings(trials):
    described = {name: synthetic.description(4) for name in RECORDINGS}
    single = [trial for trial in trials if trial.record.label in ("persistence", "net", "net again")]
    assert summarise(described, single, [], False).trainings == ()

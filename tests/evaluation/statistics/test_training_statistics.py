"""Several trainings of a tracker: the spread between them, and differences that are judged with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from gridtrack.evaluation.referee.strata import STRATA
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


def test_the_freedom_over_units_is_their_effective_number_less_one():
    rng = np.random.default_rng(5)
    sizes = np.where(np.arange(20) < 3, 3000.0, 100.0)[None, :, None]
    sides = [Trainings(sums_of(0.6 + 0.01 * rng.standard_normal((1, 20, 1)), sizes), False) for _ in "ab"]
    found = training_differences(*sides)
    wholes = [side.sums[0, :, 0, 1] for side in sides]
    freedom = min(whole.sum() ** 2 / (whole**2).sum() for whole in wholes) - 1
    assert 2 < freedom < 4
    parts, (value,) = [side.sums[0, :, 0, 0] for side in sides], found.value
    f1 = [(part.sum() - part) / (whole.sum() - whole) for part, whole in zip(parts, wholes, strict=True)]
    error = np.sqrt(19 / 20 * ((f1[0] - f1[1] - np.mean(f1[0] - f1[1])) ** 2).sum())
    assert found.p[0] == pytest.approx(2 * stats.t.sf(abs(value) / error, freedom))
    assert found.high[0] - value == pytest.approx(stats.t.ppf(0.975, freedom) * error)


def test_a_difference_there_is_not_is_found_as_seldom_as_it_should_be_where_units_are_of_unlike_size():
    rng = np.random.default_rng(1)
    sizes = np.where(np.arange(20) < 3, 3000.0, 100.0)[None, :, None]
    drawn = [0.01 * rng.standard_normal((1, 20, 4000)) + 0.002 * rng.standard_normal((3, 20, 4000)) for _ in "ab"]
    p = training_differences(*(Trainings(sums_of(0.6 + own, sizes), True) for own in drawn)).p
    assert 0.03 <= np.mean(p < 0.05) <= 0.08, "with 19 degrees of freedom 0.13"


def test_units_alone_would_cover_too_little_of_the_same_draws():
    rng, covered, draws = np.random.default_rng(0), 0, 200
    for _ in range(draws):
        sides = [0.6 + 0.01 * rng.standard_normal((1, 1, 1)) + 0.005 * rng.standard_normal((1, 20, 1)) for _ in "ab"]
        found = training_differences(*(Trainings(sums_of(side), False) for side in sides))
        covered += bool(found.low[0] <= 0.0 <= found.high[0])
    assert covered / draws < 0.5


def test_trainings_with_equal_counts_do_not_differ_though_their_mean_is_rounded():
    rng = np.random.default_rng(4)
    sums = sums_of(0.6 + 0.1 * rng.standard_normal((1, 20, 400)))
    found = training_differences(Trainings(np.repeat(sums, 7, axis=0), True), Trainings(sums, False))
    assert (found.p == 1.0).all()


def test_an_unknown_spread_gives_no_interval():
    one, three = Trainings(sums_of(np.full((1, 20, 2), 0.5)), True), Trainings(sums_of(np.full((3, 20, 2), 0.6)), True)
    found = training_differences(one, three)
    assert np.isfinite(found.value).all()
    assert np.isnan(found.low).all()
    assert np.isnan(found.p).all()


ROWS = {
    "persistence": (0.5, ""),
    "net": (0.6, "a" * 64),
    "net 2": (0.7, "b" * 64),
    "net 3": (0.65, "c" * 64),
    "net again": (0.6, "a" * 64),
}
"""Skill and hash of the weights by label."""


def write_trials(folder):
    """A trial of each of ROWS on every recording; the tracker is the first word of the label."""
    found = []
    for number, name in enumerate(RECORDINGS):
        for label, (skill, weights) in ROWS.items():
            ended = synthetic.write_trial(folder, label, name, skill, seed=number, frames=4, tracker=label.split()[0])
            found.append(with_weights(ended, weights))
    return found


def with_weights(trial, weights):
    """The trial with another hash of its weights."""
    return replace(trial, record=trial.record.model_copy(update={"weights_sha256": weights}))


def summary_of(trials, reference=None):
    return summarise({name: synthetic.description(4) for name in RECORDINGS}, trials, [], False, reference)


@pytest.fixture
def trials(tmp_path):
    """Persistence, three trainings of a network that differ by a tenth, and one row with the weights of the first."""
    return write_trials(tmp_path)


def test_rows_of_a_tracker_with_other_weights_are_its_trainings(trials):
    summary = summary_of(trials)
    floor, net = summary.trainings
    assert (floor.tracker, floor.labels, floor.reference) == ("persistence", ("persistence",), "persistence")
    assert (net.tracker, net.labels, net.units, net.interval) == ("net", ("net", "net 2", "net 3"), 20, "")
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
    single = [trial for trial in trials if trial.record.label in ("persistence", "net", "net again")]
    assert summary_of(single).trainings == ()


def test_the_reference_is_found_among_rows_with_the_same_weights_as_another(trials):
    again = summary_of(trials, reference="net again")
    assert again.trainings == summary_of(trials, reference="net").trainings
    assert [one.labels for one in again.trainings] == [("persistence",), ("net", "net 2", "net 3")]


def test_rows_with_other_weights_on_any_recording_are_trainings_of_their_own(trials):
    last = [
        with_weights(one, "d" * 64)
        if (one.record.label, one.record.recording) == ("net again", RECORDINGS[-1])
        else one
        for one in trials
    ]
    assert summary_of(last).trainings[1].labels == ("net", "net 2", "net 3", "net again")


def test_two_trainings_have_a_mean_and_a_spread_and_no_interval(trials):
    net = summary_of([trial for trial in trials if trial.record.label != "net 3"]).trainings[1]
    assert net.interval.startswith("fewer than 3 trainings")
    first = net.scores[0]
    assert None not in (first.f1_mean, first.f1_spread, first.difference)
    assert (first.difference_low, first.p_holm, first.verdict) == (None, None, "not tested")


def test_a_training_that_failed_leaves_no_verdict_of_those_that_did_not(trials, tmp_path):
    whole = [trial for trial in trials if (trial.record.label, trial.record.recording) != ("net 4", RECORDINGS[0])]
    failed = synthetic.write_trial(
        tmp_path / "failed", "net 4", RECORDINGS[0], 0.2, seed=0, frames=4, scored=1, tracker="net"
    )
    net = summary_of([*whole, with_weights(failed, "e" * 64)]).trainings[1]
    assert net.interval == "3 of 4 trainings of net are complete, and the others may be worse"
    assert {score.verdict for score in net.scores} == {"not tested"}
    assert all(score.difference is None for score in net.scores)


def test_a_stratum_without_an_occupied_cell_is_not_tested_and_no_member_of_the_family(tmp_path, monkeypatch):
    drawn = synthetic.tally

    def without_dynamic(rng, skill, strata=STRATA, steps=synthetic.STEPS):
        counted = drawn(rng, skill, strata, steps)
        counted.positives[:, strata.index("dynamic")] = 0  # false alarms remain
        return counted

    monkeypatch.setattr(synthetic, "tally", without_dynamic)
    scores = summary_of(write_trials(tmp_path)).trainings[1].scores
    empty = [one for one in scores if one.stratum == "dynamic"]
    assert {(one.f1, one.f1_mean, one.difference, one.difference_p, one.verdict) for one in empty} == {
        ((None, None, None), None, None, None, "not tested")
    }
    tested = [one for one in scores if one.stratum != "dynamic"]
    assert len(tested) == 6
    worst = min(tested, key=lambda one: one.difference_p)
    assert worst.p_holm == pytest.approx(6 * worst.difference_p, rel=0.01), "the family has six members, not nine"

"""Comparisons of a run: each row with the reference, all pairs, classes, and trackers by their trainings."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from scipy import stats

from gridtrack.evaluation.runs.comparisons import _pair_tests
from gridtrack.evaluation.scores.definition import Output
from gridtrack.evaluation.scores.f1 import F1
from gridtrack.evaluation.statistics.jackknife import Replicates, holm

from scenes import synthetic_run as synthetic
from scenes.synthetic_run import RECORDINGS, summary_of, write_rows, write_unlike


def difference(summary, tracker):
    (found,) = [one for one in summary.differences if one.tracker == tracker]
    return found


def test_a_verdict_of_better_is_corrected_for_the_whole_family(twenty):
    good = difference(twenty[1], "good")
    assert (good.recordings, good.reference, good.units, good.frames) == ("all recordings", "persistence", 20, 80)
    assert {(t.stratum, t.horizon_s) for t in good.tests} == {
        (stratum, h) for stratum in ("in-motion", "dynamic", "visible") for h in (0.5, 1.0, 2.5)
    }
    for test in good.tests:
        found = good.at(test.stratum, "f1", "f1", test.step)
        assert test.verdict == "better"
        assert 0 < found.low < found.value < found.high
        assert found.p <= test.p_holm < 0.05


def test_identical_trackers_differ_by_exactly_nothing_and_are_never_better(twenty):
    twin = difference(twenty[1], "twin")
    assert {(t.p_holm, t.verdict) for t in twin.tests} == {(1.0, "no difference shown")}
    assert {twin.at(t.stratum, "f1", "f1", t.step).interval for t in twin.tests} == {(0.0, 0.0)}


def test_a_tracker_that_completed_fewer_recordings_is_not_compared_with_the_reason(twenty):
    found = difference(twenty[1], "unlucky")
    assert (found.tests, found.strata) == ((), {})
    assert found.interval == "not compared: unlucky has 19 of 20 recordings complete"


def test_the_ceiling_is_compared_with_nobody(twenty):
    assert {one.tracker for one in twenty[1].differences} == {"good", "twin", "unlucky"}


def test_of_nineteen_recordings_nothing_is_tested(tmp_path):
    trials = write_rows(tmp_path, {"persistence": 0.6, "good": 0.8}, RECORDINGS[:19], frames=2, scores=(F1,))
    summary = summary_of(trials, RECORDINGS[:19])
    found = difference(summary, "good")
    assert found.interval == "too short for an interval: 19 recordings, and 20 units are needed: 1 more recording"
    assert {test.verdict for test in found.tests} == {"not tested"}
    assert found.at("dynamic", "f1", "f1", 8).value > 0, "the difference itself is known"
    assert summary.pairs == ()


def test_a_long_recording_is_cut_into_blocks_longer_than_the_cycle(tmp_path):
    trials = write_rows(tmp_path, {"persistence": 0.6, "good": 0.8}, ["long"], frames=625, every_s=4, scores=(F1,))
    found = {cycle: difference(summary_of(trials, ["long"], cycle_s=cycle), "good") for cycle in (None, 125.0, 127.0)}
    assert found[None].units == 25
    assert found[125.0].units == 20
    assert found[127.0].interval.startswith("too short for an interval: 19 units, blocks of at least 127 s")


def test_one_recording_cut_into_twenty_stretches_is_one_recording_and_gives_no_verdict(tmp_path):
    trials = write_rows(tmp_path, {"persistence": 0.6, "good": 0.8}, frames=30, apart_s=30, scores=(F1,))
    found = difference(summary_of(trials, source_sha256="one"), "good")
    assert re.fullmatch(
        r"too short for an interval: [1-6] units?, of 1 recording, blocks of at least \d+ s, and 20 are needed: 19 more"
        r" recordings, or about \d+ more minutes",
        found.interval,
    )
    assert {test.verdict for test in found.tests} == {"not tested"}


def test_twenty_recordings_of_unlike_periods_have_differences_at_the_headlines_horizons(tmp_path):
    periods_s = [0.05 + 0.005 * k for k in range(20)]
    described, trials = write_unlike(tmp_path, periods_s, scores=(F1,))
    _, better = write_unlike(tmp_path, periods_s, "good", 0.8, scores=(F1,))
    good = difference(synthetic.summarise(described, [*trials, *better], [], False), "good")
    assert {(test.horizon_s, test.step) for test in good.tests} == {(0.5, 1), (1.0, 2), (2.5, 5)}
    assert {test.verdict for test in good.tests} == {"better"}


def test_rows_with_the_same_frames_are_compared_where_one_more_received_others(tmp_path):
    trials = write_rows(tmp_path, {"persistence": 0.6, "good": 0.8, "odd": 0.7}, frames=2, scores=(F1,))
    odd = trials[2].record
    trials[2] = synthetic.write_trial(
        tmp_path / "odd", "odd", odd.recording, 0.7, seed=0, frames=2, delivered="f", scores=(F1,)
    )
    summary = summary_of(trials)
    assert {(pair.tracker, pair.other) for family in summary.pairs for pair in family.pairs} == {
        ("persistence", "good")
    }
    assert {family.units for family in summary.pairs} == {20}
    assert difference(summary, "good").frames == 40
    assert difference(summary, "odd").interval.endswith("odd was delivered other frames than the rest on seed-00")


def test_a_row_of_raw_returns_is_not_compared_with_one_of_cells_centres(tmp_path):
    reference, raw = (
        synthetic.write_trial(tmp_path, label, "a", 0.6, seed=0, frames=4, delivered=delivered)
        for label, delivered in (("persistence", ""), ("kalman", "f"))
    )
    found = difference(summary_of([reference, replace(raw, points="raw")], ["a"]), "kalman")
    assert (found.frames, found.tests) == (0, ())
    assert found.interval.startswith("not compared: a row of raw returns and one of the centres of cells")


def family(summary, score="f1", stratum="in-motion", horizon_s=1.0):
    (found,) = [one for one in summary.pairs if (one.score, one.stratum, one.horizon_s) == (score, stratum, horizon_s)]
    return found


def test_every_pair_of_complete_rows_is_tested_once_and_no_other(twenty):
    for one in twenty[1].pairs:
        assert [(t.tracker, t.other) for t in one.pairs] == list(combinations(["persistence", "good", "twin"], 2))
        assert (one.recordings, one.units) == ("all recordings", 20)
    families = {f"{one.score}.{one.output}" for one in twenty[1].pairs}
    assert families == {"f1.f1", "pr_auc.area", "log_loss.mean", "fss.5_cells", "beam_error.mean"}, "and not soft IoU"


@pytest.mark.parametrize("score", ["f1", "pr_auc", "log_loss", "fss"])
def test_a_pair_has_the_difference_and_the_p_value_of_the_test_against_the_reference(twenty, score):
    own = family(twenty[1], score)
    expected = difference(twenty[1], "good").at("in-motion", score, own.output, 8)
    (found,) = [t for t in own.pairs if t.other == "good"]
    assert found.difference.value == pytest.approx(-expected.value, abs=2e-6)
    assert found.difference.low == pytest.approx(-expected.high, abs=2e-6)
    assert found.difference.p == pytest.approx(expected.p, rel=0.01)


def test_holm_is_over_all_pairs_of_the_score_and_better_follows_from_it(twenty):
    tests = family(twenty[1]).pairs
    p = np.array([t.difference.p for t in tests])
    assert [t.p_holm for t in tests] == pytest.approx(holm(p).tolist(), rel=0.01)
    assert [t.verdict for t in tests] == ["worse", "no difference shown", "better"]


@pytest.mark.parametrize(("better", "verdict"), [("higher", "better"), ("lower", "worse")])
def test_better_has_the_direction_of_the_score(better, verdict):
    rng = np.random.default_rng(0)
    rows = {
        label: Replicates(np.array(value), value + 0.001 * rng.standard_normal(20), np.ones(20))
        for label, value in (("a", 0.6), ("b", 0.4))
    }
    (test,) = _pair_tests(rows, Output("mean", "a score", better=better))
    assert test.verdict == verdict


CLASSES, CELLS, FRAMES = ("pedestrian", "car"), 5, 4
RNG = np.random.default_rng(0)
HARD = 1.0 + RNG.random((len(RECORDINGS), FRAMES))
"""Loss of every scan, by recording, to which each tracker adds its own."""
EXTRA = {"latent": 0.3 + 0.1 * RNG.random(len(RECORDINGS)), "shot": np.zeros(len(RECORDINGS)), "persistence": None}


def class_trial(folder, label, number, extra, **how):
    """A trial with scans that cost HARD + `extra` nats a cell, at every step, on visible cells only."""
    tracker = "one-shot" if label == "shot" else ""
    how = {"seed": number, "frames": FRAMES, "tracker": tracker, "scores": (F1,)} | how
    ended = synthetic.write_trial(folder, label, RECORDINGS[number], 0.6, **how)
    if extra is None:
        return ended
    layout = synthetic.class_layout(CLASSES)
    sums = np.zeros((FRAMES, synthetic.STEPS + 1, 1, len(layout.parts)))
    for scan, hard in zip(sums, HARD[number], strict=True):
        loss = hard + extra[number]
        scan[..., :4] = CELLS * loss, loss, 1.0, CELLS
    synthetic.add_class_sums(ended.folder, layout, sums)
    return ended


@pytest.fixture(scope="module")
def class_trials(tmp_path_factory):
    folder = tmp_path_factory.mktemp("classes")
    return [
        class_trial(folder, label, number, extra) for number in range(len(RECORDINGS)) for label, extra in EXTRA.items()
    ]


def class_differences(summary):
    return [one for one in summary.differences if not one.tests and one.strata]


def test_a_tracker_with_classes_is_compared_with_the_reference_for_classes_on_the_same_scans(class_trials):
    summary = summary_of(class_trials, classes=CLASSES)
    (one,) = class_differences(summary)
    extra = EXTRA["latent"]
    reach = stats.t.ppf(0.975, 19) * extra.std(ddof=1) / np.sqrt(20)  # units of equal size: the error of the mean
    assert (one.tracker, one.reference, one.recordings) == ("latent", "shot", "all recordings")
    assert (one.units, one.frames, one.interval) == (20, 20 * FRAMES, "")
    found = one.at("visible", "class_log_loss", "per_scan", 8)
    assert found.value == pytest.approx(extra.mean(), abs=1e-5)
    assert found.interval == pytest.approx((extra.mean() - reach, extra.mean() + reach), abs=1e-5)
    assert 0 < found.p < 1e-9
    pooled = summary.trackers["shot"].pooled.at("visible", "class_log_loss", "per_scan", 8)
    assert pooled.value == pytest.approx(HARD.mean(), abs=1e-5)
    assert pooled.interval[0] < HARD.mean() < pooled.interval[1]


def test_a_reference_asked_for_that_gives_classes_is_the_reference_for_classes_too(class_trials):
    (one,) = class_differences(summary_of(class_trials, reference="latent", classes=CLASSES))
    assert (one.tracker, one.reference) == ("shot", "latent")
    assert one.at("visible", "class_log_loss", "per_scan", 0).value < 0


def test_nobody_is_compared_by_classes_where_only_one_row_gives_them_or_frames_differ(tmp_path):
    alone = [class_trial(tmp_path, "shot", 0, EXTRA["shot"])]
    assert class_differences(summary_of(alone, RECORDINGS[:1], classes=CLASSES)) == []
    pair = [*alone, class_trial(tmp_path, "latent", 0, EXTRA["latent"], delivered="f")]
    summary = summary_of(pair, RECORDINGS[:1], classes=CLASSES)
    assert class_differences(summary) == []
    assert any("latent on seed-00: was delivered other frames" in notice for notice in map(str, summary.notices))


ROWS = {
    "persistence": (0.5, ""),
    "net": (0.6, "a" * 64),
    "net 2": (0.7, "b" * 64),
    "net 3": (0.65, "c" * 64),
    "net again": (0.6, "a" * 64),
}
"""Skill and hash of the weights by label."""


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """Persistence, three trainings of a network that differ by a tenth, and one row with the weights of the first."""
    folder, found = tmp_path_factory.mktemp("trainings"), []
    for number, name in enumerate(RECORDINGS):
        for label, (skill, weights) in ROWS.items():
            ended = synthetic.write_trial(
                folder, label, name, skill, seed=number, frames=2, tracker=label.split()[0], scores=(F1,)
            )
            found.append(with_weights(ended, weights))
    return found


def with_weights(trial, weights):
    """The trial with another hash of its weights."""
    return replace(trial, record=trial.record.model_copy(update={"weights_sha256": weights}))


def test_rows_of_a_tracker_with_other_weights_are_its_trainings(trained):
    summary = summary_of(trained)
    floor, net = summary.trainings
    assert (floor.tracker, floor.labels, floor.reference) == ("persistence", ("persistence",), "persistence")
    assert (net.tracker, net.labels, net.units, net.interval) == ("net", ("net", "net 2", "net 3"), 20, "")
    first = net.scores[0]
    pooled = [summary.trackers[label].pooled.at(first.stratum, "f1", "f1", first.step).value for label in net.labels]
    assert first.values == pytest.approx(pooled, abs=1e-6)
    assert first.mean == pytest.approx(np.mean(pooled), abs=1e-6)
    assert first.spread == pytest.approx(np.std(pooled, ddof=1), rel=0.2), "shrunk towards the rows' mean ratio"
    assert (floor.scores[0].verdict, floor.scores[0].spread) == ("", None)
    assert first.difference.value == pytest.approx(first.mean - floor.scores[0].mean, abs=1e-6)
    of_row = difference(summary, "net").at(first.stratum, "f1", "f1", first.step)
    assert np.ptp(first.difference.interval) > np.ptp(of_row.interval)
    assert first.p_holm >= first.difference.p


def test_a_run_with_one_training_of_each_tracker_has_no_trainings(trained):
    single = [trial for trial in trained if trial.record.label in ("persistence", "net", "net again")]
    assert summary_of(single).trainings == ()


def test_the_reference_is_found_among_rows_with_the_same_weights_as_another(trained):
    again = summary_of(trained, reference="net again")
    assert again.trainings == summary_of(trained, reference="net").trainings
    assert [one.labels for one in again.trainings] == [("persistence",), ("net", "net 2", "net 3")]


def test_rows_with_other_weights_on_any_recording_are_trainings_of_their_own(trained):
    last = [
        with_weights(one, "d" * 64)
        if (one.record.label, one.record.recording) == ("net again", RECORDINGS[-1])
        else one
        for one in trained
    ]
    assert summary_of(last).trainings[1].labels == ("net", "net 2", "net 3", "net again")


def test_two_trainings_have_a_mean_and_a_spread_and_no_interval(trained):
    net = summary_of([trial for trial in trained if trial.record.label != "net 3"]).trainings[1]
    assert net.interval.startswith("fewer than 3 trainings")
    first = net.scores[0]
    assert None not in (first.mean, first.spread, first.difference.value)
    assert (first.difference.low, first.p_holm, first.verdict) == (None, None, "not tested")


def test_a_training_that_failed_leaves_no_verdict_of_the_others(trained, tmp_path):
    failed = synthetic.write_trial(
        tmp_path, "net 4", RECORDINGS[0], 0.2, seed=0, frames=2, scored=1, tracker="net", scores=(F1,)
    )
    net = summary_of([*trained, with_weights(failed, "e" * 64)]).trainings[1]
    assert net.interval == "3 of 4 trainings of net are complete, and the others may be worse"
    assert {score.verdict for score in net.scores} == {"not tested"}

"""What a run says of its trackers: pooled over recordings, with intervals, and against the reference."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from pyarrow import parquet

from gridtrack.evaluation.results.columns import HISTOGRAM_TABLE, SCORES_TABLE
from gridtrack.evaluation.scoring.score_store import ScoresError
from gridtrack.evaluation.referee.strata import STRATA
from gridtrack.evaluation.statistics import pr_auc, trial_files
from gridtrack.evaluation.statistics.frame_counts import FrameCounts, common_frames, read_frame_counts
from gridtrack.evaluation.statistics.jackknife import COUNTS, interval
from gridtrack.evaluation.statistics.score_intervals import ONE_UNIT, Scope
from gridtrack.evaluation.statistics.summary import summarise
from gridtrack.evaluation.statistics.units import UnitRule, autocorrelation_time, sum_by_unit
from gridtrack.reports.moment_choice import frame_scores

from scenes import synthetic_run as synthetic

RECORDINGS = [f"seed-{i:02}" for i in range(20)]


def summary_of(trials, recordings=RECORDINGS, reference=None, **described):
    return summarise({n: synthetic.description(**described) for n in recordings}, trials, [], False, reference)


def a_run(tmp_path, skills, recordings=RECORDINGS, frames=8, apart_s=0, every_s=1, **broken):
    """Every label at its skill; seeds differ by recording and not by label, so frames are paired."""
    return [
        synthetic.write_trial(
            tmp_path,
            label,
            name,
            skill,
            seed=i,
            frames=frames,
            scored=broken.get(label) if i == 0 else None,
            start_s=10 + i * apart_s,
            every_s=every_s,
        )
        for i, name in enumerate(recordings)
        for label, skill in skills.items()
    ]


@pytest.fixture(scope="module")
def twenty(tmp_path_factory):
    """Twenty recordings: one tracker better than persistence, one its twin, one that crashed once, a ceiling."""
    skills = {"persistence": 0.6, "good": 0.8, "twin": 0.6, "unlucky": 0.9, "oracle": 1.0}
    trials = a_run(tmp_path_factory.mktemp("twenty"), skills, unlucky=3)
    return trials, summary_of(trials)


def difference(summary, tracker):
    (found,) = [one for one in summary.differences if one.tracker == tracker]
    return found


def test_pooled_scores_are_of_the_sums_over_all_recordings(twenty):
    trials, summary = twenty
    own = [read_frame_counts(t.folder, synthetic.STEPS, STRATA) for t in trials if t.record.label == "good"]
    tp, fp, fn = np.concatenate([o.counts for o in own]).sum(axis=0)[8, STRATA.index("dynamic"), :3].astype(float)
    pooled = summary.trackers["good"].pooled
    assert pooled.strata["dynamic"].f1[8] == pytest.approx(2 * tp / (2 * tp + fp + fn), abs=1e-6)
    assert (pooled.outcome, pooled.recordings_complete, pooled.frames_scored) == ("ok", 20, 160)


def test_the_pooled_interval_takes_whole_recordings_as_units(twenty):
    trials, summary = twenty
    own = [read_frame_counts(t.folder, synthetic.STEPS, STRATA) for t in trials if t.record.label == "good"]
    low, high = interval(np.stack([o.counts.sum(axis=0, dtype=float) for o in own]), "f1")
    dynamic = summary.trackers["good"].pooled.strata["dynamic"]
    assert dynamic.f1_low[8] == pytest.approx(low[8, 1], abs=1e-6)
    assert dynamic.f1_high[8] == pytest.approx(high[8, 1], abs=1e-6)
    assert dynamic.interval == ""
    assert dynamic.brier_low[8] <= dynamic.brier[8] <= dynamic.brier_high[8]


def test_a_single_recording_of_forty_frames_is_too_short_for_an_interval(twenty):
    dynamic = twenty[1].trackers["good"].recordings["seed-00"].strata["dynamic"]
    assert dynamic.f1_low is None
    assert dynamic.interval.startswith("too short for an interval: ")


def test_a_pr_auc_of_which_one_recording_has_all_occupied_cells_has_a_reason_instead_of_an_interval(
    tmp_path, monkeypatch
):
    drawn = synthetic.tally

    def free(rng, skill, strata=STRATA, steps=synthetic.STEPS):
        counted = drawn(rng, skill, strata, steps)
        counted.positives[:, strata.index("dynamic")] = 0
        return counted

    trials = a_run(tmp_path, {"good": 0.8}, RECORDINGS[:1], frames=4)
    monkeypatch.setattr(synthetic, "tally", free)
    trials += a_run(tmp_path, {"good": 0.8}, RECORDINGS[1:], frames=4)
    strata = summary_of(trials).trackers["good"].pooled.strata
    assert (strata["dynamic"].pr_auc[8] is None, strata["dynamic"].pr_auc_low[8]) == (False, None)
    assert strata["dynamic"].interval == ONE_UNIT
    assert strata["dynamic"].nll_low[8] < strata["dynamic"].nll_high[8], "other scores have their intervals"
    assert (strata["visible"].interval, strata["visible"].pr_auc_low[8] is None) == ("", False)


def test_better_is_said_where_it_is_shown_over_the_whole_family(twenty):
    good = difference(twenty[1], "good")
    assert (good.recordings, good.reference, good.units, good.frames) == (
        "all recordings",
        "persistence",
        20,
        160,
    )
    assert {(t.stratum, t.horizon_s) for t in good.headline} == {
        (stratum, h) for stratum in ("in-motion", "dynamic", "visible") for h in (0.5, 1.0, 2.5)
    }
    for test in good.headline:
        assert test.verdict == "better"
        assert 0 < test.f1_low < test.f1 < test.f1_high
        assert test.f1_p <= test.p_holm < 0.05


def test_identical_trackers_differ_by_exactly_nothing_and_are_never_better(twenty):
    twin = difference(twenty[1], "twin")
    assert {(t.f1, t.f1_low, t.f1_high, t.p_holm, t.verdict) for t in twin.headline} == {
        (0.0, 0.0, 0.0, 1.0, "no difference shown")
    }


def test_a_tracker_that_completed_fewer_recordings_is_not_compared_and_says_so(twenty):
    _, summary = twenty
    unlucky = summary.trackers["unlucky"].pooled
    assert unlucky.outcome == "partial"
    assert unlucky.reason == "19 of 20 recordings complete (seed-00: crashed)"
    told = difference(summary, "unlucky")
    assert told.headline == ()
    assert told.interval == "not compared: unlucky has 19 of 20 recordings complete"


@pytest.mark.parametrize(
    ("period_s", "expected"),
    [(0.125, [(0.5, 4), (1.0, 8), (2.5, 20)]), (1.8, [(1.8, 1)]), (0.7, [(0.7, 1), (2.8, 4)])],
)
def test_each_step_is_in_the_family_once_with_its_own_horizon(period_s, expected):
    scope = Scope([step * period_s for step in range(21)], ("dynamic", "visible"))
    assert scope.headline == [(name, *one) for name in ("dynamic", "visible") for one in expected]


def test_the_ceiling_is_compared_with_nobody(twenty):
    assert {one.tracker for one in twenty[1].differences} == {"good", "twin", "unlucky"}
    assert twenty[1].trackers["oracle"].pooled.strata["dynamic"].f1[8] > 0.8


def test_the_reference_can_be_named(tmp_path):
    trials = a_run(tmp_path, {"persistence": 0.6, "good": 0.8}, RECORDINGS[:2], frames=3)
    summary = summary_of(trials, RECORDINGS[:2], reference="good")
    assert summary.reference == "good"
    assert [one.tracker for one in summary.differences] == ["persistence"]


def test_of_nineteen_recordings_nothing_is_tested(tmp_path):
    trials = a_run(tmp_path, {"persistence": 0.6, "good": 0.8}, RECORDINGS[:19], frames=3)
    told = difference(summary_of(trials, RECORDINGS[:19]), "good")
    assert told.interval == "too short for an interval: 19 recordings, and 20 units are needed"
    assert {test.verdict for test in told.headline} == {"not tested"}


def test_a_long_recording_is_cut_into_blocks_longer_than_the_cycle(tmp_path):
    trials = a_run(tmp_path, {"persistence": 0.6, "good": 0.8}, ["long"], frames=1250, every_s=2)
    told = {cycle: difference(summary_of(trials, ["long"], cycle_s=cycle), "good") for cycle in (None, 125.0, 127.0)}
    assert told[None].units == 25
    assert told[125.0].units == 20
    assert told[127.0].interval.startswith("too short for an interval: 19 units, blocks of at least 127 s")


def test_no_block_is_shorter_than_people_stay_whatever_the_autocorrelation(tmp_path):
    trials = a_run(tmp_path, {"persistence": 0.6, "good": 0.8}, ["short"], frames=600)
    told = difference(summary_of(trials, ["short"]), "good")
    assert told.interval == "too short for an interval: 6 units, blocks of at least 100 s, and 20 are needed"


def test_one_recording_cut_into_twenty_stretches_is_one_recording_and_gives_no_verdict(tmp_path):
    trials = a_run(tmp_path, {"persistence": 0.6, "good": 0.8}, RECORDINGS, frames=30, apart_s=30)
    told = difference(summary_of(trials, source_sha256="one"), "good")
    assert re.fullmatch(
        r"too short for an interval: [1-6] units?, of 1 recording, blocks of at least \d+ s, and 20 are needed",
        told.interval,
    )
    assert {test.verdict for test in told.headline} == {"not tested"}


@pytest.mark.parametrize("cycle_s", [None, 30.0])
def test_a_single_forecast_has_scores_and_is_too_short_for_an_interval(tmp_path, cycle_s):
    trials = a_run(tmp_path, {"persistence": 0.6, "good": 0.8}, ["short"], frames=1)
    summary = summary_of(trials, ["short"], cycle_s=cycle_s)
    dynamic = summary.trackers["good"].recordings["short"].strata["dynamic"]
    assert dynamic.f1[8] > 0
    assert dynamic.f1_low is None
    assert dynamic.interval == "too short for an interval: 1 unit, blocks of at least 100 s, and 20 are needed"
    assert difference(summary, "good").interval == dynamic.interval


def unlike(folder, periods_s, label="persistence", skill=0.6, seconds=2.5):
    """One recording of each period, described, and a trial on it."""
    steps = [round(seconds / period_s) for period_s in periods_s]
    names = [f"at-{period_s * 1000:.0f}-ms" for period_s in periods_s]
    trials = [
        synthetic.write_trial(folder, label, name, skill, seed=i, frames=3, steps=n)
        for i, (name, n) in enumerate(zip(names, steps, strict=True))
    ]
    described = {
        name: synthetic.description(period_s=period_s, steps=n)
        for name, period_s, n in zip(names, periods_s, steps, strict=True)
    }
    return described, trials


def test_recordings_of_unlike_periods_are_scored_together_at_equal_times_and_not_at_equal_steps(tmp_path):
    described, trials = unlike(tmp_path, [0.05, 0.105263, 0.125])
    summary = summarise(described, trials, [], False)
    assert summary.pooled_horizons_s == (0.0, 0.5, 1.0, 1.5, 2.0, 2.5)
    nearest = [(0, 10, 20, 30, 40, 50), (0, 5, 10, 14, 19, 24), (0, 4, 8, 12, 16, 20)]
    counts = np.stack(
        [
            read_frame_counts(trial.folder, trial.record.steps, STRATA).counts[:, steps].sum(axis=0, dtype=float)
            for trial, steps in zip(trials, nearest, strict=True)
        ]
    ).sum(axis=0)
    tp, fp, fn = (counts[:, STRATA.index("dynamic"), k] for k in range(3))
    pooled = summary.trackers["persistence"].pooled.strata["dynamic"]
    assert pooled.f1 == pytest.approx(2 * tp / (2 * tp + fp + fn), abs=1e-6)
    assert len(pooled.pr_auc) == len(pooled.fss_9) == len(pooled.beam_error) == len(pooled.f1_label_free) == 6
    (told,) = [notice for notice in summary.notices if "rate" in notice]
    assert told.endswith("given every 0.5 s; of each recording the nearest step counts, at most 53 ms away")


def test_scores_together_are_those_of_the_recordings_where_only_the_horizon_differs(tmp_path):
    described, trials = unlike(tmp_path, [0.125])
    longer, others = unlike(tmp_path / "longer", [0.1], seconds=1.2)
    summary = summarise({**described, **longer}, [*trials, *others], [], False)
    assert summary.pooled_horizons_s == (0.0, 0.5, 1.0)
    alone = summarise(described, trials, [], False).trackers["persistence"].recordings["at-125-ms"]
    together = summary.trackers["persistence"]
    assert together.recordings["at-125-ms"] == alone
    assert len(together.pooled.strata["dynamic"].f1) == 3


def test_twenty_recordings_of_unlike_periods_have_intervals_and_differences_at_the_headlines_horizons(tmp_path):
    periods_s = [0.05 + 0.005 * k for k in range(20)]
    described, trials = unlike(tmp_path, periods_s)
    _, better = unlike(tmp_path, periods_s, "good", 0.8)
    summary = summarise(described, [*trials, *better], [], False)
    dynamic = summary.trackers["good"].pooled.strata["dynamic"]
    assert all(low < f1 < high for low, f1, high in zip(dynamic.f1_low, dynamic.f1, dynamic.f1_high, strict=True))
    good = difference(summary, "good")
    assert {(test.horizon_s, test.step) for test in good.headline} == {(0.5, 1), (1.0, 2), (2.5, 5)}
    assert {test.verdict for test in good.headline} == {"better"}
    assert all(test.pr_auc_low < test.pr_auc < test.pr_auc_high for test in good.headline)
    assert all(test.fss_5_low < test.fss_5 < test.fss_5_high for test in good.headline)
    assert all(test.beam_error is not None for test in good.headline)


def test_recordings_slower_than_the_common_horizons_are_not_scored_together_and_that_is_told(tmp_path):
    described, trials = unlike(tmp_path, [0.125, 0.6])
    summary = summarise(described, trials, [], False)
    assert summary.trackers["persistence"].pooled is None
    assert summary.pooled_horizons_s == ()
    assert any("no scores are pooled" in notice for notice in summary.notices)


def test_cells_of_unlike_size_are_counted_together_and_that_is_told(tmp_path):
    trials = a_run(tmp_path, {"persistence": 0.6}, ["a", "b"], frames=3)
    described = {"a": synthetic.description(), "b": synthetic.description(grid="50x0.4")}
    summary = summarise(described, trials, [], False)
    assert summary.trackers["persistence"].pooled.frames_scored == 6
    assert any("differ in the size of their cells" in notice for notice in summary.notices)


def test_frames_of_another_delivery_are_not_paired(tmp_path):
    trials = [
        synthetic.write_trial(tmp_path, "persistence", "a", 0.6, seed=0, frames=4),
        synthetic.write_trial(tmp_path, "odd", "a", 0.6, seed=0, frames=4, delivered="f"),
    ]
    told = difference(summary_of(trials, ["a"]), "odd")
    assert (told.frames, told.headline) == (0, ())
    assert told.interval == "not compared: odd was delivered other frames than the rest on a"
    odd = read_frame_counts(trials[1].folder, synthetic.STEPS, STRATA)
    others = FrameCounts(odd.stamps_ns[1:], np.array(["x", *odd.delivered[2:]]), odd.counts[1:])
    one, other = common_frames(odd, others)
    assert one.stamps_ns.tolist() == other.stamps_ns.tolist() == odd.stamps_ns[2:].tolist()


def test_rows_with_the_same_frames_are_compared_where_one_more_received_others(tmp_path):
    trials = a_run(tmp_path, {"persistence": 0.6, "good": 0.8, "odd": 0.7}, frames=4)
    odd = trials[2].record
    trials[2] = synthetic.write_trial(
        tmp_path / "odd", odd.label, odd.recording, 0.7, seed=0, frames=4, delivered="f", tracker="odd"
    )
    summary = summary_of(trials)
    assert {pair.tracker for family in summary.pairs for pair in family.pairs} == {"persistence"}
    assert {pair.other for family in summary.pairs for pair in family.pairs} == {"good"}
    assert {family.units for family in summary.pairs} == {20}
    assert difference(summary, "good").frames == 80
    assert (
        difference(summary, "odd").interval == "not compared: odd was delivered other frames than the rest on seed-00"
    )


def test_a_row_that_lacks_the_recording_with_the_longest_blocks_gets_no_units_of_its_own(tmp_path):
    names, skills = ["a", "b"], {"persistence": 0.6, "picky": 0.8}
    trials = a_run(tmp_path, skills, names, frames=480, every_s=5, picky=3)
    described = {"a": synthetic.description(cycle_s=300.0), "b": synthetic.description()}
    summary = summarise(described, trials, [], False)
    for label in skills:
        assert summary.trackers[label].pooled.strata["dynamic"].f1_low is None
    assert "blocks of at least 300 s" in summary.trackers["picky"].pooled.strata["dynamic"].interval


def test_a_row_of_raw_returns_is_not_compared_with_one_of_cells_centres_and_says_so(tmp_path):
    reference, raw = (
        synthetic.write_trial(tmp_path, label, "a", 0.6, seed=0, frames=4, delivered=delivered)
        for label, delivered in (("persistence", ""), ("kalman", "f"))
    )
    told = difference(summary_of([reference, replace(raw, points="raw")], ["a"]), "kalman")
    assert (told.frames, told.headline) == (0, ())
    assert told.interval.startswith("not compared: a row of raw returns and one of the centres of cells")


@pytest.mark.parametrize(("folder", "neighbour"), [("exp[1]", "exp1"), ("a*", "ab"), ("a?", "ac"), ("two words", "b")])
def test_scores_are_read_from_the_folder_that_is_named_and_not_from_one_that_matches_it(tmp_path, folder, neighbour):
    frames = {neighbour: 9, folder: 4}
    trials = {
        name: synthetic.write_trial(tmp_path / name, "persistence", "a", 0.6, seed=0, frames=count)
        for name, count in frames.items()
    }
    for name, count in frames.items():
        trial = trials[name]
        assert len(read_frame_counts(trial.folder, trial.record.steps, trial.strata).stamps_ns) == count
        assert len(frame_scores(trial.folder / SCORES_TABLE.file, [0])[0]) == count


def test_scores_of_other_steps_are_refused(tmp_path):
    trial = synthetic.write_trial(tmp_path, "good", "a", 0.6, seed=0, frames=2)
    with pytest.raises(ScoresError, match="not 11 steps of"):
        read_frame_counts(trial.folder, 10, STRATA)


def test_autocorrelation_time_of_an_autoregressive_series_is_the_textbooks():
    rng = np.random.default_rng(0)
    series = np.zeros((20_000, 2))
    for t in range(1, len(series)):
        series[t] = [0.8, 0.0] * series[t - 1] + rng.standard_normal(2)
    limits = [(1 + 0.8) / (1 - 0.8), 1.0]
    assert limits[0] < autocorrelation_time(series[:, :1]) < 1.4 * limits[0]
    assert limits[1] < autocorrelation_time(series[:, 1:]) < 1.1 * limits[1]
    assert autocorrelation_time(series) == autocorrelation_time(series[:, :1])
    assert autocorrelation_time(np.ones((50, 1))) == 1.0


def every_second(frames, start_s=0):
    return (start_s + np.arange(frames)) * 1_000_000_000


def test_blocks_are_equal_long_enough_and_never_reach_over_two_recordings():
    stamps = [every_second(100), every_second(30), every_second(5)]
    units = UnitRule(("a", "b", "c"), 10.0).units_of(stamps)
    assert [np.unique(unit, return_counts=True)[1].tolist() for unit in units] == [[10] * 10, [10] * 3, [5]]
    assert np.concatenate(units).tolist() == sorted(np.concatenate(units).tolist())
    assert [unit[0] for unit in units] == [0, 10, 13]
    twenty = UnitRule(tuple(map(str, range(20))), None).units_of([stamps[0]] * 20)
    assert [set(unit.tolist()) for unit in twenty] == [{i} for i in range(20)]


def test_stretches_of_one_source_are_divided_into_blocks_together_in_the_order_of_time():
    stamps = [every_second(30, start_s=100), every_second(10), every_second(20), every_second(5)]
    late, other, early, nothing = UnitRule(("one", "two", "one", "three"), 25.0).units_of([*stamps[:3], stamps[3][:0]])
    assert early.tolist() == [0] * 20
    assert late.tolist() == [0] * 5 + [1] * 25
    assert other.tolist() == [2] * 10
    assert nothing.tolist() == []


def test_sums_by_unit_add_up_over_recordings():
    counts = [np.arange(12, dtype=np.float32).reshape(6, 2), np.ones((2, 2), np.float32)]
    summed = sum_by_unit(counts, [np.array([0, 0, 1, 1, 1, 2]), np.array([0, 3])])
    assert summed.tolist() == [[3, 5], [18, 21], [10, 11], [1, 1]]
    assert len(COUNTS) == 6


def test_the_histograms_of_a_trial_are_read_once(tmp_path, monkeypatch):
    """They are most of what a summary reads, and their number is rows times recordings."""
    trials = a_run(tmp_path, {"persistence": 0.6, "good": 0.8, "twin": 0.6, "oracle": 1.0}, frames=2)
    opened = []
    whole_file = parquet.ParquetFile

    def open_file(path):
        opened.append(path)
        return whole_file(path)

    monkeypatch.setattr(parquet, "ParquetFile", open_file)
    summary = summary_of(trials, reference="persistence")
    assert len(summary.differences) == 2
    assert len(summary.pairs) > 0
    assert summary.trackers["good"].pooled.strata["dynamic"].pr_auc_low[8] is not None
    reads = Counter(path.parent.name for path in opened if path.name == HISTOGRAM_TABLE.file)
    assert reads == {trial.folder.name: 1 for trial in trials}


def test_a_run_whose_counts_do_not_fit_in_memory_has_the_same_summary(tmp_path, monkeypatch):
    trials = a_run(tmp_path, {"persistence": 0.6, "good": 0.8}, frames=2)
    expected = summary_of(trials, reference="persistence")
    assert expected.trackers["good"].pooled.strata["dynamic"].pr_auc_low[8] is not None
    monkeypatch.setattr(trial_files, "KEPT_BYTES", 1)
    monkeypatch.setattr(pr_auc, "SUMMED_BYTES", 1 << 20)  # of nine sums for twenty units four at a time
    assert summary_of(trials, reference="persistence") == expected

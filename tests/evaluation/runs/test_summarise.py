"""The summary of a run: pooled scores with intervals, values relative to floors and oracle, and which score leads."""

from __future__ import annotations

import numpy as np
import pytest
from pyarrow import parquet
from scipy import stats

from gridtrack.common.errors import ConfigurationError
from gridtrack.evaluation.runs import estimates, sums
from gridtrack.evaluation.runs.finished import headline_steps
from gridtrack.evaluation.runs.plan import resolve
from gridtrack.evaluation.runs.settings import CompareSettings
from gridtrack.evaluation.runs.summarise import _reversed_rankings, related, summarise
from gridtrack.evaluation.runs.summary import ALL_RECORDINGS, Estimate, PooledSummary, TrackerSummary, TrialSummary
from gridtrack.evaluation.runs.sums import ScoresError, TrialSums
from gridtrack.evaluation.scores.contact_foresight import CONTACT_FORESIGHT
from gridtrack.evaluation.scores.f1 import F1
from gridtrack.evaluation.scores.log_loss import LOG_LOSS
from gridtrack.evaluation.scores.pr_auc import PR_AUC

from scenes import synthetic_run as synthetic
from scenes.synthetic_run import description, summary_of, write_rows, write_trial, write_unlike


def by_recording(trials, label, score, stratum, step):
    """The sums (U, P) of a row by recording."""
    own = [TrialSums(t.folder) for t in trials if t.record.label == label]
    frames = [np.zeros(len(one.frames.stamps_ns), np.int64) for one in own]
    return [one.by_unit(score, units, [step], [stratum]) for one, units in zip(own, frames, strict=True)]


def test_pooled_scores_are_of_the_sums_over_all_recordings(twenty):
    trials, summary = twenty
    sums = by_recording(trials, "good", "f1", "dynamic", 8)
    tp, fp, fn = (sum(one[f"{count} chosen"][0, 0, 0] for one in sums) for count in ("tp", "fp", "fn"))
    pooled = summary.trackers["good"].pooled
    assert pooled.at("dynamic", "f1", "f1", 8).value == pytest.approx(2 * tp / (2 * tp + fp + fn), abs=1e-6)
    assert pooled.at("dynamic", "f1", "precision", 8).value == pytest.approx(tp / (tp + fp), abs=1e-6)
    assert (pooled.outcome, pooled.recordings_complete, pooled.frames_scored) == ("ok", 20, 80)
    assert pooled.interval == ""


def test_the_pooled_interval_takes_whole_recordings_as_units(twenty):
    """The jackknife over recordings of the logarithm of a mean, computed one recording at a time."""
    trials, summary = twenty
    sums = by_recording(trials, "good", "log_loss", "dynamic", 8)
    loss, cells = (np.array([one[part][0, 0, 0] for one in sums]) for part in ("loss", "cells"))
    without = np.log((loss.sum() - loss) / (cells.sum() - cells))
    error = np.sqrt(19 / 20 * np.sum((without - without.mean()) ** 2))
    freedom = min(size.sum() ** 2 / (size**2).sum() for size in (loss, cells)) - 1
    ends = loss.sum() / cells.sum() * np.exp(np.array([-1, 1]) * stats.t.ppf(0.975, freedom) * error)
    assert summary.trackers["good"].pooled.at("dynamic", "log_loss", "mean", 8).interval == pytest.approx(
        ends, abs=2e-6
    )


def test_every_output_with_a_scale_has_an_interval_round_its_value(twenty):
    scope = twenty[1].trackers["good"].pooled
    having = set()
    for stratum, scores in scope.strata.items():
        for score, outputs in scores.items():
            for output, estimate in outputs.items():
                if estimate.low is not None and estimate.low[8] is not None:
                    assert estimate.low[8] <= estimate.value[8] <= estimate.high[8], (stratum, score, output)
                    having.add(f"{score}.{output}")
    assert having == {
        *(f"f1.{name}" for name in ("f1", "precision", "recall", "at_half", "at_visible", "label_free")),
        *("pr_auc.area", "log_loss.mean", "brier.mean", "soft_iou.iou"),
        *(f"fss.{scale}_cells" for scale in (1, 3, 5, 9)),
        *(f"beam_error.{name}" for name in ("mean", "median", "bias")),
    }


def test_a_single_forecast_has_scores_and_is_too_short_for_an_interval(tmp_path):
    trial = summary_of(write_rows(tmp_path, {"good": 0.8}, ["a"], frames=1), ["a"]).trackers["good"].recordings["a"]
    found = trial.at("dynamic", "f1", "f1", 8)
    assert (found.value > 0, found.interval) == (True, None)
    assert trial.interval == (
        "too short for an interval: 1 unit, blocks of at least 100 s, and 20 are needed: 19 more recordings, or about"
        " 32 more minutes"
    )


def test_a_row_that_lacks_the_recording_with_the_longest_blocks_gets_no_units_of_its_own(tmp_path):
    names, skills = ["a", "b"], {"persistence": 0.6, "picky": 0.8}
    trials = write_rows(tmp_path, skills, names, frames=480, every_s=5, picky=3, scores=(F1,))
    described = {"a": synthetic.description(cycle_s=300.0), "b": synthetic.description()}
    summary = summarise(described, trials, [], False)
    for label in skills:
        assert summary.trackers[label].pooled.at("dynamic", "f1", "f1", 8).interval is None
    assert "blocks of at least 300 s" in summary.trackers["picky"].pooled.interval


@pytest.mark.parametrize(
    ("period_s", "expected"),
    [(0.125, [(0.5, 4), (1.0, 8), (2.5, 20)]), (1.8, [(1.8, 1)]), (0.7, [(0.7, 1), (2.8, 4)])],
)
def test_each_step_is_in_the_headline_once_with_its_own_horizon(period_s, expected):
    assert headline_steps([step * period_s for step in range(21)]) == expected


def test_recordings_of_unlike_periods_are_scored_together_at_equal_times_and_not_at_equal_steps(tmp_path):
    described, trials = write_unlike(tmp_path, [0.05, 0.105263, 0.125])
    summary = summarise(described, trials, [], False)
    assert summary.pooled_horizons_s == (0.0, 0.5, 1.0, 1.5, 2.0, 2.5)
    nearest = [(0, 10, 20, 30, 40, 50), (0, 5, 10, 14, 19, 24), (0, 4, 8, 12, 16, 20)]
    units = np.zeros(3, np.int64)
    sums = [TrialSums(t.folder).by_unit("f1", units, at, ["dynamic"]) for t, at in zip(trials, nearest, strict=True)]
    tp, fp, fn = (sum(one[f"{count} chosen"][0, :, 0] for one in sums) for count in ("tp", "fp", "fn"))
    pooled = summary.trackers["persistence"].pooled
    assert pooled.estimate("dynamic", "f1", "f1").value == pytest.approx(2 * tp / (2 * tp + fp + fn), abs=1e-6)
    lengths = {len(curve) for _, curve in pooled.curves()}
    assert lengths == {6}
    (notice,) = [notice for notice in map(str, summary.notices) if "rate" in notice]
    assert notice.endswith("given every 0.5 s; of each recording the nearest step counts, at most 53 ms away")


def test_scores_together_equal_the_recordings_scores_if_only_the_horizon_differs(tmp_path):
    described, trials = write_unlike(tmp_path, [0.125])
    longer, others = write_unlike(tmp_path / "longer", [0.1], seconds=1.2)
    summary = summarise({**described, **longer}, [*trials, *others], [], False)
    assert summary.pooled_horizons_s == (0.0, 0.5, 1.0)
    alone = summarise(described, trials, [], False).trackers["persistence"].recordings["at-125-ms"]
    assert summary.trackers["persistence"].recordings["at-125-ms"] == alone


def test_recordings_slower_than_the_common_horizons_are_not_scored_together_with_a_notice(tmp_path):
    described, trials = write_unlike(tmp_path, [0.125, 0.6])
    summary = summarise(described, trials, [], False)
    assert summary.trackers["persistence"].pooled is None
    assert summary.pooled_horizons_s == ()
    assert any("no scores are pooled" in notice for notice in map(str, summary.notices))


def test_cells_of_unlike_size_are_counted_together_with_a_notice(tmp_path):
    trials = write_rows(tmp_path, {"persistence": 0.6}, ["a", "b"], frames=3)
    described = {"a": synthetic.description(), "b": synthetic.description(grid="50x0.4")}
    summary = summarise(described, trials, [], False)
    assert summary.trackers["persistence"].pooled.frames_scored == 6
    assert any("differ in the size of their cells" in notice for notice in map(str, summary.notices))


def test_a_tracker_that_completed_fewer_recordings_is_partial_with_the_reason(twenty):
    unlucky = twenty[1].trackers["unlucky"].pooled
    assert (unlucky.outcome, unlucky.reason) == ("partial", "19 of 20 recordings complete (seed-00: crashed)")


@pytest.mark.parametrize(("folder", "neighbour"), [("exp[1]", "exp1"), ("a*", "ab"), ("a?", "ac"), ("two words", "b")])
def test_sums_are_read_from_the_folder_that_is_named_and_not_from_one_that_matches_it(tmp_path, folder, neighbour):
    for name, count in {neighbour: 9, folder: 4}.items():
        trial = synthetic.write_trial(tmp_path / name, "persistence", "a", 0.6, seed=0, frames=count)
        assert len(TrialSums(trial.folder).frames.stamps_ns) == count


def test_a_run_with_sums_that_do_not_fit_in_memory_has_the_same_summary(tmp_path, monkeypatch):
    trials = write_rows(tmp_path, {"persistence": 0.6, "good": 0.8}, frames=2, scores=(F1, PR_AUC))
    expected = summary_of(trials)
    monkeypatch.setattr(estimates, "KEPT_BYTES", 1)
    monkeypatch.setattr(sums, "READ_ROWS_BYTES", 100_000)
    assert summary_of(trials) == expected


def test_a_damaged_table_is_an_error_and_no_other_summary(tmp_path):
    trials = write_rows(tmp_path, {"good": 0.8}, ["a"], frames=2)
    path = trials[0].folder / "sums.parquet"
    parquet.write_table(parquet.read_table(path).slice(1), path)
    with pytest.raises(ScoresError, match=r"sums\.parquet: .*run it again"):
        summary_of(trials, ["a"])


FLOORS = ("persistence", "static-map")


def row(tracker, dynamic, log_loss=None, occluded=None, outcome="ok", pooled=None):
    """A row with these curves of F1, and of log loss on dynamic cells."""

    def strata_of(curve):
        scores = {
            "f1": {"f1": Estimate(value=curve)},
            "log_loss": {"mean": Estimate(value=log_loss or [None] * len(curve))},
        }
        hidden = {"occluded": {"f1": {"f1": Estimate(value=occluded)}}} if occluded else {}
        return {"visible": scores, "dynamic": scores, **hidden}

    return TrackerSummary(
        tracker=tracker,
        role="floor" if tracker in FLOORS else "tracker",
        recordings={"room": TrialSummary(outcome=outcome, strata=strata_of(dynamic))},
        pooled=pooled and PooledSummary(outcome="ok", strata=strata_of(pooled)),
    )


def related_rows(trackers):
    """The rows after comparison with floors and oracle, at steps of one second."""
    horizons_s = {"room": (0.0, 1.0, 2.0, 3.0), ALL_RECORDINGS: (0.0, 1.0, 2.0, 3.0)}
    return related(trackers, [F1, LOG_LOSS], (F1, F1.lead), horizons_s)


def shares(trackers, label, score="f1"):
    return related_rows(trackers)[label].recordings["room"].estimate("dynamic", score, "oracle_share").value


def test_shares_start_at_the_best_floor_of_each_step_and_end_at_the_oracle():
    trackers = {
        "good": row("kalman", [0.9, 0.5], [0.3, 0.3]),
        "oracle": row("oracle", [1.0, 0.8], [0.1, 0.1]),
        "persistence": row("persistence", [0.8, 0.2], [0.2, 0.2]),
        "static-map": row("static-map", [0.1, 0.4], [0.5, 0.4]),
    }
    assert {label: one.recordings["room"].best_floor for label, one in related_rows(trackers).items()} == dict.fromkeys(
        trackers, "static-map"
    )
    assert shares(trackers, "good") == (0.5, 0.25), "of persistence now, and of static-map one step ahead"
    assert shares(trackers, "oracle") == (None, None)
    assert shares(trackers, "static-map") == (-3.5, 0.0), "below the best floor it is negative"
    assert shares(trackers, "persistence") == (0.0, -0.5)
    assert shares(trackers, "good", "log_loss") == (-1.0, -1.0), "of persistence, which loses less"


def test_there_is_no_share_where_the_oracle_is_hardly_better_than_the_floor():
    trackers = {
        "good": row("kalman", [0.5] * 4, [0.3, 0.5, 0.05, 0.3]),
        "oracle": row("oracle", [1.0] * 4, [0.1, 0.1, 0.1, 0.3985]),
        "persistence": row("persistence", [0.1] * 4, [0.5, 0.4, 0.3, 0.4]),
    }
    assert shares(trackers, "good", "log_loss") == (0.5, -0.333333, 1.25, None)


def test_a_tracker_with_a_lower_headline_score_than_the_best_floor_is_marked_and_no_floor_is():
    trackers = {
        "good": row("kalman", [0.0, 0.5]),
        "poor": row("kalman", [0.9, 0.3]),
        "stopped": row("kalman", [0.9, 0.3], outcome="crashed"),
        "oracle": row("oracle", [1.0, 0.2]),
        "persistence": row("persistence", [0.8, 0.2]),
        "static-map": row("static-map", [0.1, 0.4]),
    }
    found = related_rows(trackers)
    assert [label for label, one in found.items() if one.recordings["room"].below_floor] == ["poor"]
    crashed = trackers | {"persistence": row("persistence", [0.8, 0.2], outcome="crashed")}
    assert not any(one.recordings["room"].below_floor for one in related_rows(crashed).values())


WITH_SHARES = {"a": (0.5, "ok"), "oracle": (0.9, "ok"), "persistence": (0.4, "ok"), "static-map": (0.1, "ok")}


@pytest.mark.parametrize(
    "changed",
    [
        {"oracle": None},
        {"persistence": None, "static-map": None},
        {"oracle": (0.409, "ok")},
        {"persistence": (0.4, "crashed"), "static-map": None},
        {"persistence": (0.4, "crashed")},
        {"a": (0.5, "crashed")},
    ],
    ids=["no oracle", "no floor", "no room between", "half a floor", "one of two floors", "a row scored in part"],
)
def test_there_is_no_share_without_an_oracle_and_every_floor(changed):
    def share(rows):
        made = {name: row(name, [known[0]] * 2, outcome=known[1]) for name, known in rows.items() if known}
        return shares(made, "a")

    assert share(WITH_SHARES) == (0.2, 0.2)
    assert share(WITH_SHARES | changed) == (None, None)


def test_recordings_pooled_have_shares_of_their_own_and_hidden_cells_a_gap():
    trackers = {
        "a": row("a", [0.5] * 2, occluded=[0.2] * 2, pooled=[0.25] * 2),
        "oracle": row("oracle", [1.0] * 2, pooled=[1.0] * 2),
        "p": row("persistence", [0.0] * 2, pooled=[0.0] * 2),
    }
    found = related_rows(trackers)["a"]
    assert found.pooled.estimate("visible", "f1", "oracle_share").value == (0.25, 0.25)
    assert found.recordings["room"].estimate("occluded", "f1", "truth_gap").value == (0.3, 0.3)


def test_a_floor_without_which_no_share_is_known_is_a_notice(tmp_path):
    skills = {"persistence": 0.6, "good": 0.8, "oracle": 1.0}
    summary = summary_of(write_rows(tmp_path, skills, ["a"], persistence=3), ["a"])
    assert "persistence: a floor that is not complete: no share of the oracle" in map(str, summary.notices)


def reversed_lines(rows, description=None):
    """The notices of rankings that reverse; rows are (F1, F1 at 0.5), with further fields; `area` is PR-AUC."""
    steps = synthetic.STEPS + 1
    described = {"crossing": description or synthetic.description()}
    trackers = {}
    for label, (f1, at_half, *more) in rows.items():
        known = {"outcome": "ok", "tracker": "tracker", "stratum": "dynamic"} | dict(more)
        outputs = {"f1": Estimate(value=(f1,) * steps), "at_half": Estimate(value=(at_half,) * steps)}
        area = {"pr_auc": {"area": Estimate(value=(known["area"],) * steps)}} if "area" in known else {}
        strata = {known["stratum"]: {"f1": outputs} | area}
        trial = TrialSummary(outcome=known["outcome"], frames_scored=9, frames_expected=9, strata=strata)
        trackers[label] = TrackerSummary(tracker=known["tracker"], recordings={"crossing": trial})
    run = type("Run", (), {"pools": False, "recordings": described})
    return list(map(str, _reversed_rankings(run, trackers, (F1, PR_AUC))))


def test_a_ranking_that_reverses_names_both_rows_the_stratum_the_horizon_and_all_four_scores():
    """A period of 80 ms has no step at 0.5 s: the notice says 0.48 s, as the tables do."""
    described = synthetic.description(period_s=0.08, steps=synthetic.STEPS)
    (line,) = reversed_lines({"kalman": (0.100, 0.189), "persistence": (0.153, 0.150)}, described)
    assert line == (
        "crossing: the order of trackers depends on the threshold: on dynamic cells 0.48 s ahead persistence is above"
        " kalman in F1 at the chosen thresholds (0.153 and 0.100) and below it in F1 at a threshold of 0.5 (0.150 and"
        " 0.189); 1 more such pair of rows and horizon"
    )


def test_an_order_by_pr_auc_that_is_not_that_by_f1_is_named():
    in_motion = ("stratum", "in-motion")
    rows = {"kalman": (0.286, 0.3, in_motion, ("area", 0.65)), "persistence": (0.444, 0.4, in_motion, ("area", 0.199))}
    (line,) = reversed_lines(rows)
    assert line == (
        "crossing: the order of trackers depends on the score, PR-AUC or F1: on in-motion cells 0.5 s ahead kalman is"
        " above persistence in PR-AUC (0.650 and 0.199) and below it in F1 (0.286 and 0.444); 2 more such pairs of rows"
        " and horizons"
    )


@pytest.mark.parametrize(
    "other",
    [
        (0.5, 0.4),
        (0.6, 0.7),
        (0.5996, 0.7),
        (0.5, 0.7, ("outcome", "crashed")),
        (0.5, 0.7, ("tracker", "oracle")),
        (None, 0.7),
        (0.5, 0.7, ("stratum", "static")),
    ],
    ids=["same order", "equal", "nearly equal", "partial", "ceiling", "undefined", "another stratum"],
)
def test_no_reversed_ranking_is_reported_where_the_order_stays(other):
    assert reversed_lines({"a": (0.6, 0.5), "b": other}) == []


def test_the_reversed_pair_with_the_largest_lead_at_both_thresholds_is_named():
    (line,) = reversed_lines({"a": (0.62, 0.50), "b": (0.60, 0.51), "c": (0.50, 0.60)})
    assert "a is above c" in line


WITH_CONTACTS = (CONTACT_FORESIGHT, F1, PR_AUC)
OF_2_HZ = {"period_s": 0.5, "steps": 5}


def summary(folder, recordings, frames, scores=WITH_CONTACTS, headline="", every_s=1, **drawn):
    """The summary of two rows on recordings of 2 Hz; each forecast has contacts."""
    described = dict.fromkeys((f"seed-{i:02}" for i in range(recordings)), description(**OF_2_HZ))
    drawn |= {"frames": frames, "scores": scores, "every_s": every_s, **OF_2_HZ}
    trials = [
        write_trial(folder, label, name, skill, seed=i, **drawn)
        for i, name in enumerate(described)
        for label, skill in {"persistence": 0.4, "good": 0.8}.items()
    ]
    return summarise(described, trials, [], False, headline=headline)


def too_few(found):
    return [notice.text for notice in found.notices if "too few contacts" in notice.text]


def test_contacts_lead_where_twenty_units_have_one(tmp_path):
    found = summary(tmp_path, recordings=20, frames=2)
    assert found.headline == "contact_foresight.foreseen"
    assert not too_few(found)
    (difference,) = [one for one in found.differences if one.tracker == "good"]
    tests = {(test.stratum, test.horizon_s): test.verdict for test in difference.tests}
    assert tests == {(s, h): "better" for s in ("dynamic", "in-motion") for h in (0.5, 1.0, 2.0)}


def test_contacts_lead_where_fifty_forecasts_a_second_apart_have_one(tmp_path):
    assert summary(tmp_path / "long", recordings=1, frames=50).headline == "contact_foresight.foreseen"
    dense = summary(tmp_path / "dense", recordings=1, frames=49)
    assert dense.headline == "pr_auc.area", "without intervals no score with a threshold leads"
    (notice,) = too_few(dense)
    assert notice == (
        "too few contacts: 49 separate forecasts and 1 units have any, and 50 forecasts or 20 units are needed for"
        " Contact foresight to lead"
    )


def test_the_user_chooses_the_headline_score(tmp_path):
    assert summary(tmp_path, recordings=20, frames=2, headline="f1").headline == "f1.f1"


def test_a_headline_by_which_trackers_are_not_compared_is_refused(tmp_path):
    settings = CompareSettings(recordings=("none.mcap",), headline="brier", out=tmp_path / "run")
    with pytest.raises(ConfigurationError, match="--headline: trackers are not compared by 'brier'"):
        resolve(settings)


def test_where_nothing_is_scored_no_notice_counts_contacts(tmp_path):
    described = {"seed-00": description(**OF_2_HZ)}
    failed = write_trial(tmp_path, "good", "seed-00", 0.8, seed=0, frames=4, scored=2, scores=WITH_CONTACTS, **OF_2_HZ)
    assert not too_few(summarise(described, [failed], [], False))

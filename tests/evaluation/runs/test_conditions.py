"""Deadlines and degraded scans through a whole run: real processes, the results in summary.json."""

from __future__ import annotations

import json
import shutil

import pytest

from gridtrack.evaluation.referee.deadline import Costs
from gridtrack.evaluation.results.columns import SCORES_TABLE
from gridtrack.evaluation.runs import deadline_pass, scorekeeper
from gridtrack.evaluation.runs.passes import AtStrength, Robustness
from gridtrack.evaluation.runs.plan import resolve
from gridtrack.evaluation.runs.robustness_pass import RobustnessRun
from gridtrack.evaluation.runs.runner import run
from gridtrack.evaluation.runs.settings import CompareSettings
from gridtrack.evaluation.runs.trial_record import TrialRecord
from gridtrack.evaluation.scoring.robustness import mismatched_degradations
from gridtrack.recordings.degradation import Degradation

pytestmark = pytest.mark.usefixtures("staged")


@pytest.fixture
def compare(record, tmp_path, progress):
    """`compare(*trackers, **settings)` runs on the small recording and gives the summary."""
    path = record()

    def compare(*trackers, **more):
        defaults = {"recordings": (str(path),), "out": tmp_path / "run", "horizon_s": 1.0, "every_s": 0.5, "jobs": 2}
        return run(resolve(CompareSettings(trackers=trackers, **(defaults | more))), ("gridtrack", "compare"), progress)

    return compare


def trial_of(summary, label):
    return summary.trackers[label].recordings["room"]


def f1_of(result):
    return {name: scores.f1 for name, scores in result.strata.items()}


@pytest.fixture
def costing(monkeypatch):
    """`costing(update_ms, predict_ms)`: what every frame is then measured to cost."""

    def costing(update_ms, predict_ms):
        monkeypatch.setattr(deadline_pass, "_measure", lambda *_: (Costs((update_ms,), (predict_ms,)), 12))

    return costing


def test_a_tracker_without_delay_scores_as_without_a_clock(compare, costing):
    costing(0.0, 0.0)
    result = trial_of(compare("persistence", deadline=True), "persistence")
    assert [at.rate for at in result.deadline.rates] == [0.5, 1.0, 2.0, 4.0]
    assert [at.rate_hz for at in result.deadline.rates] == [5.0, 10.0, 20.0, 40.0]
    for at in result.deadline.rates:
        assert (at.missed, at.frames, at.age_frames.p99) == (0, 110, 0.0)
        assert at.f1 == f1_of(result)


def test_a_busy_tracker_misses_frames_and_scores_less(compare, costing):
    costing(100.0, 50.0)
    result = trial_of(compare("persistence", deadline=True), "persistence")
    half, own, double, _ = result.deadline.rates
    assert [at.missed for at in (half, own, double)] == [0, 55, 73]
    assert own.age_frames.p50 in {2.0, 3.0}
    assert result.deadline.highest_rate_hz == pytest.approx(1000 / 150)
    # persistence's forecast of the step 0 is a copy: two or three frames late it is one of two or three frames ago
    assert own.f1["dynamic"][0] < half.f1["dynamic"][0] < result.strata["dynamic"].f1[0] == 1.0
    assert own.f1["static"][0] > 0.9


def test_durations_are_measured_by_the_trackers_own_clock(compare):
    deadline = trial_of(compare("staged:sleep_s=0.005", deadline=True), "staged").deadline
    assert deadline.update_ms.p50 >= 5.0
    assert deadline.busy_ms.p99 >= deadline.update_ms.p50
    assert deadline.highest_rate_hz == pytest.approx(1000 / deadline.busy_ms.p99, rel=0.02)
    assert deadline.forecast_steps >= 12
    assert all(at.missed <= at.frames for at in deadline.rates)


@pytest.mark.usefixtures("bad_trackers")
def test_the_round_trip_counts_where_the_trackers_clock_is_not_plausible(compare):
    summary = compare("stops-the-clock", "staged:sleep_s=0.015", latency=True, deadline=True)
    liar, honest = (trial_of(summary, label) for label in ("stops-the-clock", "staged"))
    assert (liar.latency_ms.clock, liar.deadline.clock) == ("host", "host")
    assert min(liar.latency_ms.update.p50, liar.latency_ms.predict.p50, liar.deadline.update_ms.p50) >= 15.0
    assert liar.deadline.highest_rate_hz < 1000 / 30
    assert liar.times.update_s >= 110 * 0.015
    assert (honest.latency_ms.clock, honest.deadline.clock) == ("tracker", "tracker")
    assert [notice for notice in summary.notices if "the round trips count" in notice] == [
        "stops-the-clock on room reports far shorter times than the round trips of its calls: the round trips count"
    ]


def test_a_resumed_run_adds_the_deadline_scores(compare, tmp_path):
    assert trial_of(compare("blank"), "blank").deadline is None
    assert trial_of(compare("blank", deadline=True, resume=True), "blank").deadline is not None


@pytest.mark.usefixtures("bad_trackers")
def test_frames_kept_over_a_reset_are_of_no_use_in_another_condition(compare):
    honest, hostile = "staged", "remembers-the-future"  # both forecast the last frame, if nothing is kept
    summary = compare(honest, hostile, deadline=True, degrade=Degradation(beam_dropout=0.5))
    one, other = (trial_of(summary, label) for label in (honest, hostile))
    assert other.robustness.kinds["beam_dropout"][1:] == one.robustness.kinds["beam_dropout"][1:]
    for rate in other.deadline.rates:
        assert rate.f1["dynamic"][-1] < 0.9


def test_a_tracker_that_fails_in_the_deadline_pass_keeps_its_score_with_a_notice(compare, record, tmp_path):
    # without a validation stretch the second stream that it is given is that of the deadline pass
    path, starts = record("plain", stretches={}), tmp_path / "starts"
    summary = compare(f"staged:crash_at=60,starts={starts}", "blank", recordings=(str(path),), deadline=True)
    ended, other = (summary.trackers[label].recordings["plain"] for label in ("staged", "blank"))
    assert (ended.outcome, ended.deadline) == ("ok", None)
    assert other.deadline is not None
    assert any(
        "staged@plain: no measurement of deadlines" in notice and "crashed" in notice for notice in summary.notices
    )


def test_an_interrupt_while_input_is_degraded_keeps_every_score(compare, progress, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(RobustnessRun, "run", interrupted)
    summary = compare("blank", "persistence", degrade=Degradation(range_noise=0.1))
    assert summary.interrupted is True
    assert {trial_of(summary, label).outcome for label in ("blank", "persistence")} == {"ok"}


def test_degraded_input_is_scored_against_the_undegraded_frames(compare):
    summary = compare("persistence", degrade=Degradation(frame_drop=1.0, beam_dropout=0.5))
    result = trial_of(summary, "persistence")
    curves = result.robustness.kinds
    assert list(curves) == ["beam_dropout", "frame_drop"]
    for name, full in (("beam_dropout", 0.5), ("frame_drop", 1.0)):
        assert [point.strength for point in curves[name]] == [0.0, 0.25, 0.5, 1.0]
        assert [point.value for point in curves[name]] == [0.0, 0.25 * full, 0.5 * full, full]
        assert curves[name][0].f1 == f1_of(result)
        at_step_0 = [point.f1["visible"][0] for point in curves[name]]
        # copying a frame of which a part was lost is no copy of the whole
        assert at_step_0[0] == 1.0 > at_step_0[1] > at_step_0[2] > at_step_0[3]
    # at 1 every frame is lost: what persistence has not seen it does not call occupied
    assert curves["frame_drop"][-1].f1["visible"] == (0.0,) * 11


def test_every_tracker_receives_the_same_degraded_frames(compare):
    summary = compare("persistence", "blank", degrade=Degradation(range_noise=0.1))
    one, other = (trial_of(summary, label).robustness.kinds["range_noise"] for label in ("persistence", "blank"))
    digests = [[point.delivered for point in points] for points in (one, other)]
    assert digests[0] == digests[1]
    assert len(set(digests[0])) == 4
    assert summary.recordings["room"].parity is True


def test_mismatched_degraded_frames_are_detected():
    def record(label, digest, value=0.1):
        points = tuple(AtStrength(strength=s, value=s * value, delivered=digest, f1={}) for s in (0.3, 1.0))
        robustness = Robustness(degradation=Degradation(range_noise=value), kinds={"range_noise": points})
        return TrialRecord(schema=2, label=label, recording="room", outcome="ok", steps=1, robustness=robustness)

    same = [("centres", record(label, "aa")) for label in ("one", "two")]
    assert mismatched_degradations(same) == []
    assert mismatched_degradations([*same, ("centres", record("odd", "bb"))]) == ["odd"]
    assert (
        mismatched_degradations([*same, ("raw", record("raw", "cc")), ("centres", record("stronger", "dd", 0.2))]) == []
    )


def test_a_resumed_run_degrades_again_only_for_other_strengths(compare, monkeypatch):
    compare("blank", degrade=Degradation(range_noise=0.1))
    passes = []
    original = RobustnessRun.run
    monkeypatch.setattr(RobustnessRun, "run", lambda *a: (passes.append(1), original(*a))[1])
    compare("blank", degrade=Degradation(range_noise=0.1), resume=True)
    assert passes == []
    summary = compare("blank", degrade=Degradation(range_noise=0.2), resume=True)
    assert trial_of(summary, "blank").robustness.kinds["range_noise"][-1].value == 0.2


def test_an_unexpected_error_ends_its_trial_and_no_other(compare, progress, monkeypatch):
    """After a full disk or a defect in the scorer the other trials are scored and the summary is written."""
    original = scorekeeper.count_cells

    class FullDisk(OSError):
        pass

    def counting(occupancy, *more):
        if not occupancy.any():  # what blank forecasts
            raise FullDisk(28, "No space left on device")
        return original(occupancy, *more)

    monkeypatch.setattr(scorekeeper, "count_cells", counting)
    summary = compare("blank", "persistence")
    failed = trial_of(summary, "blank")
    assert failed.outcome == "failed"
    assert "FullDisk" in failed.reason
    assert "No space left on device" in failed.reason
    assert "test_conditions.py" in failed.reason
    assert trial_of(summary, "persistence").outcome == "ok"
    assert progress.records["blank@room"].outcome == "failed"


def test_a_trial_whose_folder_cannot_be_written_ends_alone(compare, tmp_path):
    compare("persistence")
    (tmp_path / "run" / "blank@room" / SCORES_TABLE.file).mkdir(parents=True)  # in the way
    summary = compare("blank", "persistence", resume=True)
    assert trial_of(summary, "blank").outcome == "failed"
    assert trial_of(summary, "blank").strata == {}
    assert trial_of(summary, "persistence").outcome == "ok"
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["trackers"]["blank"]
    shutil.rmtree(tmp_path / "run" / "blank@room")
    shutil.rmtree(tmp_path / "run" / "persistence@room")
    assert trial_of(compare("blank", "persistence", resume=True), "blank").outcome == "ok"

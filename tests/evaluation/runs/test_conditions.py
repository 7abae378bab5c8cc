"""Deadlines and degraded scans through a whole run: their results, and the exit code if a measurement failed."""

from __future__ import annotations

import pytest

from gridtrack.evaluation.hosting.timing import Call
from gridtrack.evaluation.hosting.tracker_process import TrackerProcess
from gridtrack.evaluation.runs import conditions, jobs
from gridtrack.evaluation.runs.passes import AtStrength, Robustness
from gridtrack.evaluation.runs.summarise import _mismatched_degradations
from gridtrack.evaluation.runs.trial_record import TRIAL_SCHEMA, TrialRecord, read_trial_record
from gridtrack.evaluation.scores.registry import built_in
from gridtrack.recordings.degradation import Degradation

from scenes.room import curve, trial_of

pytestmark = pytest.mark.usefixtures("staged", "trackers_here")


LEADING = {score.name: score.lead.name for score in built_in() if score.may_lead}
"""The leading output of each score that may lead."""


@pytest.fixture
def costing(monkeypatch):
    """`costing(update_ms, predict_ms)` sets the measured cost of every frame."""

    def costing(update_ms, predict_ms):
        calls = conditions._TimedCalls()
        calls.add(Call(update_ms, update_ms), Call(predict_ms, predict_ms))
        monkeypatch.setattr(conditions, "_timed_calls", lambda *_: calls)

    return costing


def test_a_tracker_without_delay_scores_as_without_a_clock(compare, costing):
    costing(0.0, 0.0)
    assert trial_of(compare("persistence"), "persistence").deadline is None
    result = trial_of(compare("persistence", deadline=True, resume=True), "persistence")
    assert [at.rate for at in result.deadline.rates] == [0.5, 1.0, 2.0, 4.0]
    assert [at.rate_hz for at in result.deadline.rates] == [5.0, 10.0, 20.0, 40.0]
    for at in result.deadline.rates:
        assert (at.missed, at.frames, at.age_frames.p99) == (0, 110, 0.0)
        assert at.scores == result.leading(LEADING)


def test_a_timed_tracker_has_the_requests_of_one_that_is_scored(compare, record, monkeypatch):
    """Frame by frame, until the timed pass ends: no request tells a tracker that it is timed."""
    requests = {}

    def recorded(name, told):
        original = getattr(TrackerProcess, name)

        def call(process, argument):
            requests.setdefault(id(process), (process, process.stderr_path.name, []))[2].append(told(argument))
            return original(process, argument)

        monkeypatch.setattr(TrackerProcess, name, call)

    recorded("update", lambda frame: frame.stamp_ns)
    recorded("predict", lambda steps: f"{steps} steps")
    path = str(record("plain", stretches={}))
    compare("persistence", recordings=(path,), latency=True, deadline=True)
    by_log = [(log, asked) for _, log, asked in requests.values()]
    (scored,) = (asked for log, asked in by_log if log == "stderr.log")
    (latency,) = (asked for log, asked in by_log if log == "latency.log")
    timed, *at_rates = (asked for log, asked in by_log if log == "deadline.log")
    assert latency == scored[: len(latency)]
    assert at_rates
    for asked in at_rates:  # persistence misses no frame
        assert timed == asked[: len(timed)]
    assert len([one for one in latency if one == "10 steps"]) > 10


def test_a_tracker_that_is_fast_only_where_it_is_timed_is_a_notice(compare, record, tmp_path):
    path, starts = record("plain", stretches={}, seconds=8), tmp_path / "starts"
    summary = compare(f"staged:sleep_s=0.03,starts={starts},sleeps=first", recordings=(str(path),), latency=True)
    (notice,) = (one for one in map(str, summary.notices) if "when it was timed alone" in one)
    assert notice.startswith("staged on plain: an update took 3")
    assert summary.trackers["staged"].recordings["plain"].latency_ms.device == "NVIDIA H100"


def test_a_busy_tracker_misses_frames_and_scores_less(compare, costing):
    costing(100.0, 50.0)
    result = trial_of(compare("persistence", deadline=True), "persistence")
    half, own, double, _ = result.deadline.rates
    assert [at.missed for at in (half, own, double)] == [0, 55, 73]
    assert own.age_frames.p50 in {2.0, 3.0}
    assert result.deadline.highest_rate_hz == pytest.approx(1000 / 150)
    # persistence's forecast of the step 0 is a copy: two or three frames late it is one of two or three frames ago
    f1_at_half, f1 = half.scores["f1"], own.scores["f1"]
    assert f1["dynamic"][0] < f1_at_half["dynamic"][0] < curve(result, "dynamic", "f1.f1")[0] == 1.0
    assert f1["static"][0] > 0.9


@pytest.mark.usefixtures("bad_trackers")
def test_frames_kept_over_a_reset_are_useless_in_another_condition(compare):
    honest, hostile = "staged", "remembers-the-future"  # both forecast the last frame, if nothing is kept
    summary = compare(honest, hostile, deadline=True, degrade=Degradation(beam_dropout=0.5))
    one, other = (trial_of(summary, label) for label in (honest, hostile))
    assert other.robustness.kinds["beam_dropout"][1:] == one.robustness.kinds["beam_dropout"][1:]
    for rate in other.deadline.rates:
        assert rate.scores["f1"]["dynamic"][-1] < 0.9


@pytest.mark.usefixtures("bad_trackers")
def test_a_tracker_that_keeps_the_frames_in_a_file_is_marked_and_an_honest_one_is_not(compare, tmp_path):
    trackers = f"keeps-a-file:file={tmp_path / 'kept.npy'}", "staged"
    summary = compare(*trackers, deadline=True, degrade=Degradation(beam_dropout=0.5))
    hostile, honest = (trial_of(summary, label) for label in ("keeps-a-file", "staged"))
    assert hostile.robustness.kinds["beam_dropout"][-1].scores["f1"]["dynamic"][5] > 0.9
    assert "which is more than chance" in hostile.memory
    assert honest.memory == ""
    assert [notice for notice in map(str, summary.notices) if "--sandbox prevents it" in notice] == [
        f"keeps-a-file on room: {hostile.memory}: the tracker may remember the recording; --sandbox prevents it"
    ]


def test_an_interrupt_while_input_is_degraded_keeps_every_score(compare, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(jobs, "measure_robustness", interrupted)
    summary = compare("blank", "persistence", degrade=Degradation(range_noise=0.1))
    assert summary.interrupted is True
    assert {trial_of(summary, label).outcome for label in ("blank", "persistence")} == {"ok"}


def test_degraded_input_is_the_same_for_all_and_is_scored_against_the_undegraded_frames(compare):
    summary = compare("persistence", "blank", degrade=Degradation(frame_drop=1.0, beam_dropout=0.5))
    result, blank = (trial_of(summary, label) for label in ("persistence", "blank"))
    curves = result.robustness.kinds
    assert list(curves) == ["beam_dropout", "frame_drop"]
    for name, full in (("beam_dropout", 0.5), ("frame_drop", 1.0)):
        assert [point.strength for point in curves[name]] == [0.0, 0.25, 0.5, 1.0]
        assert [point.value for point in curves[name]] == [0.0, 0.25 * full, 0.5 * full, full]
        assert curves[name][0].scores == result.leading(LEADING)
        at_step_0 = [point.scores["f1"]["visible"][0] for point in curves[name]]
        # copying a frame of which a part was lost is no copy of the whole
        assert at_step_0[0] == 1.0 > at_step_0[1] > at_step_0[2] > at_step_0[3]
        digests = [[point.delivered for point in one.robustness.kinds[name]] for one in (result, blank)]
        assert digests[0] == digests[1]
        assert len(set(digests[0])) == 4
    # at 1 every frame is lost, and persistence calls no unseen cell occupied
    undegraded, *_, lost = (point.scores for point in curves["frame_drop"])
    assert lost["f1"]["visible"] == (0.0,) * 11
    # paths and contacts follow from the undegraded frames; equal risks foresee as many contacts as clear paths
    assert lost["contact_foresight"]["dynamic"][5] == 0.05 < undegraded["contact_foresight"]["dynamic"][5]
    assert summary.recordings["room"].parity is True


def test_mismatched_degraded_frames_are_detected():
    def record(label, digest, value=0.1):
        points = tuple(AtStrength(strength=s, value=s * value, delivered=digest, scores={}) for s in (0.3, 1.0))
        robustness = Robustness(degradation=Degradation(range_noise=value), kinds={"range_noise": points})
        return TrialRecord(
            schema=TRIAL_SCHEMA, label=label, recording="room", outcome="ok", steps=1, robustness=robustness
        )

    same = [("centres", record(label, "aa")) for label in ("one", "two")]
    assert _mismatched_degradations(same) == []
    assert _mismatched_degradations([*same, ("centres", record("odd", "bb"))]) == ["odd"]
    others = [("raw", record("raw", "cc")), ("centres", record("stronger", "dd", 0.2))]
    assert _mismatched_degradations([*same, *others]) == []


def test_a_resumed_run_degrades_again_only_for_other_strengths(compare, monkeypatch):
    compare("blank", degrade=Degradation(range_noise=0.1))
    passes = []
    original = jobs.measure_robustness
    monkeypatch.setattr(jobs, "measure_robustness", lambda *a: (passes.append(1), original(*a))[1])
    compare("blank", degrade=Degradation(range_noise=0.1), resume=True)
    assert passes == []
    summary = compare("blank", degrade=Degradation(range_noise=0.2), resume=True)
    assert trial_of(summary, "blank").robustness.kinds["range_noise"][-1].value == 0.2


@pytest.fixture
def failing(gridtrack, record, tmp_path):
    """`failing(folder, *requested)` runs `staged`, which fails in its second stream, and `blank`."""
    # without a validation stretch the second stream is the first one after the trial
    path, starts = record("plain", seconds=10, stretches={}), tmp_path / "starts"
    trackers = ("--tracker", f"staged:crash_at=60,starts={starts}", "--tracker", "blank")
    fixed = ("compare", "--no-floors", path, *trackers, "--horizon", "1s", "--every", "0.5s", "--out")

    def failing(folder, *requested):
        starts.unlink(missing_ok=True)
        return gridtrack(*fixed, tmp_path / folder, *requested)

    return failing


@pytest.mark.parametrize(
    ("requested", "measured"), [(("--deadline",), "deadline"), (("--degrade", "range-noise=0.1"), "robustness")]
)
def test_a_requested_measurement_that_failed_is_exit_3_of_compare_and_of_regress(
    failing, gridtrack, tmp_path, requested, measured
):
    message = f"gridtrack: not measured: staged@plain: {requested[0]} was requested and failed"
    baseline = tmp_path / "baseline.json"
    assert failing("then").code == 0
    code, _, err = failing("now", *requested)
    assert (code, err.count("gridtrack: not measured: "), message in err) == (3, 1, True)
    failed, other = (read_trial_record(tmp_path / "now" / f"{label}@plain") for label in ("staged", "blank"))
    assert (failed.outcome, getattr(failed, measured)) == ("ok", None), "it keeps its scores"
    assert getattr(other, measured) is not None
    assert gridtrack("regress", tmp_path / "then", "--baseline", baseline, "--update").code == 0
    before = baseline.read_bytes()
    for update in ([], ["--update"]):
        code, _, err = gridtrack("regress", tmp_path / "now", "--baseline", baseline, *update)
        assert (code, message in err, baseline.read_bytes() == before) == (3, True, True)


def test_a_run_without_the_measurements_of_the_baseline_does_not_pass(gridtrack, record, tmp_path):
    path, baseline = record(seconds=14), tmp_path / "baseline.json"
    fixed = ("compare", "--no-floors", path, "--tracker", "blank", "--horizon", "1s", "--every", "0.5s", "--out")
    assert gridtrack(*fixed, tmp_path / "then", "--degrade", "range-noise=0.1").code == 0
    assert gridtrack("regress", tmp_path / "then", "--baseline", baseline, "--update").code == 0
    assert gridtrack(*fixed, tmp_path / "now").code == 0
    code, _, err = gridtrack("regress", tmp_path / "now", "--baseline", baseline)
    assert (code, "blank@room: measured with --degrade for the baseline and not in the run" in err) == (3, True)
    assert gridtrack("regress", tmp_path / "then", "--baseline", baseline).code == 0

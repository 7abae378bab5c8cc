"""A run from its settings to its folder: real processes, real files."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from functools import partial

import numpy as np
import polars as pl
import psutil
import pytest

from gridtrack.common.errors import ConfigurationError
from gridtrack.evaluation.referee.referee import Delivery
from gridtrack.evaluation.referee.samples import read_samples
from gridtrack.evaluation.referee.splits import EvaluationSplit
from gridtrack.evaluation.results.columns import SCORES_TABLE
from gridtrack.evaluation.runs import run_folder, trial
from gridtrack.evaluation.runs.plan import resolve
from gridtrack.evaluation.runs.recipe import Recipe
from gridtrack.evaluation.runs.result_files import RunError, json_of
from gridtrack.evaluation.runs.runner import run
from gridtrack.evaluation.runs.summary import read_summary
from gridtrack.evaluation.runs.train import train_tracker
from gridtrack.evaluation.runs.trial_record import read_trial_record

pytestmark = pytest.mark.usefixtures("staged")


@pytest.fixture
def settings(settings):
    """Those of a small run, in two threads."""
    return partial(settings, jobs=2)


def compare(settings, progress):
    return run(resolve(settings), ("gridtrack", "compare"), progress)


def trial_of(summary, label, recording="room"):
    return summary.trackers[label].recordings[recording]


def test_a_run_writes_every_file_and_the_floor_has_its_known_scores(settings, progress, tmp_path):
    summary = compare(settings("persistence", "blank"), progress)
    assert json.loads(json_of(summary)) == json.loads((tmp_path / "run" / "summary.json").read_text())
    assert read_summary(tmp_path / "run") == summary
    assert (summary.schema_version, summary.interrupted, summary.reference) == (2, False, "persistence")
    for label in ("persistence", "blank"):
        result = trial_of(summary, label)
        assert result.outcome == "ok"
        assert result.frames_scored == result.frames_expected == len(range(20, 110 - 10, 5))
        folder = tmp_path / "run" / f"{label}@room"
        spatial = {"neighbourhoods.parquet", "beams.parquet"}
        assert spatial | {"outcome.json", "scores.parquet", "histogram.parquet", "forecasts.mcap", "stderr.log"} == {
            path.name for path in folder.iterdir()
        }
        assert set(result.strata) == {"visible", "dynamic", "static", "in-motion", "standing"}
        assert len(list(read_samples(folder / "forecasts.mcap"))) == result.frames_scored
        assert {len(curve) for _, curve in result.strata["dynamic"] if isinstance(curve, tuple)} == {11}
    persistence, blank = (trial_of(summary, label).strata for label in ("persistence", "blank"))
    assert persistence["visible"].f1[0] == 1.0
    assert persistence["static"].f1[10] > 0.9 > persistence["dynamic"].f1[10]
    assert blank["visible"].f1 == (0.0,) * 11
    assert blank["visible"].precision == (None,) * 11
    assert blank["visible"].interval.startswith("too short for an interval: 1 unit")
    assert blank["visible"].f1_low is None
    run_file = json.loads((tmp_path / "run" / "run.json").read_text())
    assert run_file["status"] == "complete"
    assert run_file["command"] == ["gridtrack", "compare"]
    assert list(run_file["inputs"].values()) == [resolve(settings("blank")).splits[0].test.sha256]


def test_every_tracker_receives_the_same_frames_and_progress_is_reported(settings, progress, tmp_path):
    summary = compare(settings("persistence", "blank"), progress)
    assert summary.recordings["room"].parity is True
    folders = [tmp_path / "run" / f"{label}@room" for label in ("persistence", "blank")]
    one, other = (pl.read_parquet(folder / SCORES_TABLE.file)["stamp_ns", "delivered"] for folder in folders)
    assert one.equals(other)
    assert progress.frames == progress.delivered == {"persistence@room": 110 + 50, "blank@room": 110 + 50}
    blank, persistence = (progress.records[f"{label}@room"] for label in ("blank", "persistence"))
    assert blank.delivered == persistence.delivered
    assert (blank.role, blank.reference_for) == ("floor", ())
    assert (persistence.role, persistence.reference_for) == ("floor", ("occupancy",))


def test_a_tracker_that_received_other_frames_is_reported(settings, progress, monkeypatch):
    class Tampered(Delivery):
        def __iter__(self):
            for moment in super().__iter__():
                if moment.frame.stamp_ns == 1_014_000_000_000:
                    self._hash.update(b"something else")
                yield moment

    original = trial.TrialRun.__init__

    def tampering(self, the_trial, regions, folder, on_frame, shared):
        original(self, the_trial, regions, folder, on_frame, shared)
        if the_trial.label == "odd":
            self._delivery = Tampered(the_trial.test, on_frame, regions.test)

    monkeypatch.setattr(trial.TrialRun, "__init__", tampering)
    summary = compare(settings("persistence", "blank", "odd=blank"), progress)
    assert summary.recordings["room"].parity is False
    assert [notice for notice in summary.notices if "other frames" in notice] == [
        "odd on room was delivered other frames than the rest: its scores are not comparable"
    ]


def test_a_tracker_that_dies_keeps_its_scores_and_stops_no_other(settings, progress):
    summary = compare(settings("staged:crash_at=60", "persistence"), progress)
    partial = trial_of(summary, "staged")
    assert partial.outcome == "crashed"
    # forecasts at 20, 25 .. 45 have their last frame, 55, before the 60th update
    assert (partial.frames_scored, partial.frames_expected) == (len(range(20, 59 - 10 + 1, 5)), 16)
    assert partial.strata["visible"].f1[0] == 1.0
    assert trial_of(summary, "persistence").outcome == "ok"


def test_a_failure_names_its_stretch_and_counts_its_frames(settings, progress):
    summary = compare(settings("early=staged:crash_at=30,crash_in=1", "staged:crash_at=60"), progress)
    early, late = (trial_of(summary, label) for label in ("early", "staged"))
    assert (early.outcome, early.frames_scored) == ("crashed", 0)
    assert early.reason.startswith("in the validation stretch room.mcap@validation: update with frame 30: killed by")
    assert late.reason.startswith("update with frame 60: killed by SIGABRT")


def test_recoveries_of_a_tracker_are_in_its_outcome_and_give_a_notice(settings, progress, tmp_path, bad_trackers):
    summary = compare(settings("recovers", "persistence"), progress)
    assert trial_of(summary, "recovers").outcome == "ok"
    assert trial_of(summary, "recovers").recoveries == read_trial_record(tmp_path / "run" / "recovers@room").recoveries
    assert trial_of(summary, "recovers").recoveries in {1, 2}  # once in each stretch that it was shown
    assert trial_of(summary, "persistence").recoveries == 0
    assert [notice for notice in summary.notices if notice.startswith("recovers on room continued after ")]


def test_an_invalid_count_of_recoveries_ends_the_trial(settings, progress, bad_trackers):
    outcome = trial_of(compare(settings("recovers:count=-1"), progress), "recovers")
    assert outcome.outcome == "invalid-output"
    assert "'recoveries' is -1" in outcome.reason


def test_a_resumed_run_repeats_only_what_is_incomplete(settings, progress, tmp_path):
    compare(settings("staged:crash_at=60", "persistence"), progress)
    kept = (tmp_path / "run" / "persistence@room" / "scores.parquet").stat().st_mtime_ns
    progress.delivered.clear()
    compare(settings("staged:crash_at=60", "persistence", resume=True), progress)
    assert set(progress.delivered) == {"staged@room"}
    assert (tmp_path / "run" / "persistence@room" / "scores.parquet").stat().st_mtime_ns == kept


def test_a_folder_that_holds_another_run_is_refused_in_one_line(settings, progress):
    compare(settings("blank"), progress)
    with pytest.raises(RunError, match=r"holds a run already: continue it with --resume"):
        compare(settings("blank"), progress)
    with pytest.raises(RunError, match=r"another configuration \(recordings\.room\.horizons_s: then"):
        compare(settings("blank", resume=True, horizon_s=0.5), progress)


def test_a_folder_with_files_that_are_no_run_is_refused_and_they_stay(settings, progress, tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / ".gitignore").write_text("*\n")
    mine = tmp_path / "run" / "summary.json"
    mine.write_text("mine")
    with pytest.raises(RunError, match="has files, and none of a run: name a new or an empty folder with --out"):
        compare(settings("blank"), progress)
    assert mine.read_text() == "mine"
    mine.unlink()
    compare(settings("blank"), progress)


def test_the_reason_of_an_untrained_tracker_is_the_command_that_trains_it(settings, progress):
    result = trial_of(compare(settings("static-map:card=site"), progress), "static-map")
    assert result.outcome == "untrained"
    assert "`gridtrack train static-map " in result.reason
    assert result.strata == {}


def test_a_moving_sensor_is_not_applicable_to_a_tracker_that_cannot_follow_it(settings, progress, record, staged):
    recording = str(record("drive", speed=0.5))
    summary = compare(settings("blank", "staged", recordings=(recording,)), progress)
    assert trial_of(summary, "blank", "drive").outcome == "ok"
    result = trial_of(summary, "staged", "drive")
    assert (result.outcome, result.frames_scored) == ("not-applicable", 0)
    assert "and 'staged' follows only a sensor at rest (moving_sensor is false)" in result.reason


def test_a_plugin_that_cannot_be_loaded_stops_no_other(settings, progress, install):
    install("broken", {"broken": "no_such_module:Tracker"})
    summary = compare(settings("broken:depth=3", "blank"), progress)
    assert trial_of(summary, "broken").outcome == "unavailable"
    assert trial_of(summary, "blank").outcome == "ok"


def test_the_latency_pass_times_complete_trials(settings, progress):
    latency = trial_of(compare(settings("blank", latency=True), progress), "blank").latency_ms
    assert latency.clock == "tracker"
    assert 0 < latency.predict_step.p50 < latency.predict.p50 <= latency.predict.p99
    assert len(latency.update.twentieths) == 21
    assert latency.predict.twentieths[10] == pytest.approx(latency.predict.p50, rel=1e-3)


def test_unknown_options_of_a_tracker_are_refused_before_any_trial(settings, tmp_path):
    with pytest.raises(ConfigurationError, match="did you mean 'crash_at'"):
        resolve(settings("staged:crash_att=3"))
    assert not (tmp_path / "run").exists()


def test_raw_returns_reach_the_tracker_that_requests_them(settings, progress):
    plan = resolve(settings("raw=blank:points=raw", "blank"))
    raw, centres = (next(iter(trial.test)).points for trial in plan.trials)
    assert len(raw) > len(centres)
    summary = run(plan, (), progress)
    assert summary.recordings["room"].parity is True
    assert summary.trackers["raw"].points == "raw"


def start(settings, tmp_path, *trackers):
    """`compare` in a separate process, as started from a terminal."""
    program = (
        "import sys; from gridtrack.evaluation.runs.plan import resolve;"
        "from gridtrack.evaluation.runs.settings import CompareSettings;"
        "from gridtrack.evaluation.runs.runner import run; sys.path.insert(0, sys.argv[2]);"
        "from silent_progress import SilentProgress;"
        "run(resolve(CompareSettings.model_validate_json(sys.argv[1])), (), SilentProgress())"
    )
    source = (
        "class SilentProgress:\n    def note(self, text): ...\n    def planned(self, frames, then=()): ...\n"
        "    def started(self, trial, frames): ...\n"
        "    def advanced(self, trial): ...\n    def ended(self, trial, record): ...\n"
    )
    (tmp_path / "silent_progress.py").write_text(source)
    return subprocess.Popen([sys.executable, "-c", program, settings(*trackers).model_dump_json(), str(tmp_path)])


def wait_until(true, seconds=60.0):
    """Poll; the limit only ends a test that has failed."""
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end, "the condition is still false"
        time.sleep(0.02)


def children(process):
    return psutil.Process(process.pid).children(recursive=True)


def test_an_interrupt_keeps_the_scores_and_leaves_no_process(settings, tmp_path):
    host = start(settings, tmp_path, "persistence", "staged:sleep_s=0.03", "blank")
    done = tmp_path / "run" / "persistence@room" / "outcome.json"
    wait_until(lambda: done.exists() and children(host))
    wait_until((tmp_path / "run" / "staged@room" / "scores.parquet.partial").exists)
    family = children(host)
    host.send_signal(signal.SIGINT)
    assert host.wait(30) == 0
    assert not [process for process in family if process.is_running() and process.status() != psutil.STATUS_ZOMBIE]
    summary = read_summary(tmp_path / "run")
    assert summary.interrupted is True
    assert json.loads((tmp_path / "run" / "run.json").read_text())["status"] == "interrupted"
    assert trial_of(summary, "persistence").outcome == "ok"
    assert trial_of(summary, "staged").outcome == "interrupted"
    assert trial_of(summary, "staged").frames_scored < 16


def test_an_interrupt_while_the_summary_is_made_is_told_and_the_run_goes_on_with_resume(
    settings, progress, tmp_path, monkeypatch
):
    made = run_folder.summarise

    def interrupted(*_):
        os.kill(os.getpid(), signal.SIGINT)
        return made(*_)

    with monkeypatch.context() as patched:
        patched.setattr(run_folder, "summarise", interrupted)
        with pytest.raises(KeyboardInterrupt):
            compare(settings("blank"), progress)
    assert progress.notes[-1].startswith("interrupted while the summary was made: the scores are kept, and --resume")
    assert not (tmp_path / "run" / "summary.json").exists()
    delivered = dict(progress.delivered)
    summary = compare(settings("blank", resume=True), progress)
    assert (trial_of(summary, "blank").outcome, summary.interrupted) == ("ok", False)
    assert progress.delivered == delivered


def test_an_interrupt_ends_a_call_that_hangs(settings, tmp_path):
    host = start(settings, tmp_path, "staged:sleep_s=3600")
    wait_until((tmp_path / "run" / "staged@room" / "stderr.log").exists)
    time.sleep(0.3)  # wherever it then is, in its start or in the call that hangs
    host.send_signal(signal.SIGINT)
    assert host.wait(30) == 0
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["interrupted"] is True


def test_a_folder_locked_by_a_run_is_refused_until_the_run_has_ended(settings, progress, tmp_path):
    trackers = ("staged:sleep_s=0.05",)
    host = start(settings, tmp_path, *trackers)
    wait_until((tmp_path / "run" / "staged@room" / "stderr.log").exists)
    for resume in (True, False):
        with pytest.raises(RunError, match=rf"run: in use by another run \(process {host.pid}\): wait until"):
            compare(settings(*trackers, resume=resume), progress)
    assert progress.delivered == {}
    family = children(host)
    host.kill()
    host.wait()
    wait_until(lambda: not any(process.is_running() for process in family))
    assert trial_of(compare(settings(*trackers, resume=True), progress), "staged").outcome == "ok"


def test_a_run_with_a_killed_host_is_resumed(settings, progress, tmp_path):
    trackers = ("persistence", "staged:sleep_s=0.1")
    host = start(settings, tmp_path, *trackers)
    wait_until((tmp_path / "run" / "persistence@room" / "outcome.json").exists)
    wait_until((tmp_path / "run" / "staged@room" / "scores.parquet.partial").exists)
    family = children(host)
    host.kill()
    host.wait()
    wait_until(lambda: not any(process.is_running() for process in family))
    summary = compare(settings(*trackers, resume=True), progress)
    assert {trial_of(summary, label).outcome for label in ("persistence", "staged")} == {"ok"}
    assert set(progress.delivered) == {"staged@room"}


def test_a_tracker_that_is_killed_ends_alone(settings, tmp_path):
    host = start(settings, tmp_path, "staged:sleep_s=0.02", "persistence")
    wait_until((tmp_path / "run" / "staged@room" / "scores.parquet.partial").exists)
    alive = (process for process in children(host) if process.status() != psutil.STATUS_ZOMBIE)
    victims = [process for process in alive if process.cmdline()[-2:] == ["gridtrack.trackers.serve", "staged"]]
    os.kill(victims[-1].pid, signal.SIGKILL)
    assert host.wait(60) == 0
    summary = read_summary(tmp_path / "run")
    assert trial_of(summary, "staged").outcome == "crashed"
    assert "SIGKILL" in trial_of(summary, "staged").reason
    assert trial_of(summary, "persistence").outcome == "ok"
    assert read_trial_record(tmp_path / "run" / "staged@room").frames_scored < 16


def test_a_run_with_learned_weights_is_scored_and_names_its_training_data(settings, progress, tmp_path, record):
    path = train_tracker(
        Recipe(tracker="static-map", recordings=(str(record()),), out=tmp_path / "weights"), progress.note
    )
    assert path == tmp_path / "weights" / "static-map" / "room.toml"
    summary = compare(settings("static-map", weights=tmp_path / "weights"), progress)
    assert trial_of(summary, "static-map").outcome == "ok"
    assert np.array(trial_of(summary, "static-map").strata["static"].f1).min() > 0.9
    assert not [notice for notice in summary.notices if "learned from" in notice]
    on_train = settings(
        "static-map", weights=tmp_path / "weights", recordings=(f"{record()}@0s-9s",), out=tmp_path / "other"
    )
    with pytest.raises(ConfigurationError, match=r"static-map/room\.toml was trained on frames of the test stretch"):
        resolve(on_train)


def test_region_maps_are_computed_once_for_each_recording(settings, progress, monkeypatch):
    found = []
    original = EvaluationSplit.regions
    monkeypatch.setattr(
        EvaluationSplit, "regions", lambda split, check: (found.append(split.name), original(split, check))[1]
    )
    compare(settings("blank", "persistence"), progress)
    assert found == ["room"]


def test_trials_that_share_a_validation_stretch_choose_their_thresholds_on_it_once(settings, progress, record):
    tests = tuple(
        str(record(name, 8, {}, wall_m=wall_m)) for name, wall_m in (("one", 3.0), ("two", 3.2), ("three", 3.4))
    )
    shared = settings("persistence", "blank", recordings=tests, validation=f"{record('other', 9, {})}@0s-9s", jobs=1)
    summary = compare(shared, progress)
    assert progress.frames == progress.delivered
    assert {name: frames for name, frames in progress.delivered.items() if frames > 80} == {
        "persistence@one": 80 + 90,
        "blank@one": 80 + 90,
    }
    thresholds = [trial_of(summary, "persistence", n).strata["visible"].threshold for n in ("one", "two")]
    assert thresholds[0] == thresholds[1]
    alone = compare(shared.model_copy(update={"recordings": tests[1:2], "out": shared.out / "alone"}), progress)
    assert trial_of(alone, "persistence", "two").strata == trial_of(summary, "persistence", "two").strata


def test_an_unknown_reference_is_refused_with_a_suggestion(settings):
    with pytest.raises(ConfigurationError, match="did you mean 'persistence'"):
        resolve(settings("persistence", "blank", reference="persistance"))


def test_other_rows_are_compared_with_the_requested_reference(settings, progress):
    summary = compare(settings("persistence", "blank", reference="blank"), progress)
    assert [(one.tracker, one.reference) for one in summary.differences] == [("persistence", "blank")]

"""A run from its settings to its folder. The trackers run in this process; test_run_processes.py has real processes."""

from __future__ import annotations

import json
import os
import signal
from types import SimpleNamespace

import polars as pl
import pytest

from gridtrack.common.errors import ConfigurationError
from gridtrack.evaluation.hosting.limits import Limits
from gridtrack.evaluation.hosting.outcome import TrialEnded
from gridtrack.evaluation.hosting.tracker_process import TrackerProcess
from gridtrack.evaluation.referee.referee import Delivery
from gridtrack.evaluation.referee.samples import read_samples
from gridtrack.evaluation.referee.splits import EvaluationSplit
from gridtrack.evaluation.referee.strata import STRATA
from gridtrack.evaluation.runs import plan, run_folder, trial
from gridtrack.evaluation.runs.plan import resolve
from gridtrack.evaluation.runs.result_files import RunError, json_of
from gridtrack.evaluation.runs.runner import Stages, one_of_each_recording, run
from gridtrack.evaluation.runs.summary import read_summary
from gridtrack.evaluation.runs.sums import SUMS_FILE
from gridtrack.evaluation.runs.trial_record import read_trial_record
from gridtrack.evaluation.scores import cells

from scenes.room import curve, trial_of

pytestmark = pytest.mark.usefixtures("staged", "trackers_here")


def test_a_run_writes_every_file_and_the_floor_has_its_known_scores(compare, settings, progress, tmp_path):
    summary = compare("persistence", "blank")
    assert json.loads(json_of(summary)) == json.loads((tmp_path / "run" / "summary.json").read_text())
    assert read_summary(tmp_path / "run") == summary
    assert (summary.schema_version, summary.interrupted, summary.reference) == (3, False, "persistence")
    for label in ("persistence", "blank"):
        result = trial_of(summary, label)
        assert result.outcome == "ok"
        assert result.frames_scored == result.frames_expected == len(range(20, 110 - 10, 5))
        folder = tmp_path / "run" / f"{label}@room"
        written = {path.name for path in folder.iterdir()}
        assert written == {"outcome.json", "sums.parquet", "forecasts.mcap", "stderr.log"}
        assert [name for name in result.strata if not name.startswith("contacts ")] == [*STRATA]
        assert len(list(read_samples(folder / "forecasts.mcap"))) == result.frames_scored
        assert {len(values) for _, values in result.curves()} == {11}
    persistence, blank = (trial_of(summary, label) for label in ("persistence", "blank"))
    assert curve(persistence, "visible", "f1.f1")[0] == 1.0
    assert curve(persistence, "static", "f1.f1")[10] > 0.9 > curve(persistence, "dynamic", "f1.f1")[10]
    assert curve(blank, "visible", "f1.f1") == (0.0,) * 11
    assert curve(blank, "visible", "f1.precision") == (None,) * 11
    assert blank.interval.startswith("too short for an interval: 1 unit")
    assert blank.estimate("visible", "f1", "f1").low is None
    run_file = json.loads((tmp_path / "run" / "run.json").read_text())
    assert run_file["status"] == "complete"
    assert run_file["command"] == ["gridtrack", "compare"]
    assert list(run_file["inputs"].values()) == [resolve(settings("blank")).splits[0].test.sha256]
    assert not (tmp_path / "run" / ".engine").exists()


def test_every_tracker_receives_the_same_frames_and_progress_is_reported(compare, progress, tmp_path, monkeypatch):
    found, regions = [], EvaluationSplit.regions
    monkeypatch.setattr(
        EvaluationSplit, "regions", lambda split, check: (found.append(split.name), regions(split, check))[1]
    )
    summary = compare("persistence", "blank", jobs=2)
    assert found == ["room"], "regions are found once for each recording"
    assert summary.recordings["room"].parity is True
    folders = [tmp_path / "run" / f"{label}@room" for label in ("persistence", "blank")]
    one, other = (pl.read_parquet(folder / SUMS_FILE)["stamp_ns", "delivered"] for folder in folders)
    assert one.equals(other)
    assert progress.frames == progress.delivered == {"persistence@room": 110 + 50, "blank@room": 110 + 50}
    blank, persistence = (progress.records[f"{label}@room"] for label in ("blank", "persistence"))
    assert blank.delivered == persistence.delivered
    assert (blank.role, blank.reference_for) == ("floor", ())
    assert (persistence.role, persistence.reference_for) == ("floor", ("occupancy",))


def test_a_tracker_that_received_other_frames_is_reported(compare, monkeypatch):
    class Tampered(Delivery):
        def __iter__(self):
            for moment in super().__iter__():
                if moment.frame.stamp_ns == 1_014_000_000_000:
                    self._hash.update(b"something else")
                yield moment

    original = trial.TrialRun.__init__

    def tampering(self, the_trial, moments, folder, on_frame, shared):
        original(self, the_trial, moments, folder, on_frame, shared)
        if the_trial.label == "odd":
            self._delivery = Tampered(moments.test, on_frame)

    monkeypatch.setattr(trial.TrialRun, "__init__", tampering)
    summary = compare("persistence", "blank", "odd=blank")
    assert summary.recordings["room"].parity is False
    assert [notice for notice in map(str, summary.notices) if "other frames" in notice] == [
        "odd on room: was delivered other frames than the rest: its scores are not comparable"
    ]


def test_a_tracker_that_fails_names_its_stretch_keeps_its_scores_and_stops_no_other(compare, progress):
    failing = "early=staged:crash_at=30,crash_in=1", "late=staged:crash_at=60"
    summary = compare(*failing, "persistence")
    early, late = (trial_of(summary, label) for label in ("early", "late"))
    assert (early.outcome, early.frames_scored) == ("crashed", 0)
    assert early.reason == "in the validation stretch room.mcap@validation: update with frame 30: RuntimeError: staged"
    # forecasts at 20, 25 .. 45 have their last frame, 55, before the 60th update
    assert (late.outcome, late.frames_scored, late.frames_expected) == ("crashed", len(range(20, 59 - 10 + 1, 5)), 16)
    assert late.reason == "update with frame 60: RuntimeError: staged"
    assert curve(late, "visible", "f1.f1")[0] == 1.0
    assert trial_of(summary, "persistence").outcome == "ok"
    progress.delivered.clear()
    compare(*failing, "persistence", resume=True)
    assert set(progress.delivered) == {"early@room", "late@room"}, "only incomplete trials run again"


@pytest.mark.usefixtures("bad_trackers")
def test_recoveries_of_a_tracker_are_in_its_outcome_and_give_a_notice(compare, tmp_path):
    summary = compare("recovers", "invalid=recovers:count=-1", "persistence")
    recovers, invalid, persistence = (trial_of(summary, label) for label in ("recovers", "invalid", "persistence"))
    assert recovers.outcome == "ok"
    assert recovers.recoveries == read_trial_record(tmp_path / "run" / "recovers@room").recoveries
    assert recovers.recoveries in {1, 2}  # once in each stretch that it was shown
    assert persistence.recoveries == 0
    assert [notice for notice in map(str, summary.notices) if notice.startswith("recovers on room: continued after ")]
    assert (invalid.outcome, "'recoveries' is -1" in invalid.reason) == ("invalid-output", True)


def test_an_unexpected_error_ends_its_trial_and_no_other(compare, progress, monkeypatch):
    """After a full disk or a defect in the scorer the other trials are scored and the summary is written."""
    original = cells.count_cells

    def counting(occupancy, *more):
        if not occupancy.any():  # as blank forecasts
            raise OSError(28, "No space left on device")
        return original(occupancy, *more)

    monkeypatch.setattr(cells, "count_cells", counting)
    summary = compare("blank", "persistence")
    failed = trial_of(summary, "blank")
    assert (failed.outcome, progress.records["blank@room"].outcome) == ("failed", "failed")
    assert failed.reason.startswith("OSError: [Errno 28] No space left on device (test_runner.py, line ")
    assert trial_of(summary, "persistence").outcome == "ok"


def test_a_folder_that_holds_another_run_is_refused_in_one_line(compare):
    compare("blank")
    with pytest.raises(RunError, match=r"holds a run already: continue it with --resume"):
        compare("blank")
    with pytest.raises(RunError, match=r"another configuration \(recordings\.room\.horizons_s: then"):
        compare("blank", resume=True, horizon_s=0.5)


def test_a_folder_with_files_that_are_no_run_is_refused_and_they_stay(compare, tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / ".gitignore").write_text("*\n")
    mine = tmp_path / "run" / "summary.json"
    mine.write_text("mine")
    with pytest.raises(RunError, match="has files, but no run: name a new or an empty folder with --out"):
        compare("blank")
    assert mine.read_text() == "mine"
    mine.unlink()
    compare("blank")


def test_trackers_that_cannot_run_say_why_and_stop_no_other(compare, record, install):
    install("broken", {"broken": "no_such_module:Tracker"})
    recordings = tuple(str(path) for path in (record(), record("drive", speed=0.5)))
    summary = compare("broken:depth=3", "static-map:card=site", "blank", "staged", recordings=recordings)
    assert trial_of(summary, "broken").outcome == "unavailable"
    untrained = trial_of(summary, "static-map")
    assert (untrained.outcome, untrained.strata) == ("untrained", {})
    assert "`gridtrack train static-map " in untrained.reason
    moving = trial_of(summary, "staged", "drive")
    assert (moving.outcome, moving.frames_scored) == ("not-applicable", 0)
    assert "and 'staged' follows only a sensor at rest (moving_sensor is false)" in moving.reason
    assert [trial_of(summary, "blank", name).outcome for name in ("room", "drive")] == ["ok", "ok"]


def test_an_unknown_reference_is_refused_before_any_trial(settings, tmp_path):
    with pytest.raises(ConfigurationError, match="did you mean 'persistence'"):
        resolve(settings("persistence", "blank", reference="persistance"))
    assert not (tmp_path / "run").exists()


def test_other_rows_are_compared_with_the_requested_reference(compare):
    summary = compare("persistence", "blank", reference="blank")
    assert [(one.tracker, one.reference) for one in summary.differences] == [("persistence", "blank")]


def test_raw_returns_reach_the_tracker_that_requests_them(settings, progress):
    plan = resolve(settings("raw=blank:points=raw", "blank"))
    raw, centres = (next(iter(trial.test)).points for trial in plan.trials)
    assert len(raw) > len(centres)
    summary = run(plan, (), progress)
    assert summary.recordings["room"].parity is True
    assert summary.trackers["raw"].points == "raw"


def test_an_interrupt_while_the_summary_is_made_is_noted_and_the_run_continues_with_resume(
    compare, progress, tmp_path, monkeypatch
):
    made = run_folder.summarise

    def interrupted(*_):
        os.kill(os.getpid(), signal.SIGINT)
        return made(*_)

    with monkeypatch.context() as patched:
        patched.setattr(run_folder, "summarise", interrupted)
        with pytest.raises(KeyboardInterrupt):
            compare("blank")
    assert progress.notes[-1].startswith("interrupted while the summary was made: the scores are kept; continue with")
    assert not (tmp_path / "run" / "summary.json").exists()
    delivered = dict(progress.delivered)
    summary = compare("blank", resume=True)
    assert (trial_of(summary, "blank").outcome, summary.interrupted) == ("ok", False)
    assert progress.delivered == delivered


def test_a_lack_of_memory_ends_the_run_like_an_interrupt_with_a_summary(compare, progress, tmp_path, monkeypatch):
    def exhausted(*_):
        raise MemoryError

    monkeypatch.setattr(Stages, "measure_robustness", exhausted)
    summary = compare("blank")
    assert (summary.interrupted, trial_of(summary, "blank").outcome) == (True, "ok")
    assert any(note.startswith("too little memory: the scores so far are kept") for note in progress.notes)
    assert read_summary(tmp_path / "run").interrupted


def test_trials_that_share_a_validation_stretch_choose_their_thresholds_on_it_once(compare, progress, record, tmp_path):
    walls = (("one", 3.0), ("two", 3.2), ("three", 3.4))
    tests = tuple(str(record(name, 8, {}, wall_m=wall_m)) for name, wall_m in walls)
    validation = f"{record('other', 9, {})}@0s-9s"
    summary = compare("persistence", "blank", recordings=tests, validation=validation)
    assert progress.planned_frames == progress.frames == progress.delivered
    assert {name: frames for name, frames in progress.delivered.items() if frames > 80} == {
        "persistence@one": 80 + 90,
        "blank@one": 80 + 90,
    }
    thresholds = [trial_of(summary, "persistence", n).thresholds["visible"] for n in ("one", "two")]
    assert thresholds[0] == thresholds[1]
    alone = compare("persistence", "blank", recordings=tests[1:2], validation=validation, out=tmp_path / "alone")
    assert trial_of(alone, "persistence", "two").strata == trial_of(summary, "persistence", "two").strata


def test_in_a_sandbox_two_trials_of_a_recording_never_run_together():
    """They could talk: one that is ahead knows the future of the other."""
    jobs = [SimpleNamespace(split=SimpleNamespace(path=path), name=f"{path}{i}") for path in "ab" for i in range(3)]
    rounds = [[job.name for job in together] for together in one_of_each_recording([*jobs[:5]])]
    assert rounds == [["a0", "b0"], ["a1", "b1"], ["a2"]]


def test_a_run_in_a_sandbox_goes_in_rounds_unless_the_user_sets_jobs(compare, monkeypatch):
    together, execute = [], Stages._execute_together
    monkeypatch.setattr(
        Stages, "_execute_together", lambda self, jobs: (together.append(len(jobs)), execute(self, jobs))
    )
    monkeypatch.setattr(plan, "check_sandbox", lambda: None)
    monkeypatch.setattr(TrackerProcess, "__enter__", refused)
    compare("persistence", "blank", limits=Limits(sandbox=True), jobs=None)
    assert [count for count in together if count] == [1, 1]
    together.clear()
    compare("persistence", "blank", limits=Limits(sandbox=True), jobs=2, resume=True)
    assert [count for count in together if count] == [2]


def refused(process):
    raise TrialEnded("crashed", "not in this test")

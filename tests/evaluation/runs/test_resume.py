"""Resumed runs: trials that are kept, and trials that run again."""

from __future__ import annotations

import os
import shlex
import sys

import polars as pl
import pytest

from gridtrack.common.errors import GridtrackError
from gridtrack.evaluation.regression.measurement import Unmeasured
from gridtrack.evaluation.regression.measuring import measure_run
from gridtrack.evaluation.runs import jobs, plan, run_folder
from gridtrack.evaluation.runs.jobs import SharedInputs
from gridtrack.evaluation.runs.result_files import RunError
from gridtrack.evaluation.runs.run_folder import run_lock
from gridtrack.evaluation.runs.sums import SUMS_FILE
from gridtrack.evaluation.runs.trial_record import read_trial_record
from gridtrack.reports.run import read_runs

from scenes import truth_scene
from scenes.room import curve, trial_of

pytestmark = pytest.mark.usefixtures("trackers_here")


def edit(folder, old, new):
    """Change the code of the tracker `staged`."""
    path = folder / "staged_tracker.py"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))


def test_another_program_under_the_same_name_is_another_configuration(compare, tmp_path):
    serve = f"{sys.executable} -P -m gridtrack.trackers.serve persistence"
    toml = tmp_path / "trackers.toml"
    toml.write_text(f"[mine]\ncommand = '{serve}'\n")
    compare("mine", trackers_toml=toml)
    program = tmp_path / "another"
    program.write_text(f"#!/bin/sh\nexec {serve}\n")
    program.chmod(0o755)
    toml.write_text(f"[mine]\ncommand = '{program} {shlex.join(shlex.split(serve)[1:])}'\n")
    with pytest.raises(RunError, match=r"another configuration \(trials\.mine@room\.argv"):
        compare("mine", trackers_toml=toml, resume=True)


def test_a_run_is_continued_with_more_trackers_and_recordings_and_not_with_fewer(compare, record, progress, tmp_path):
    compare("blank", "persistence")
    kept = tmp_path / "run" / "persistence@room" / SUMS_FILE
    written = kept.stat().st_mtime_ns
    both, more = (str(record()), str(record("other", wall_m=2.5))), ("blank", "persistence", "still=persistence")
    summary = compare(*more, recordings=both, resume=True)
    assert kept.stat().st_mtime_ns == written, "was not run again"
    assert trial_of(summary, "still").strata == trial_of(summary, "persistence").strata
    assert trial_of(summary, "persistence", "other").outcome == "ok"
    remedy = r": name another folder with --out, or repeat its command"
    with pytest.raises(RunError, match=r"\(tracker 'still' was in it and is not requested now\)" + remedy):
        compare(*more[:2], recordings=both, resume=True)
    with pytest.raises(RunError, match=r"\(recording 'room' was in it and is not requested now\)"):
        compare(*more, recordings=both[1:], resume=True)
    with pytest.raises(RunError, match=r"\(recordings\.other\.forecast_every_frames: then 5, now 2\)"):
        compare(*more, recordings=both, every_s=0.2, resume=True)


def test_a_continued_run_has_the_thresholds_that_its_kept_trials_chose(compare, record, progress, tmp_path):
    recordings = tuple(str(record(name, 8, {}, wall_m=wall_m)) for name, wall_m in (("one", 3.0), ("two", 3.2)))
    validation = f"{record('other', 9, {})}@0s-9s"
    compare("persistence", recordings=recordings[:1], validation=validation)
    continued = compare("persistence", recordings=recordings, validation=validation, resume=True)
    assert progress.planned_frames["persistence@two"] == progress.delivered["persistence@two"] == 80
    whole = compare("persistence", recordings=recordings, validation=validation, out=tmp_path / "whole")
    results = [trial_of(summary, "persistence", "two") for summary in (continued, whole)]
    assert results[0].thresholds == results[1].thresholds
    assert results[0].strata == results[1].strata


def test_trials_kept_from_other_versions_are_reported_in_every_further_run(compare, monkeypatch):
    def notices(versions, *trackers):
        monkeypatch.setattr(run_folder, "versions", lambda: versions)
        return [notice for notice in map(str, compare(*trackers, resume=True).notices) if "trials kept" in notice]

    first, later = {"gridtrack": "0.1.0", "numpy": "2.1", "mcap": "1"}, {"gridtrack": "0.2.0", "mcap": "1"}
    notice = "trials kept from a run with gridtrack 0.1.0, numpy 2.1: 1; now gridtrack 0.2.0, no numpy"
    assert notices(first, "blank") == []
    assert notices(first, "blank") == []
    assert notices(later, "blank", "persistence") == [notice]
    assert notices(later, "blank", "persistence") == [notice]
    newest = later | {"mcap": "2"}
    assert notices(newest, "blank", "persistence") == [notice, "trials kept from a run with mcap 1: 2; now mcap 2"]


def test_a_trial_with_missing_sums_runs_again_and_is_not_kept_from_other_versions(compare, tmp_path, monkeypatch):
    compare("blank")
    (tmp_path / "run" / "blank@room" / SUMS_FILE).unlink()
    monkeypatch.setattr(run_folder, "versions", lambda: {"gridtrack": "0.2.0"})
    summary = compare("blank", resume=True)
    assert curve(trial_of(summary, "blank"), "visible", "f1.f1") == (0.0,) * 11
    assert not [notice for notice in map(str, summary.notices) if "trials kept" in notice]


def test_a_run_that_was_scored_by_other_rules_is_not_continued(compare, monkeypatch):
    compare("blank")
    monkeypatch.setattr(plan, "SCORING_RULES", plan.SCORING_RULES + 1)
    with pytest.raises(RunError, match=r"another configuration \(scoring_rules: then 2, now 3\): name another folder"):
        compare("blank", "persistence", resume=True)


def test_a_tracker_with_edited_code_runs_again_and_the_others_do_not(compare, staged, record, progress):
    both, rows = (str(record()), str(record("other", wall_m=2.5))), ("staged", "again=staged", "persistence")
    compare(*rows, recordings=both)
    progress.delivered.clear()
    compare(*rows, recordings=both, resume=True)
    assert progress.delivered == {}
    edit(staged, "self.last[None]", "0.5 * self.last[None]")
    progress.notes.clear()
    summary = compare(*rows, recordings=both, resume=True)
    assert set(progress.delivered) == {"staged@room", "staged@other", "again@room", "again@other"}
    assert [line for line in progress.notes if "edited" in line] == [
        f"{row}: its code was edited since it ran: 2 of its trials run again" for row in ("staged", "again")
    ]
    brier = [curve(trial_of(summary, row), "visible", "brier.mean")[0] for row in ("staged", "again", "persistence")]
    assert brier[0] == brier[1] > brier[2]


def test_the_scores_of_a_tracker_that_no_longer_starts_are_kept(compare, staged, progress):
    compare("staged")
    edit(staged, "self.last[None]", "self.last[")
    progress.notes.clear()
    assert trial_of(compare("staged", resume=True), "staged").outcome == "ok"
    (line,) = [line for line in progress.notes if "does not start" in line]
    assert line.startswith("staged: its scores are kept, but it does not start now: unavailable: ")


def lost(*_):
    raise OSError(5, "Input/output error")


def test_a_trial_that_fails_before_it_starts_leaves_no_scores_of_the_earlier_run(
    compare, staged, tmp_path, monkeypatch
):
    compare("staged")
    measure_run(tmp_path / "run")
    edit(staged, "self.last[None]", "0.5 * self.last[None]")
    monkeypatch.setattr(SharedInputs, "regions_of", lost)
    assert trial_of(compare("staged", resume=True), "staged").outcome == "failed"
    record = read_trial_record(tmp_path / "run" / "staged@room")
    assert (record.outcome, record.frames_scored) == ("failed", 0)
    with pytest.raises(Unmeasured, match=r"staged@room: failed: OSError: .*Input/output error"):
        measure_run(tmp_path / "run")


def test_an_oracle_that_fails_before_it_starts_leaves_no_scores_of_the_earlier_run(compare, tmp_path, monkeypatch):
    recordings = (str(truth_scene.write_recording(tmp_path / "scene.mcap", seconds=12)),)
    compare("persistence", recordings=recordings)
    oracle = tmp_path / "run" / "oracle@scene"
    (oracle / SUMS_FILE).unlink()
    monkeypatch.setattr(jobs, "run_oracle", lost)
    compare("persistence", recordings=recordings, resume=True)
    assert read_trial_record(oracle) is None
    assert read_trial_record(tmp_path / "run" / "persistence@scene").outcome == "ok"


def test_a_changed_file_of_scores_is_refused_by_readers_and_scored_again_with_resume(compare, tmp_path):
    compare("blank")
    path = tmp_path / "run" / "blank@room" / "sums.parquet"
    record = read_trial_record(path.parent)
    assert set(record.files) == {"sums.parquet", "forecasts.mcap"}
    original = path.read_bytes()
    pl.read_parquet(path).with_columns(stamp_ns=pl.col("stamp_ns") + 1).write_parquet(path)
    for read in (read_runs, lambda paths: [measure_run(path) for path in paths]):
        with pytest.raises(GridtrackError, match=r"sums\.parquet: changed since the trial wrote it"):
            read([tmp_path / "run"])
    compare("blank", resume=True)
    assert pl.read_parquet(path).equals(pl.read_parquet(original))
    assert read_runs([tmp_path / "run"])[0].summary.trackers


def test_a_run_with_a_link_in_it_is_not_continued(compare, tmp_path):
    """The files of the trial would be written into the folder of the user."""
    compare("blank")
    mine = tmp_path / "mine"
    mine.mkdir()
    (tmp_path / "run" / "persistence@room").symlink_to(mine)
    with pytest.raises(RunError, match=r"run/persistence@room: a link; .*: remove it$"):
        compare("blank", "persistence", resume=True)
    assert not list(mine.iterdir())


def test_a_file_that_another_process_changes_during_the_run_fails_its_trial(compare, monkeypatch, tmp_path):
    """Without a sandbox a tracker can write into the folder of the run."""
    summarised = run_folder.RunFolder.finish

    def tampered(self, *args, **options):
        sums = tmp_path / "run" / "blank@room" / SUMS_FILE
        sums.write_bytes((tmp_path / "run" / "persistence@room" / SUMS_FILE).read_bytes())
        return summarised(self, *args, **options)

    monkeypatch.setattr(run_folder.RunFolder, "finish", tampered)
    summary = compare("blank", "persistence")
    blank = trial_of(summary, "blank")
    assert (blank.outcome, blank.strata) == ("failed", {})
    assert blank.reason.startswith("another process changed sums.parquet after the trial wrote it")
    assert trial_of(summary, "persistence").outcome == "ok"
    monkeypatch.undo()
    assert trial_of(compare("blank", "persistence", resume=True), "blank").outcome == "ok"


def test_links_that_an_engine_left_in_a_killed_run_stop_nothing(compare, tmp_path):
    """The claims of jobs of Slurm are links."""
    compare("blank")
    scratch = tmp_path / "run" / ".engine" / "x"
    scratch.mkdir(parents=True)
    (scratch / "claim").symlink_to("17 0")
    assert read_runs([tmp_path / "run"])[0].recordings == ("room",)
    assert trial_of(compare("blank", "persistence", resume=True), "persistence").outcome == "ok"


@pytest.mark.parametrize(
    ("link", "reason"), [(os.symlink, "cannot be opened"), (os.link, "a file with a second name")], ids=["soft", "hard"]
)
def test_a_lock_that_is_a_link_is_not_written_to(tmp_path, link, reason):
    mine = tmp_path / "mine"
    mine.write_text("precious")
    (tmp_path / "run").mkdir()
    link(mine, tmp_path / "run" / ".lock")
    with pytest.raises(RunError, match=rf"run/\.lock: {reason}"), run_lock(tmp_path / "run"):
        pass
    assert mine.read_text() == "precious"

"""Resumed runs: trials kept and trials run again; weights and their names in results."""

from __future__ import annotations

import json
import shlex
import shutil
import sys
from functools import partial
from pathlib import Path

import polars as pl
import pytest

from gridtrack.common.errors import GridtrackError, WeightsError
from gridtrack.evaluation.regression.measurement import Unmeasured
from gridtrack.evaluation.regression.measuring import measure_run
from gridtrack.evaluation.results.columns import HISTOGRAM_TABLE, SCORES_TABLE
from gridtrack.evaluation.runs import jobs, plan, run_folder
from gridtrack.evaluation.runs.jobs import SharedInputs
from gridtrack.evaluation.runs.learned import find_weights
from gridtrack.evaluation.runs.plan import resolve
from gridtrack.evaluation.runs.recipe import Recipe
from gridtrack.evaluation.runs.result_files import RunError
from gridtrack.evaluation.runs.runner import run
from gridtrack.evaluation.runs.train import train_tracker
from gridtrack.evaluation.runs.trial_record import read_trial_record
from gridtrack.reports.run import read_runs

from scenes import truth_scene


@pytest.fixture
def settings(settings):
    """Those of a small run, in one thread."""
    return partial(settings, jobs=1)


def edit(folder, old, new):
    """Change the code of the tracker `staged`."""
    path = folder / "staged_tracker.py"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))


def test_another_program_under_the_same_name_is_another_configuration(settings, tmp_path, progress):
    serve = f"{sys.executable} -P -m gridtrack.trackers.serve persistence"
    toml = tmp_path / "trackers.toml"
    toml.write_text(f"[mine]\ncommand = '{serve}'\n")
    run(resolve(settings("mine", trackers_toml=toml)), (), progress)
    program = tmp_path / "another"
    program.write_text(f"#!/bin/sh\nexec {serve}\n")
    program.chmod(0o755)
    toml.write_text(f"[mine]\ncommand = '{program} {shlex.join(shlex.split(serve)[1:])}'\n")
    with pytest.raises(RunError, match=r"another configuration \(trials\.mine@room\.argv"):
        run(resolve(settings("mine", trackers_toml=toml, resume=True)), (), progress)


def test_a_run_is_continued_with_more_trackers_and_recordings_and_keeps_its_scores(
    settings, record, tmp_path, progress
):
    run(resolve(settings("blank", "persistence")), (), progress)
    kept = tmp_path / "run" / "persistence@room" / SCORES_TABLE.file
    written = kept.stat().st_mtime_ns
    recordings = (str(record()), str(record("other", wall_m=2.5)))
    more = settings("blank", "persistence", "still=persistence", recordings=recordings, resume=True)
    summary = run(resolve(more), (), progress)
    assert kept.stat().st_mtime_ns == written, "was not run again"
    scores = {label: row.recordings for label, row in summary.trackers.items()}
    assert scores["still"]["room"].strata == scores["persistence"]["room"].strata
    assert scores["persistence"]["other"].outcome == "ok"


def test_trials_kept_from_other_versions_are_told_in_every_further_run(settings, monkeypatch, progress):
    def notices(versions, *trackers):
        monkeypatch.setattr(run_folder, "versions", lambda: versions)
        summary = run(resolve(settings(*trackers, resume=True)), (), progress)
        return [notice for notice in summary.notices if "trials kept" in notice]

    first, later = {"gridtrack": "0.1.0", "numpy": "2.1", "mcap": "1"}, {"gridtrack": "0.2.0", "mcap": "1"}
    told = "trials kept from a run with gridtrack 0.1.0, numpy 2.1: 1; now gridtrack 0.2.0, no numpy"
    assert notices(first, "blank") == []
    assert notices(first, "blank") == []
    assert notices(later, "blank", "persistence") == [told]
    assert notices(later, "blank", "persistence") == [told]
    newest = later | {"mcap": "2"}
    assert notices(newest, "blank", "persistence") == [told, "trials kept from a run with mcap 1: 2; now mcap 2"]


def test_a_trial_that_runs_again_is_not_kept_from_other_versions(settings, tmp_path, monkeypatch, progress):
    run(resolve(settings("blank")), (), progress)
    (tmp_path / "run" / "blank@room" / SCORES_TABLE.file).unlink()
    monkeypatch.setattr(run_folder, "versions", lambda: {"gridtrack": "0.2.0"})
    assert not [n for n in run(resolve(settings("blank", resume=True)), (), progress).notices if "trials kept" in n]


def test_a_run_is_not_continued_without_a_tracker_or_a_recording_of_it(settings, record, progress):
    both = str(record()), str(record("other", wall_m=2.5))
    run(resolve(settings("blank", "persistence", recordings=both)), (), progress)
    what_to_do = r": name another folder with --out, or repeat its command"
    with pytest.raises(RunError, match=r"\(tracker 'persistence' was in it and is not requested now\)" + what_to_do):
        run(resolve(settings("blank", recordings=both, resume=True)), (), progress)
    with pytest.raises(RunError, match=r"\(recording 'room' was in it and is not requested now\)"):
        run(resolve(settings("blank", "persistence", recordings=both[1:], resume=True)), (), progress)
    with pytest.raises(RunError, match=r"\(recordings\.other\.forecast_every_frames: then 5, now 2\)"):
        run(resolve(settings("blank", "persistence", recordings=both, every_s=0.2, resume=True)), (), progress)


def test_a_run_that_was_scored_by_other_rules_is_not_continued(settings, monkeypatch, progress):
    run(resolve(settings("blank")), (), progress)
    monkeypatch.setattr(plan, "SCORING_RULES", plan.SCORING_RULES + 1)
    with pytest.raises(RunError, match=r"another configuration \(scoring_rules: then 1, now 2\): name another folder"):
        run(resolve(settings("blank", "persistence", resume=True)), (), progress)


def test_a_trial_with_missing_counts_runs_again(settings, tmp_path, progress):
    run(resolve(settings("blank")), (), progress)
    (tmp_path / "run" / "blank@room" / HISTOGRAM_TABLE.file).unlink()
    summary = run(resolve(settings("blank", resume=True)), (), progress)
    assert summary.trackers["blank"].recordings["room"].strata["visible"].f1 == (0.0,) * 11


def test_a_tracker_whose_code_was_edited_runs_again_and_the_others_do_not(settings, staged, record, progress):
    both = str(record()), str(record("other", wall_m=2.5))
    rows = "staged", "again=staged", "persistence"
    run(resolve(settings(*rows, recordings=both)), (), progress)
    progress.delivered.clear()
    run(resolve(settings(*rows, recordings=both, resume=True)), (), progress)
    assert progress.delivered == {}
    edit(staged, "self.last[None]", "0.5 * self.last[None]")
    progress.notes.clear()
    summary = run(resolve(settings(*rows, recordings=both, resume=True)), (), progress)
    assert set(progress.delivered) == {"staged@room", "staged@other", "again@room", "again@other"}
    told = [line for line in progress.notes if "edited" in line]
    assert told == [
        f"{row}: its code was edited since it ran: 2 of its trials run again" for row in ("staged", "again")
    ]
    trials = [summary.trackers[row].recordings["room"] for row in ("staged", "again", "persistence")]
    brier = [trial.strata["visible"].brier[0] for trial in trials]
    assert brier[0] == brier[1] > brier[2]


def test_what_a_tracker_has_scored_that_no_longer_starts_is_kept(settings, staged, progress):
    run(resolve(settings("staged")), (), progress)
    edit(staged, "self.last[None]", "self.last[")
    progress.notes.clear()
    summary = run(resolve(settings("staged", resume=True)), (), progress)
    assert summary.trackers["staged"].recordings["room"].outcome == "ok"
    (line,) = [line for line in progress.notes if "does not start" in line]
    assert line.startswith("staged: what it has scored is kept, but it does not start now: unavailable: ")


def test_a_trial_that_fails_before_it_starts_leaves_no_scores_of_the_earlier_run(
    settings, staged, tmp_path, progress, monkeypatch
):
    run(resolve(settings("staged")), ("gridtrack", "compare"), progress)
    measure_run(tmp_path / "run")
    edit(staged, "self.last[None]", "0.5 * self.last[None]")

    def lost(*_):
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(SharedInputs, "regions_of", lost)
    summary = run(resolve(settings("staged", resume=True)), ("gridtrack", "compare"), progress)
    assert summary.trackers["staged"].recordings["room"].outcome == "failed"
    record = read_trial_record(tmp_path / "run" / "staged@room")
    assert (record.outcome, record.frames_scored) == ("failed", 0)
    with pytest.raises(Unmeasured, match=r"staged@room: failed: OSError: .*Input/output error"):
        measure_run(tmp_path / "run")


def test_an_oracle_that_fails_before_it_starts_leaves_no_scores_of_the_earlier_run(
    settings, tmp_path, progress, monkeypatch
):
    scored = settings("persistence", recordings=(str(truth_scene.write_recording(tmp_path / "scene.mcap")),))
    run(resolve(scored), (), progress)
    oracle = tmp_path / "run" / "oracle@scene"
    (oracle / HISTOGRAM_TABLE.file).unlink()

    def lost(*_):
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(jobs, "run_oracle", lost)
    run(resolve(scored.model_copy(update={"resume": True})), (), progress)
    assert read_trial_record(oracle) is None
    assert read_trial_record(tmp_path / "run" / "persistence@scene").outcome == "ok"


def test_the_suggested_training_has_the_grid_and_rate_of_the_comparison(settings):
    (trial,) = resolve(settings("static-map")).trials
    assert trial.how_to_train.endswith("room.mcap`, then compare again with --resume")
    (trial,) = resolve(settings("static-map", grid="30x0.1", rate_hz=5.0)).trials
    assert "room.mcap --grid 30x0.1@-1.5,-1.5 --rate 5`" in trial.how_to_train


def test_a_missing_folder_of_weights_is_refused(settings, tmp_path):
    with pytest.raises(WeightsError, match="wieghts: no such folder of weights"):
        resolve(settings("static-map", weights=tmp_path / "wieghts"))
    assert find_weights("static-map", "room", tmp_path, "site") is None


def test_a_run_names_its_weights_without_the_folders_of_the_machine(settings, record, tmp_path, progress):
    weights = tmp_path / "weights"
    train_tracker(Recipe(tracker="static-map", recordings=(str(record()),), out=weights), lambda _: None)
    run(resolve(settings("static-map", weights=weights)), (), progress)
    kept = json.loads(Path(tmp_path, "run", "run.json").read_text())["weights"]
    assert kept["static-map@room"]["name"] == "static-map/room.toml"
    assert set(kept["static-map@room"]) == {"name", "sha256", "labelled_scans"}


def test_two_trainings_of_a_tracker_are_compared_each_with_the_weights_of_its_row(settings, record, tmp_path):
    for name in ("first", "second"):
        train_tracker(Recipe(tracker="static-map", recordings=(str(record()),), out=tmp_path / name), lambda _: None)
    first, second = resolve(
        settings(*(f"{n}=static-map:weights={tmp_path / n}" for n in ("first", "second")), weights=tmp_path / "first")
    ).trials
    assert [trial.weights.path.parent.parent.name for trial in (first, second)] == ["first", "second"]


def test_weights_of_an_interrupted_training_are_a_notice(settings, record, tmp_path):
    path = train_tracker(Recipe(tracker="static-map", recordings=(str(record()),), out=tmp_path), lambda _: None)
    path.write_text(path.read_text().replace('interrupted = ""', 'interrupted = "update 3 of 9"'))
    (notice,) = resolve(settings("static-map", weights=tmp_path)).notices
    assert notice == "static-map: static-map/room.toml is of a training that was interrupted at update 3 of 9"


def test_a_row_with_its_own_folder_of_weights_uses_no_others(settings, record, tmp_path):
    train_tracker(Recipe(tracker="static-map", recordings=(str(record()),), out=tmp_path / "given"), lambda _: None)
    with pytest.raises(WeightsError, match="empty: no such folder of weights"):
        resolve(settings(f"static-map:weights={tmp_path / 'empty'}", weights=tmp_path / "given"))
    (tmp_path / "empty").mkdir()
    with pytest.raises(WeightsError, match=r"empty: no weights of static-map for the site 'room'"):
        resolve(settings(f"static-map:weights={tmp_path / 'empty'}", weights=tmp_path / "given"))


def test_weights_exchanged_in_mid_run_are_not_used(settings, record, tmp_path, progress):
    """The trial uses the files whose hash is recorded, also where the site is trained again after the plan was made."""
    for name, options in (("given", {}), ("other", {"prior_frames": 1000.0})):
        walls = record(name, wall_m=3.0 if name == "given" else 2.0)
        train_tracker(
            Recipe(tracker="static-map", options=options, recordings=(str(walls),), out=tmp_path / name), lambda _: None
        )
    weights = tmp_path / "given" / "static-map"

    class Exchanging(type(progress)):
        def started(self, trial, frames):
            shutil.copytree(tmp_path / "other" / "static-map", weights, dirs_exist_ok=True)

    def scored(out, watching):
        run(resolve(settings("static-map", weights=tmp_path / "given", out=tmp_path / out)), (), watching)
        return read_trial_record(tmp_path / out / "static-map@room")

    before, during, after = scored("a", progress), scored("b", Exchanging()), scored("c", progress)
    assert before.weights_sha256 == during.weights_sha256 != after.weights_sha256
    scores = "scores.parquet"
    assert before.files[scores] == during.files[scores] != after.files[scores]


def test_a_reason_names_the_users_file_of_weights_and_not_its_copy(settings, record, tmp_path, progress):
    train_tracker(Recipe(tracker="static-map", recordings=(str(record()),), out=tmp_path / "w"), lambda _: None)
    card, other_grid = tmp_path / "w" / "static-map" / "room.toml", settings("static-map", weights=tmp_path / "w")
    summary = run(resolve(other_grid.model_copy(update={"grid": "20x0.4@-1,-4"})), (), progress)
    result = summary.trackers["static-map"].recordings["room"]
    assert result.outcome == "not-applicable"
    assert result.reason.startswith(f"{card}: made for grid 40x0.2@-1,-4, but this is 20x0.4@-1,-4")


def test_a_changed_file_of_scores_is_refused_by_readers_and_scored_again_with_resume(settings, tmp_path, progress):
    run(resolve(settings("blank")), ("gridtrack", "compare"), progress)
    path = tmp_path / "run" / "blank@room" / "scores.parquet"
    record = read_trial_record(path.parent)
    tables = {"scores.parquet", "histogram.parquet", "neighbourhoods.parquet", "beams.parquet"}
    assert set(record.files) == {*tables, "forecasts.mcap"}
    original = path.read_bytes()
    pl.read_parquet(path).with_columns(tp=pl.col("tp") + 1).write_parquet(path)
    for read in (read_runs, lambda paths: [measure_run(path) for path in paths]):
        with pytest.raises(GridtrackError, match=r"scores\.parquet: changed since the trial wrote it"):
            read([tmp_path / "run"])
    run(resolve(settings("blank", resume=True)), ("gridtrack", "compare"), progress)
    assert pl.read_parquet(path).equals(pl.read_parquet(original))
    assert read_runs([tmp_path / "run"])[0].summary.trackers

"""The commands that messages print train as printed, on frames that are not scored."""

from __future__ import annotations

import re
import shlex
from dataclasses import replace

import pytest
from typer.testing import CliRunner

from gridtrack.cli import app
from gridtrack.common.errors import ConfigurationError, RecordingError
from gridtrack.evaluation.runs.jobs import SharedInputs, TrialJob
from gridtrack.evaluation.runs.plan import resolve
from gridtrack.evaluation.runs.settings import CompareSettings
from gridtrack.evaluation.runs.trial import unstarted
from gridtrack.evaluation.runs.trial_record import read_trial_record
from gridtrack.trackers.training.weights import read_card

pytestmark = pytest.mark.usefixtures("home", "trackers_here")


def gridtrack(*words):
    return CliRunner().invoke(app, words, catch_exceptions=False)


def compare(recording, folder, *options):
    """The reason of static-map's trial on `recording`, empty if it is complete. General weights are not used."""
    command = ("compare", "--no-floors", str(recording), "--tracker", "static-map:card=site", "--horizon", "0.5s")
    gridtrack(*command, *options, "--jobs", "1", "--out", str(folder))
    (trial,) = folder.glob("static-map@*")
    return read_trial_record(trial).reason


def run_command_in(text):
    """Run the command line in backquotes."""
    (command,) = re.findall(r"`gridtrack ([^`]*)`", text)
    assert gridtrack(*shlex.split(command)).exit_code == 0


def planned(folder, *recordings, segment_s=None):
    """What static-map lacks for its trials on `recordings`, "" for weights that learned from none of their frames."""
    given = {"recordings": tuple(map(str, recordings)), "trackers": ("static-map:card=site",), "no_floors": True}
    trials = resolve(CompareSettings(**given, horizon_s=0.5, segment_s=segment_s, out=folder / "planned")).trials
    assert len(trials) >= len(recordings)
    (lacking,) = {"" if trial.weights else trial.how_to_train for trial in trials}
    return lacking


def test_the_hint_of_an_untrained_tracker_trains_it_for_the_same_comparison(record, tmp_path):
    path = record("my room")
    reason = compare(path, tmp_path / "run")
    assert reason.endswith("`, then compare again with --resume, or name a folder of weights with --weights")
    run_command_in(reason)
    assert compare(path, tmp_path / "run", "--resume") == ""


@pytest.mark.parametrize(
    ("stretches", "compared", "segment_s"),
    [
        (None, ("@0s-12s",), None),  # which has frames of the stretch `train`
        ({}, ("@0s-8s",), None),
        ({}, ("@9s-20s",), None),
        ({"validation": (0.0, 5.0)}, ("@12s-20s",), None),
        (None, ("@0s-4s", "@4s-8s", "@17s-20s"), None),  # the first is the stretch `train`
        (None, ("@4s-7s", "@9s-12s"), None),  # the first has frames of the stretch `validation`
        ({}, ("@0s-4s", "@4s-8s", "@17s-20s"), None),
        ({}, ("@0s-30s",), 10.0),
    ],
)
def test_the_hint_of_one_trial_keeps_out_of_the_stretches_of_the_others(
    record, tmp_path, stretches, compared, segment_s
):
    path = record(seconds=45 if segment_s else 20, stretches=stretches)
    recordings = [f"{path}{part}" for part in compared]
    run_command_in(planned(tmp_path, *recordings, segment_s=segment_s))
    assert planned(tmp_path, *recordings, segment_s=segment_s) == ""


def test_the_hint_of_a_trial_on_another_machine_is_the_whole_runs(record, settings, tmp_path):
    """A worker knows one recording and stretch of the run: it would name the stretch that another one is scored on."""
    path = record(stretches={})
    both = settings("static-map:card=site", recordings=(f"{path}@0s-4s", f"{path}@14s-20s"), horizon_s=0.5)
    trial = resolve(both).trials[0]
    alone = replace(trial, others=())
    assert alone.how_to_train != trial.how_to_train
    work = TrialJob(trial, tmp_path / "trial", SharedInputs(both, print, tmp_path, 1))
    (tmp_path / "trial").mkdir()
    there = unstarted(alone).model_copy(update={"outcome": "untrained", "reason": alone.how_to_train})
    assert work.accepted(there).reason == trial.how_to_train
    assert read_trial_record(tmp_path / "trial").reason == trial.how_to_train
    ok = there.model_copy(update={"outcome": "ok", "reason": ""})
    assert work.accepted(ok) == ok


def test_stretches_of_its_own_that_another_trial_tests_are_not_named(record, tmp_path):
    """All of the recording is compared: the rest after a training is the end of it."""
    path = record(stretches={"train": (0.0, 4.0), "validation": (4.0, 9.0)})
    reason = planned(tmp_path, f"{path}@0s-10s", f"{path}@10s-20s")
    assert f"train static-map {path}@0s-11.9s --validation {path}@11.9s-15.9s`" in reason
    assert f"then compare the rest, {path}@15.9s-, into another folder" in reason


def test_where_all_of_a_recording_is_compared_the_hint_leaves_a_rest_to_compare_on(record, tmp_path):
    path = record(stretches={})
    reason = planned(tmp_path, path)
    run_command_in(reason)
    (rest,) = re.findall(r"then compare the rest, (\S+), into another folder", reason)
    assert planned(tmp_path, rest) == ""


def test_a_recording_without_frames_to_spare_has_no_command(record, tmp_path):
    path = record(seconds=9, stretches={})
    assert "train it on a longer recording of this site" in planned(tmp_path, path)


def test_a_training_without_validation_prints_a_command_with_one(record, tmp_path):
    path = record(stretches={})
    with pytest.raises(ConfigurationError, match=r"no validation stretch; name one with --validation, or run") as error:
        gridtrack("train", "static-map", str(path), "--out", str(tmp_path / "weights"))
    run_command_in(str(error.value))
    assert (tmp_path / "weights" / "static-map" / "room.toml").exists()


def test_the_command_for_a_folder_trains_on_all_recordings_in_it(record, tmp_path):
    folder = record("a", stretches={}).parent
    record("b", wall_m=2.5, stretches={})
    with pytest.raises(ConfigurationError, match=r"no validation stretch; name one with --validation, or run") as error:
        gridtrack("train", "static-map", f"{folder}@2s-", "--general", "--out", str(tmp_path / "weights"))
    run_command_in(str(error.value))
    card = read_card(tmp_path / "weights" / "static-map" / "general.toml")
    assert [data.recording for data in card.train] == ["a.mcap@2s-12.7s", "b.mcap@2s-"]
    assert [data.recording for data in card.validation] == ["a.mcap@12.7s-19.9s"]


@pytest.mark.parametrize("stretch", ["@0s-200s", "@unknown"])
def test_a_range_in_a_message_is_one_of_the_recording(record, tmp_path, stretch):
    path = record(stretches={})
    with pytest.raises(RecordingError) as error:
        planned(tmp_path, f"{path}{stretch}")
    (suggested,) = re.findall(r"(?:\(|seconds: )(/\S+@\S+)\)", str(error.value))
    planned(tmp_path, suggested)


def test_no_stretch_is_suggested_where_the_sensor_always_moves(record, tmp_path, staged):
    moving = record("moving", seconds=20, speed=0.5)
    rows = ("--no-floors", "--tracker", "staged")
    gridtrack("compare", str(moving), *rows, "--horizon", "0.5s", "--out", str(tmp_path / "moving"))
    reason = read_trial_record(tmp_path / "moving" / "staged@moving").reason
    assert "at rest nowhere for 10 s" in reason
    assert "@" not in reason.partition("the sensor moves")[2]

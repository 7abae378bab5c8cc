"""The commands that messages print train as printed, on frames that are not scored."""

from __future__ import annotations

import re
import shlex

import pytest
from typer.testing import CliRunner

from gridtrack.cli import app
from gridtrack.common.errors import ConfigurationError, RecordingError
from gridtrack.evaluation.results.trial_record import read_trial_record


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "home"))


def gridtrack(*words):
    return CliRunner().invoke(app, words, catch_exceptions=False)


def compare(recording, folder, *options):
    """The reason of static-map's trial on `recording`, empty where it is complete. General weights are not used."""
    command = ("compare", str(recording), "--tracker", "static-map:card=site", "--horizon", "0.5s", "--jobs", "1")
    gridtrack(*command, *options, "--out", str(folder))
    (trial,) = folder.glob("static-map@*")
    return read_trial_record(trial).reason


def run_command_in(text):
    """Run the command line in backquotes."""
    (command,) = re.findall(r"`gridtrack ([^`]*)`", text)
    assert gridtrack(*shlex.split(command)).exit_code == 0


@pytest.mark.parametrize(
    ("stretches", "compared"),
    [
        (None, ""),  # stretches of its own
        (None, "@0s-12s"),  # which has frames of the stretch `train`
        ({}, "@0s-8s"),
        ({}, "@9s-20s"),
        ({"validation": (0.0, 5.0)}, "@12s-20s"),
    ],
)
def test_the_hint_of_an_untrained_tracker_trains_it_for_the_same_comparison(record, tmp_path, stretches, compared):
    path = record("my room", stretches=stretches)
    reason = compare(f"{path}{compared}", tmp_path / "run")
    assert reason.endswith("`, then compare again with --resume")
    run_command_in(reason)
    assert compare(f"{path}{compared}", tmp_path / "run", "--resume") == ""


def test_where_all_of_a_recording_is_compared_the_hint_leaves_a_rest_to_compare_on(record, tmp_path):
    path = record(stretches={})
    reason = compare(path, tmp_path / "run")
    run_command_in(reason)
    (rest,) = re.findall(r"then compare the rest, (\S+), into another folder", reason)
    assert compare(rest, tmp_path / "other") == ""


def test_a_recording_without_frames_to_spare_has_no_command(record, tmp_path):
    path = record(seconds=9, stretches={})
    assert "train it on a longer recording of this site" in compare(path, tmp_path / "run")


def test_a_training_without_validation_prints_a_command_with_one(record, tmp_path):
    path = record(stretches={})
    with pytest.raises(ConfigurationError, match=r"no validation stretch; name one with --validation, or run") as error:
        gridtrack("train", "static-map", str(path), "--out", str(tmp_path / "weights"))
    run_command_in(str(error.value))
    assert (tmp_path / "weights" / "static-map" / "room.toml").exists()


@pytest.mark.parametrize("stretch", ["@0s-200s", "@unknown"])
def test_a_range_in_a_message_is_one_of_the_recording(record, tmp_path, stretch):
    path = record(stretches={})
    with pytest.raises(RecordingError) as error:
        compare(f"{path}{stretch}", tmp_path / "run")
    (suggested,) = re.findall(r"(?:\(|seconds: )(/\S+@\S+)\)", str(error.value))
    compare(suggested, tmp_path / "run")


def test_no_stretch_is_suggested_where_the_sensor_always_moves(record, tmp_path, staged):
    moving = record("moving", seconds=20, speed=0.5)
    gridtrack("compare", str(moving), "--tracker", "staged", "--out", str(tmp_path / "moving"), "--horizon", "0.5s")
    reason = read_trial_record(tmp_path / "moving" / "staged@moving").reason
    assert "at rest nowhere for 10 s" in reason
    assert "@" not in reason.partition("the sensor moves")[2]

"""The training process: files within reach of `fit`, its lines of progress, its errors and its end."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys

import psutil
import pytest

from gridtrack.common.errors import ConfigurationError, PluginError, WeightsError
from gridtrack.evaluation.runs.recipe import Recipe
from gridtrack.evaluation.runs.stretch_files import StoredStretch, store_stretch
from gridtrack.evaluation.runs.train import train_tracker
from gridtrack.evaluation.runs.training_process import ProgressLines
from gridtrack.recordings.stream import frame_digest, open_stream
from gridtrack.trackers.training.progress import Progress, duration_text
from gridtrack.trackers.training.weights import read_card

from scenes import truth_scene
from scenes.agreement import wait_until

AGAIN = "there is no checkpoint: the same command begins again"
FITS = '''
import os, time
from gridtrack.common.errors import WeightsError
from gridtrack.trackers.baselines import StaticMapOptions, StaticMapTracker


class Options(StaticMapOptions):
    how: str = "raises"


class Fits(StaticMapTracker):
    """Its training fails as the option says."""

    Options = Options

    @classmethod
    def fit(cls, task):
        how = task.options.how
        if how == "raises":
            raise ValueError("no\\nminimum")
        if how == "refuses":
            raise WeightsError("too few frames")
        if how == "dies":
            os.abort()
        if how == "writes-and-sleeps":
            super().fit(task)
        try:
            task.report(f"{os.getpid()}")  # the test interrupts as soon as it has read this line
            time.sleep(60)
        except KeyboardInterrupt:
            task.report("saved")
            raise
'''


@pytest.fixture
def fits(install):
    install("fits", {"fits": "fits_tracker:Fits"}, {"fits_tracker.py": FITS})


@pytest.mark.usefixtures("nosy")
def test_fit_reaches_the_frames_of_its_stretches_and_nothing_else_of_a_recording(record, tmp_path):
    path, found = record("hidden-name"), tmp_path / "found.json"
    lines: list[str] = []
    options = {"found": str(found), "secret": "eman-neddih"}
    card = train_tracker(
        Recipe(tracker="nosy", options=options, recordings=(str(path),), out=tmp_path / "weights"), lines.append
    )
    nothing = {key: [] for key in ("members", "attributes", "objects", "stack", "command", "traces")}
    assert json.loads(found.read_text()) == nothing | {"frames": [40, 50]}
    assert "looked around" in lines  # a slow machine reports its progress before
    assert str(path) in read_card(card).command


def test_a_stored_stretch_has_the_frames_and_labels_of_the_stream(tmp_path):
    stream = open_stream(f"{truth_scene.write_recording(tmp_path / 'room.mcap', seconds=9)}@validation")
    stored = StoredStretch(store_stretch(stream, tmp_path / "stretch"))
    for name in ("name", "sha256", "grid", "period_s", "site", "classes"):
        assert getattr(stored, name) == getattr(stream, name)
    assert len(stored) == len(stream)
    for _ in range(2):
        assert [frame_digest(frame) for frame in stored] == [frame_digest(frame) for frame in stream]
    cells = [item.cells.tolist() for item in stored.labelled()]
    assert any(cells)
    assert cells == [item.cells.tolist() for item in stream.labelled()]


@pytest.mark.parametrize(
    ("how", "error", "message"),
    [
        ("raises", PluginError, r"'fits': its training failed: ValueError: no minimum \(fits_tracker.py, line \d+\)"),
        ("refuses", WeightsError, "^too few frames$"),
        ("dies", PluginError, "'fits': its training failed: killed by SIGABRT"),
    ],
)
@pytest.mark.usefixtures("fits")
def test_a_training_that_fails_is_one_line(how, error, message, train):
    with pytest.raises(error, match=message) as raised:
        train("weights", "fits", options={"how": how})
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("differs", "other", "here", "there"),
    [
        ("site", {"site": "elsewhere"}, "'room'", "'elsewhere'"),
        ("grid", {"grid": "20x0.4@-1,-4"}, "40x0.2@-1,-4", "20x0.4@-1,-4"),
        ("period", {"rate_hz": 5}, "0.1 s", "0.2 s"),
    ],
)
@pytest.mark.parametrize("validates", [False, True])
@pytest.mark.usefixtures("fits", "trackers_here")
def test_stretches_of_another_place_are_refused_before_the_training(
    differs, other, here, there, validates, record, train
):
    """Here every training fails, so a line of another reason says that it began."""
    room, named = record(), f"{record('other', stretches={}, **other)}@10s-14s"
    train_on, validation = [f"{room}@0s-4s"], [f"{room}@5s-9s"]
    (validation if validates else train_on).append(named)
    with pytest.raises(
        WeightsError,
        match=rf"^other\.mcap@10s-14s has the {differs} {re.escape(there)}, but room\.mcap@0s-4s {re.escape(here)}:"
        r" train and validate on recordings of one grid, period and site, or for any place with --general$",
    ):
        train("weights", "fits", *train_on, validation=tuple(validation))
    with pytest.raises(PluginError, match="its training failed: ValueError"):
        train("weights", "fits", *train_on, validation=tuple(validation), general=True)


@pytest.mark.usefixtures("trackers_here")
def test_an_unknown_option_is_refused_before_the_recording_is_read(train):
    with pytest.raises(ConfigurationError, match=r"tracker 'static-map'.*wrong"):
        train("weights", "static-map", "none.mcap", options={"wrong": 1})


@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGKILL])
@pytest.mark.usefixtures("fits")
def test_ctrl_c_reaches_fit_and_no_process_survives_the_command(end, record, tmp_path):
    process, child = begun("sleeps", record(), tmp_path)
    os.kill(process.pid, end)
    rest, errors = process.communicate(timeout=20)
    assert ("saved" in rest) == (end == signal.SIGINT)
    if end == signal.SIGINT:
        assert process.returncode == 130
        assert errors == f"gridtrack: interrupted before there were weights; {AGAIN}\n"
    wait_until(lambda: not psutil.pid_exists(child))


@pytest.mark.usefixtures("fits")
def test_ctrl_c_reports_the_weights_that_are_kept(record, tmp_path):
    recording, card = record(), tmp_path / "fits" / "room.toml"
    kept = {
        "writes-and-sleeps": "has the weights without later stages, such as classes",
        "sleeps": "keeps the weights of an earlier training",
    }
    for how, text in kept.items():
        process, _ = begun(how, recording, tmp_path)
        os.kill(process.pid, signal.SIGINT)
        errors = process.communicate(timeout=20)[1]
        assert errors == f"gridtrack: interrupted; {card} {text}; {AGAIN}\n"
        assert "how=writes-and-sleeps" in read_card(card).command


def begun(how, recording, out):
    """The process of a training after the start of `fit`, and the number of the process of `fit`."""
    command = [sys.executable, "-m", "gridtrack.cli", "train", f"fits:how={how}", str(recording), "--out", str(out)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    lines = iter(process.stdout.readline, "")
    return process, int(next(line for line in lines if line.strip().isdecimal()))  # not a line of progress


@pytest.mark.usefixtures("fits")
def test_a_job_in_the_background_of_a_shell_is_interrupted_too(record, tmp_path):
    """A shell without job control starts it with SIGINT ignored."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        process, _ = begun("sleeps", record(), tmp_path)
    finally:
        signal.signal(signal.SIGINT, before)
    os.kill(process.pid, signal.SIGINT)
    assert "saved" in process.communicate(timeout=20)[0]
    assert process.returncode == 130


def wait_for(lines, pattern):
    """Wait for a line that matches."""
    wait_until(lambda: any(re.fullmatch(pattern, line) for line in tuple(lines)))


def test_a_silent_training_is_reported_with_rate_and_time_left():
    sent = []
    with ProgressLines(sent.append, every_s=0.01) as lines:
        wait_for(sent, r"training for \d+ s")
        with lines.progress.stage("update", 1000) as stage:
            stage.advance("loss 0.5")
            wait_for(sent, r"update 2 of 1000, (\d+\.\d/s|\d+\.\d s each), .* left, loss 0\.5")
        lines.report("the tracker's own line")
        wait_for(sent, "the tracker's own line")


def test_a_stage_inside_an_iteration_counts_as_its_part():
    progress = Progress()
    with progress.stage("search iteration", 2) as outer:
        outer._began_s -= 100.0
        with progress.stage("frame", 4) as inner:
            for _ in range(2):
                inner.advance()
            assert re.fullmatch(r"search iteration 1 of 2, 200\.\d s each, 5 min 0 s left", progress.text())
    assert progress.text().startswith("training for")


def test_updates_of_an_earlier_training_do_not_count_in_the_rate():
    progress = Progress()
    with progress.stage("update", 100, done=50) as stage:
        stage._began_s -= 10.0
        for _ in range(10):
            stage.advance()
        assert re.fullmatch(r"update 61 of 100, 1\.0 s each, 40 s left", progress.text())


def test_durations_are_short():
    assert [duration_text(s) for s in (0.2, 59.4, 125, 12_000)] == ["0 s", "59 s", "2 min 5 s", "3 h 20 min"]

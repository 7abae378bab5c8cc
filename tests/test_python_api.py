"""gridtrack from Python: what somebody in a notebook does, on the shipped demo recording."""

from __future__ import annotations

import inspect
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import nbformat
import polars as pl
import psutil
import pytest
from nbclient import NotebookClient

import gridtrack
from gridtrack.cli.notebook import CompareOptions
from gridtrack.cli.runs import compare_command
from gridtrack.evaluation.runs.run_record import read_run_record

from scenes.report_page import data_of

ROOT = Path(__file__).parents[1]
RECORDING = "data/leg_tracker/leg_tracker.mcap@114s-124s"
NOT_IN_PYTHON = {"tracker", "out", "follow", "idle_timeout", "as_json", "recordings"}
"""Parameters of the command that the function has under another name, or does not have."""


@pytest.fixture(scope="module")
def compared(tmp_path_factory):
    out = tmp_path_factory.mktemp("python") / "run"
    return gridtrack.compare(
        RECORDING, trackers=["persistence", "map=static-map"], out=out, every="0.5s", horizon="1s", jobs=1
    )


def test_a_comparison_returns_the_run_of_the_command(compared):
    assert isinstance(compared, gridtrack.Run)
    assert list(compared.summary.trackers) == ["persistence", "map"]
    assert compared.record.command[:2] == ("gridtrack", "compare")
    assert compared.record == read_run_record(compared.path)
    assert repr(compared).endswith("persistence, map on leg_tracker@114s-124s)")


def test_scores_are_a_row_for_each_tracker_stratum_and_step(compared):
    row = compared.scores.filter(
        pl.col("tracker") == "persistence", pl.col("stratum") == "dynamic", pl.col("horizon_s") == 1.0
    )
    trial = compared.summary.trackers["persistence"].recordings["leg_tracker@114s-124s"]
    assert row["f1"].to_list() == [trial.strata["dynamic"].f1[10]]
    assert row["step"].to_list() == [10]
    assert row["f1_low"].to_list() == [None]


def test_differences_are_a_row_for_each_headline_test(compared):
    assert set(compared.differences["tracker"]) == {"map"}
    assert set(compared.differences["reference"]) == {"persistence"}
    assert compared.differences["f1"].null_count() == 0


def test_several_recordings_are_pooled_and_their_names_escaped(tmp_path):
    hostile = shutil.copy(RECORDING.partition("@")[0], tmp_path / "<i>hall.mcap")
    stretches = [f"{hostile}@100s-110s", RECORDING]
    run = gridtrack.compare(*stretches, trackers=["persistence"], out=tmp_path / "run", horizon="1s", jobs=1)
    names = run.scores["recording"].unique(maintain_order=True).to_list()
    assert names == ["all recordings", "<i>hall@100s-110s", "leg_tracker@114s-124s"]
    assert "all recordings" in run._repr_html_()
    assert "<i>" not in run._repr_html_()
    assert "&lt;i&gt;hall" in gridtrack.Run.load(run.path).report(tmp_path / "page").read_text("utf-8")
    one = data_of(run.report(tmp_path / "one", recordings="leg*").read_text("utf-8"))
    assert [recording["name"] for recording in one["recordings"]] == names[2:]


def test_one_tracker_may_be_a_text(tmp_path):
    run = gridtrack.compare(RECORDING, trackers="persistence", out=tmp_path / "run", every="2s", horizon="1s", jobs=1)
    assert list(run.summary.trackers) == ["persistence"]


def test_a_report_is_written_where_asked(compared, tmp_path):
    assert compared.report(tmp_path / "page").read_text("utf-8").startswith("<!doctype html>")


def test_a_run_is_read_again(compared):
    assert gridtrack.Run.load(str(compared.path)).scores.equals(compared.scores)


def test_a_refused_comparison_raises_the_reason_of_the_command(tmp_path):
    with pytest.raises(gridtrack.GridtrackError, match=r"nosuch\.mcap: no such recording"):
        gridtrack.compare("nosuch.mcap", out=tmp_path)
    with pytest.raises(gridtrack.GridtrackError, match="compare has no option 'horizons'"):
        gridtrack.compare(RECORDING, out=tmp_path, horizons="1s")
    with pytest.raises(gridtrack.GridtrackError, match="there is no such run's folder"):
        gridtrack.Run.load(tmp_path / "none")


def test_the_function_has_the_options_of_the_command():
    options = set(inspect.signature(compare_command).parameters) - NOT_IN_PYTHON
    assert set(CompareOptions.__annotations__) == options


def test_an_interrupt_ends_the_comparison_and_keeps_what_was_scored(tmp_path):
    recording, out = "data/junction/test-101.tracks", str(tmp_path / "run")
    code = f"import gridtrack; gridtrack.compare({recording!r}, trackers=['persistence'], out={out!r})"
    with subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        while not list(tmp_path.glob("run/persistence@*")):
            assert process.poll() is None, process.stderr.read()
            time.sleep(0.01)
        process.send_signal(signal.SIGINT)
        assert "KeyboardInterrupt" in process.stderr.read()
    assert gridtrack.Run.load(tmp_path / "run").summary.interrupted


@pytest.fixture
def notebook(tmp_path):
    """A process in a group of its own that compares as a notebook does, once one trial is scored in part."""
    rows = ["blank", "kalman"]
    options = f"{RECORDING.partition('@')[0] + '@0s-40s'!r}, trackers={rows}, out={str(tmp_path / 'run')!r}"
    code = f"import gridtrack; gridtrack.compare({options}, every='0.1s', jobs=1, allow_leak=True)"
    with subprocess.Popen(
        [sys.executable, "-c", code], stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        assert process.stderr is not None
        while not (tmp_path / "run" / "kalman@leg_tracker@0s-40s" / "scores.parquet.partial").exists():
            assert process.poll() is None, process.stderr.read()
            time.sleep(0.02)
        yield process


def test_one_interrupt_of_the_whole_group_loses_no_score(notebook, tmp_path):
    """A terminal and Jupyter send it to every process of the group of the notebook."""
    os.killpg(notebook.pid, signal.SIGINT)
    assert "KeyboardInterrupt" in notebook.stderr.read()
    trials = gridtrack.Run.load(tmp_path / "run").summary.trackers
    assert trials["blank"].recordings["leg_tracker@0s-40s"].outcome == "ok"
    assert trials["kalman"].recordings["leg_tracker@0s-40s"].frames_scored > 0


def test_a_comparison_ends_where_its_notebook_is_killed(notebook, tmp_path):
    family = psutil.Process(notebook.pid).children(recursive=True)
    notebook.kill()
    gone, alive = psutil.wait_procs(family, timeout=120)
    assert (len(gone) > 1, alive) == (True, [])


def test_the_example_notebook_runs_in_any_folder(tmp_path):
    notebook = nbformat.read(ROOT / "examples" / "notebook" / "first_comparison.ipynb", as_version=4)
    NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(tmp_path)}}).execute()
    shown = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    assert any("text/html" in output.get("data", {}) for output in shown)
    assert not [output for output in shown if output.output_type == "error"]

"""gridtrack from Python, as in a notebook, on the shipped demo recording."""

import math
import os
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import nbformat
import polars as pl
import psutil
import pytest
from nbclient import NotebookClient

import gridtrack
from gridtrack.evaluation.runs.run_record import read_run_record

from scenes.programs_here import programs_here
from scenes.report_page import data_of

ROOT = Path(__file__).parents[1]
DEMO = "data/leg_tracker/leg_tracker.mcap"
RECORDING, VALIDATION = f"{DEMO}@114s-120s", f"{DEMO}@75s-79s"


@pytest.fixture(scope="module")
def compared(tmp_path_factory):
    rows = {"trackers": ["persistence", "map=static-map"], "no_floors": True, "limits": {"memory_mb": 2000}}
    short = {"validation": VALIDATION, "every_s": 0.5, "horizon_s": "1s", "jobs": 1}
    with programs_here():
        return gridtrack.compare(RECORDING, **rows, **short, out=tmp_path_factory.mktemp("python") / "run")


def test_a_comparison_returns_its_run_with_the_command_that_repeats_it(compared):
    assert isinstance(compared, gridtrack.Run)
    assert list(compared.summary.trackers) == ["persistence", "map"]
    options = f"--tracker persistence --tracker map=static-map --no-floors --validation {VALIDATION} --every 0.5"
    options += f" --horizon 1s --jobs 1 --memory 2000 --out {compared.path}"
    command = compared.record.command
    assert command[:3] == ("gridtrack", "compare", RECORDING)
    assert sorted(command[3:]) == sorted(options.split())
    assert compared.record == read_run_record(compared.path)
    assert repr(compared).endswith("persistence, map on leg_tracker@114s-120s)")
    assert gridtrack.Run.load(str(compared.path)).scores.equals(compared.scores)


def test_scores_are_a_row_for_each_tracker_stratum_and_step(compared):
    row = compared.scores.filter(
        pl.col("tracker") == "persistence", pl.col("stratum") == "dynamic", pl.col("horizon_s") == 1.0
    )
    trial = compared.summary.trackers["persistence"].recordings["leg_tracker@114s-120s"]
    assert row["f1"].to_list() == [trial.at("dynamic", "f1", "f1", 10).value]
    assert row["step"].to_list() == [10]
    assert row["f1 low"].to_list() == [None]


def test_differences_are_a_row_for_each_headline_test(compared):
    assert set(compared.differences["tracker"]) == {"map"}
    assert set(compared.differences["reference"]) == {"persistence"}
    assert compared.differences["f1"].null_count() == 0


@pytest.mark.usefixtures("trackers_here")
def test_several_recordings_are_pooled_and_their_names_escaped(tmp_path):
    hostile = shutil.copy(DEMO, tmp_path / "<i>hall.mcap")
    stretches, short = [f"{hostile}@100s-106s", RECORDING], {"horizon_s": 1.0, "every_s": 0.5, "jobs": 1}
    run = gridtrack.compare(*stretches, trackers="persistence", no_floors=True, out=tmp_path / "run", **short)
    names = run.scores["recording"].unique(maintain_order=True).to_list()
    assert names == ["all recordings", "<i>hall@100s-106s", "leg_tracker@114s-120s"]
    assert "all recordings" in run._repr_html_()
    assert "<i>" not in run._repr_html_()
    page = run.report(tmp_path / "page").read_text("utf-8")
    assert page.startswith("<!doctype html>")
    assert "&lt;i&gt;hall" in page
    one = data_of(run.report(tmp_path / "one", recordings="leg*").read_text("utf-8"))
    assert [recording["name"] for recording in one["recordings"]] == names[2:]


def test_a_refused_comparison_raises_the_reason_in_one_line(tmp_path):
    with pytest.raises(gridtrack.GridtrackError, match=r"nosuch\.mcap: no such recording"):
        gridtrack.compare("nosuch.mcap", out=tmp_path)
    with pytest.raises(gridtrack.ConfigurationError, match="no option 'horizon'; did you mean 'horizon_s'"):
        gridtrack.compare(RECORDING, out=tmp_path, horizon="1s")
    with pytest.raises(gridtrack.ConfigurationError, match=r"there is no option 'limits\.thread'; did you mean"):
        gridtrack.compare(RECORDING, out=tmp_path, limits={"thread": 2})
    with pytest.raises(gridtrack.GridtrackError, match="there is no such run's folder"):
        gridtrack.Run.load(tmp_path / "none")


def test_a_crash_of_a_tracker_ends_no_child_of_the_notebook_and_its_command_line_comes_back(bad_trackers, tmp_path):
    command_line = Path("/proc/self/cmdline").read_bytes()
    with subprocess.Popen(["sleep", "600"], start_new_session=True) as own:
        short = {"validation": VALIDATION, "no_floors": True, "horizon_s": 1.0, "jobs": 1}
        run = gridtrack.compare(RECORDING, trackers="kills-itself", out=tmp_path / "run", **short)
        outcomes = [trial.outcome for row in run.summary.trackers.values() for trial in row.recordings.values()]
        assert (outcomes, own.poll()) == (["crashed"], None)
        own.kill()
    assert Path("/proc/self/cmdline").read_bytes() == command_line


@pytest.fixture
def notebook(tmp_path):
    """A process in a group of its own that compares as a notebook does, once one trial is scored in part."""
    given = f"out={str(tmp_path / 'run')!r}, validation='{DEMO}@75s-79s', every_s=0.1, jobs=1, allow_leak=True"
    given += ", horizon_s=1.5, no_floors=True"
    code = f"import gridtrack; gridtrack.compare('{DEMO}@0s-16s', trackers=['blank', 'persistence'], {given})"
    with subprocess.Popen(
        [sys.executable, "-c", code], stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        assert process.stderr is not None
        trial = tmp_path / "run" / "persistence@leg_tracker@0s-16s"
        until_s = math.inf
        while (used_s := psutil.Process(process.pid).cpu_times().user) < until_s:
            assert process.poll() is None, process.stderr.read()
            until_s = min(until_s, used_s + 0.5 if list(trial.glob("sums.parquet.*")) else math.inf)
            time.sleep(0.02)
        yield process


def test_one_interrupt_of_the_whole_group_loses_no_score(notebook, tmp_path):
    """A terminal and Jupyter send it to every process of the group of the notebook."""
    os.killpg(notebook.pid, signal.SIGINT)
    assert "KeyboardInterrupt" in notebook.stderr.read()
    summary = gridtrack.Run.load(tmp_path / "run").summary
    assert summary.interrupted
    assert summary.trackers["blank"].recordings["leg_tracker@0s-16s"].outcome == "ok"
    assert summary.trackers["persistence"].recordings["leg_tracker@0s-16s"].frames_scored > 0


def test_the_trackers_end_if_their_notebook_is_killed(notebook):
    family = psutil.Process(notebook.pid).children(recursive=True)
    notebook.kill()
    gone, alive = psutil.wait_procs(family, timeout=120)
    assert (len(gone) > 1, alive) == (True, [])


def test_the_example_notebook_runs_in_any_folder(tmp_path):
    notebook = nbformat.read(ROOT / "examples" / "notebook" / "first_comparison.ipynb", as_version=4)
    shorter = f"every_s=0.5, no_floors=True, validation={str(ROOT / VALIDATION)!r},"
    for cell in notebook.cells:
        cell.source = cell.source.replace("every_s=0.5,", shorter)
    client = NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(tmp_path)}})
    with ThreadPoolExecutor() as thread:  # the browser of other tests has the event loop of this one
        thread.submit(client.execute).result()
    shown = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    assert any("text/html" in output.get("data", {}) for output in shown)
    assert not [output for output in shown if output.output_type == "error"]
    progress = "".join(output.text for output in shown if output.output_type == "stream")
    assert "persistence@" in progress
    assert "\x1b" not in progress

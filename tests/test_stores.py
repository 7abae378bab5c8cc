"""Weights and runs in a store: commands take URLs, run on local copies, and lose nothing if the store fails."""

import json
import shutil
from pathlib import Path

import pytest

from gridtrack import Run
from gridtrack.recordings import packaged_recording

from scenes.command_line import gridtrack

pytestmark = pytest.mark.usefixtures("trackers_here")

SHIPPED = Path(__file__).parents[1] / "data" / "weights" / "static-map"
RECORDING = f"{packaged_recording('leg_tracker')}@90s-96s"
VALIDATION = f"{packaged_recording('leg_tracker')}@75s-79s"
SHORT = ("--horizon", "0.5s", "--every", "0.5s", "--validation", VALIDATION)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The working folder, with the user's folders in it; `store` in it is the store."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def json_in(path):
    return json.loads(path.read_text())


def test_a_run_uses_weights_in_a_store_and_records_the_command_as_typed(folder):
    shutil.copytree(SHIPPED, folder / "store" / "weights" / "static-map")
    url = f"file://{folder}/store/weights"
    rows = ("--tracker", f"new=static-map:weights={url}", "--tracker", "static-map:points=centres")
    done = gridtrack("compare", "--no-floors", RECORDING, *rows, "--weights", url, *SHORT, "--out", "run")
    assert done.stderr.count("fetching") == 1
    record = json_in(folder / "run" / "run.json")
    assert f"new=static-map:weights={url}" in record["command"]
    new, other = record["weights"].values()
    assert new == other
    assert new["name"].startswith("static-map/")
    listed = json.loads(gridtrack("trackers", "list", "--json", "--weights", url).stdout)
    assert {row["name"]: row["state"] for row in listed}["static-map"] == "ready"
    missing = gridtrack("trackers", "check", "static-map", "--weights", f"{url}-none", code=2)
    assert missing.stderr == f"gridtrack: {url}-none: there is no such folder, or no file in it\n"


def test_a_row_may_name_its_weights_in_a_store_that_is_not_there(folder):
    row = f"static-map:points=raw,weights=file://{folder}/none"
    failed = gridtrack("compare", "--no-floors", RECORDING, "--tracker", row, code=2)
    assert failed.stderr == f"gridtrack: file://{folder}/none: there is no such folder, or no file in it\n"


def test_the_card_of_a_training_has_the_command_as_typed(folder):
    """Whoever repeats the command has the store, and not this machine's cache."""
    shutil.copytree(SHIPPED, folder / "store" / "weights" / "static-map")
    shutil.copy(packaged_recording("leg_tracker"), folder / "store")
    weights, recording = f"file://{folder}/store/weights", f"file://{folder}/store/leg_tracker.mcap"
    stretches = (f"{recording}@0s-20s", "--validation", f"{recording}@20s-40s")
    done = gridtrack("train", "static-map", *stretches, "--weights", weights, "--out", "own")
    assert done.stdout.count("fetching") == 2
    card = (folder / "own" / "static-map" / "leg_tracker.toml").read_text()
    assert f"gridtrack train static-map {' '.join(stretches)} --seed 1 --weights {weights} --out own" in card
    assert str(folder / "cache") not in card


@pytest.fixture
def run_url(folder):
    """A run in the store, which is nowhere else."""
    out = ("--out", "store/hall")
    gridtrack("compare", "--no-floors", RECORDING, "--tracker", "persistence", "--tracker", "blank", *SHORT, *out)
    shutil.rmtree(folder / "store" / "hall" / "report")
    return f"file://{folder}/store/hall"


def test_a_run_in_a_store_is_reported_judged_and_loaded(folder, run_url):
    stored = sorted(path.name for path in (folder / "store").rglob("*"))
    done = gridtrack("report", run_url)
    assert done.stdout == "report: hall-report/index.html\n"
    assert (folder / "hall-report" / "index.html").is_file()
    several = gridtrack("report", run_url, "store/hall")
    assert several.stdout == "report: hall-side-by-side/index.html\n"
    assert "persistence" in gridtrack("report", run_url, "--format", "markdown").stdout
    gridtrack("regress", run_url, "--baseline", "hall.json", "--update")
    gridtrack("regress", run_url, "--baseline", "hall.json")
    missing = gridtrack("report", f"{run_url}-none", code=2)
    assert missing.stderr == f"gridtrack: {run_url}-none: there is no such folder, or no file in it\n"
    run = Run.load(run_url)
    assert run.url == run_url
    assert repr(run).startswith(f"Run('{run_url}': persistence, blank")
    assert run.report() == Path("hall-report/index.html")
    assert sorted(path.name for path in (folder / "store").rglob("*")) == stored
    assert not list((folder / "cache" / "gridtrack" / "runs").rglob("report"))


ROW = ("--tracker", "blank")


def kept_runs(folder):
    return [path.parent for path in (folder / "home").rglob("run.json")]


def test_a_run_is_made_in_a_store_and_continued_from_there(folder):
    url = f"file://{folder}/store/hall"
    done = gridtrack("compare", "--no-floors", RECORDING, *ROW, *SHORT, "--out", url)
    assert done.stdout.endswith(f"report: {url}/report/index.html\n")
    stored = folder / "store" / "hall"
    assert json_in(stored / "run.json")["status"] == "complete"
    assert (stored / "summary.json").is_file()
    assert (stored / "report" / "index.html").is_file()
    assert not list(stored.rglob(".*"))
    more = (*ROW, "--tracker", "persistence")
    outcome = (stored / "blank@leg_tracker@90s-96s" / "outcome.json").read_bytes()
    gridtrack("compare", "--no-floors", RECORDING, *more, *SHORT, "--out", url, "--resume")
    assert sorted(json_in(stored / "summary.json")["trackers"]) == ["blank", "persistence"]
    assert (stored / "blank@leg_tracker@90s-96s" / "outcome.json").read_bytes() == outcome
    assert kept_runs(folder) == []


def test_a_run_that_cannot_be_uploaded_stays_here_until_the_suggested_command_uploads_it(folder):
    blocking = folder / "store" / "hall" / "report"
    blocking.parent.mkdir(parents=True)
    blocking.write_text("a file where the folder of the report should be")
    url = f"file://{folder}/store/hall"
    command = ("compare", "--no-floors", RECORDING, *ROW, *SHORT, "--out", url)
    failed = gridtrack(*command, code=2)
    (kept,) = kept_runs(folder)
    reported, reason = failed.stderr.splitlines()[-2:]
    assert reported.startswith(
        f"gridtrack: {kept} keeps the run, which {url} does not have in this state: run `gridtrack"
    )
    assert "--resume`" in reported
    assert reason.startswith(f"gridtrack: {url}: cannot be uploaded to (")
    assert not (folder / "store" / "hall" / "run.json").exists()
    blocking.unlink()
    refused = gridtrack(*command, code=2)
    assert "holds a run already: continue it with --resume" in refused.stderr
    gridtrack(*command, "--resume")
    assert json_in(folder / "store" / "hall" / "run.json")["status"] == "complete"
    assert kept_runs(folder) == []


def test_a_comparison_that_does_not_begin_leaves_nothing(folder):
    url = f"file://{folder}/store/hall"
    gridtrack("compare", "--no-floors", RECORDING, "--tracker", "none-such", *SHORT, "--out", url, code=2)
    assert not (folder / "store").exists()
    assert not list((folder / "home").rglob("hall"))

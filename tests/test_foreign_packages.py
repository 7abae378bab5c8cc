"""A score or a recording format of another package: used if it is named, by every command; else it is not loaded."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from gridtrack.evaluation.runs.summary import read_summary
from gridtrack.evaluation.scores.registry import built_in, scores
from gridtrack.recordings import packaged_recording

from scenes.command_line import gridtrack
from scenes.report_page import data_of

pytestmark = pytest.mark.usefixtures("trackers_here")

DEMO = packaged_recording("leg_tracker")
RECORDING, VALIDATION = f"{DEMO}@114s-120s", ("--validation", f"{DEMO}@75s-79s")
SCORE = """
from pathlib import Path

import numpy as np

from gridtrack.evaluation.scores.definition import Output, Ratio, ScoreDefinition


Path("absolute_error was imported").touch()


def count(forecast, facts, memory):
    found = np.zeros((facts.steps + 1, 1, 2))
    for n, target in enumerate(forecast.targets):
        seen, occupied = target.state < 2, target.state == 1
        found[n, 0] = abs(forecast.forecast.occupancy[n] - occupied)[seen].sum(), seen.sum()
    return found


ABSOLUTE_ERROR = ScoreDefinition(
    name="absolute_error",
    title="Absolute error",
    position=1000,
    outputs=(Output("mean", "Absolute error", better="lower", scale="odds", tested=True, margin=0.01),),
    about="Mean distance of the probability from the observation, over visible cells.",
    strata=lambda facts: ("visible",),
    parts=lambda facts: ("error", "cells"),
    count=count,
    value=lambda sums: {"mean": Ratio(sums["error"], sums["cells"])},
)
"""

FORMAT = Path(__file__).parent / "plugins" / "csv_scans.py"


@pytest.fixture
def installed(install):
    """A package with the score `absolute_error`."""
    points = {"absolute_error": "absolute_error:ABSOLUTE_ERROR"}
    install("absolute-error", points, {"absolute_error.py": SCORE}, group="gridtrack.scores")
    yield
    sys.modules.pop("absolute_error", None)


@pytest.fixture
def walk(install, tmp_path, monkeypatch):
    """A recording in the format `csv` of another package: 15 s in a room in which a person walks by."""
    install("csv-scans", {"csv": "csv_scans:FORMAT"}, {FORMAT.name: FORMAT.read_text()}, group="gridtrack.recordings")
    angles = np.linspace(-np.pi, np.pi, 180, endpoint=False)
    lines = ["scans"]
    for frame in range(150):
        ranges = np.where(abs(angles - (frame - 75) / 75) < 0.1, 2.0, 4.0)
        lines.append(f"{frame * 100_000_000}," + ",".join(f"{one:.2f}" for one in ranges))
    (tmp_path / "walk.csv").write_text("\n".join(lines))
    monkeypatch.chdir(tmp_path)
    yield "walk.csv"
    sys.modules.pop("csv_scans", None)


@pytest.mark.usefixtures("installed")
def test_a_score_of_another_package_is_in_table_page_exports_and_gate(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    asked = ("--tracker", "persistence", "--tracker", "blank", "--horizon", "1s", "--every", "0.5s", "--jobs", "1")
    asked += VALIDATION
    gridtrack("compare", "--no-floors", RECORDING, *asked, "--out", "without")
    assert not Path("absolute_error was imported").exists(), "a package that is not named runs no code"
    gridtrack("compare", "--no-floors", RECORDING, *asked, "--score", "absolute_error", "--out", "run")
    summary = read_summary(tmp_path / "run")
    assert Path("absolute_error was imported").exists()
    trial = summary.trackers["blank"].recordings["leg_tracker@114s-120s"]
    assert trial.at("visible", "absolute_error", "mean", 5).value > 0
    data = data_of((tmp_path / "run" / "report" / "index.html").read_text("utf-8"))
    assert "Absolute error" in [score["title"] for score in data["scores"]]
    (row,) = [row for row in data["recordings"][0]["rows"] if row["label"] == "blank"]
    assert row["strata"]["visible"]["absolute_error"]["mean"]["value"][5] > 0
    table = gridtrack("report", "run", "--format", "csv", "--columns", "absolute_error visible 0.5s").stdout
    assert "absolute_error" in table
    gate = ("--baseline", "baseline.json", "--score", "absolute_error")
    gridtrack("regress", "run", *gate, "--update")
    verdict = json.loads(gridtrack("regress", "run", *gate, "--json").stdout)
    assert {row["standing"] for row in verdict["rows"] if row["score"] == "absolute_error.mean"} == {"equal"}


def test_a_format_of_another_package_is_read_by_every_command_that_reads_recordings(walk, tmp_path):
    assert "walk.csv: not a recording that gridtrack reads" in gridtrack("recording", "info", walk, code=2).stderr
    assert "csv_scans" not in sys.modules, "a package that is not named runs no code"
    named = ("--format", "csv")
    assert "150 scans" in gridtrack("recording", "info", walk, *named).stdout
    gridtrack("recording", "view", walk, *named, "--out", "walk.rrd")
    gridtrack("recording", "import", walk, *named, "--out", "walk.mcap")
    gridtrack("train", "static-map", f"{walk}@0s-5s", "--validation", f"{walk}@5s-7s", *named, "--out", "weights")
    asked = ("--weights", "weights", "--tracker", "static-map", "--tracker", "blank", "--out", "run")
    gridtrack("compare", "--no-floors", f"{walk}@7s-15s", *named, *asked, "--horizon", "1s", "--jobs", "1")
    assert read_summary(tmp_path / "run").trackers["static-map"].recordings.keys() == {"walk@7s-15s"}


def test_a_built_in_score_that_is_asked_for_by_name_is_there_once():
    assert scores(("f1", "f1")) == built_in()

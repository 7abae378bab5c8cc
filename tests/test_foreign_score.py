"""A score of another package: with `--score NAME` it is in table, page, exports and gate; else it is not loaded."""

from __future__ import annotations

import json
import sys

import pytest

from gridtrack.evaluation.runs.summary import read_summary
from gridtrack.recordings import packaged_recording

from scenes.command_line import gridtrack

RECORDING = f"{packaged_recording('leg_tracker')}@114s-120s"
MODULE = """
import numpy as np

from gridtrack.evaluation.scores.definition import Output, Ratio, ScoreDefinition


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
    about="Mean distance of the probability from what came, over visible cells.",
    strata=lambda facts: ("visible",),
    parts=lambda facts: ("error", "cells"),
    count=count,
    value=lambda sums: {"mean": Ratio(sums["error"], sums["cells"])},
)
"""


@pytest.fixture
def installed(install):
    """A package with the score `absolute_error`."""
    points = {"absolute_error": "absolute_error:ABSOLUTE_ERROR"}
    install("absolute-error", points, {"absolute_error.py": MODULE}, group="gridtrack.scores")
    yield
    sys.modules.pop("absolute_error", None)


@pytest.mark.usefixtures("installed")
def test_a_score_of_another_package_is_in_table_page_exports_and_gate(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    asked = ("--tracker", "persistence", "--tracker", "blank", "--horizon", "1s", "--jobs", "1")
    gridtrack("compare", RECORDING, *asked, "--out", "without")
    assert "absolute_error" not in sys.modules, "a package that is not named runs no code"
    gridtrack("compare", RECORDING, *asked, "--score", "absolute_error", "--out", "run")
    summary = read_summary(tmp_path / "run")
    trial = summary.trackers["blank"].recordings["leg_tracker@114s-120s"]
    assert trial.at("visible", "absolute_error", "mean", 5).value > 0
    assert "Absolute error" in (tmp_path / "run" / "report" / "index.html").read_text("utf-8")
    table = gridtrack("report", "run", "--format", "csv", "--columns", "absolute_error visible 0.5s").stdout
    assert "absolute_error" in table
    gate = ("--baseline", "baseline.json", "--score", "absolute_error")
    gridtrack("regress", "run", *gate, "--update")
    verdict = json.loads(gridtrack("regress", "run", *gate, "--json").stdout)
    assert {row["standing"] for row in verdict["rows"] if row["score"] == "absolute_error.mean"} == {"equal"}


def test_a_score_that_is_not_installed_is_one_line(tmp_path):
    told = gridtrack("compare", RECORDING, "--score", "absolute_eror", "--out", tmp_path / "run", code=2).stderr
    assert told.startswith("gridtrack: --score: no score 'absolute_eror' is installed")

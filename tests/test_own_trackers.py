"""The built-in trackers under the regression gate: deterministic ones exactly, the others within a tolerance.

`make baseline` writes the baseline again, after a change that is intended to change the forecasts of a tracker.
"""

import json
from pathlib import Path

import pytest

from scenes.command_line import gridtrack

ROOT = Path(__file__).parents[1]
BASELINE = ROOT / "tests" / "baselines" / "own_trackers.json"
EXACT = {"persistence", "static-map", "blank", "stationary", "kalman"}
SAME = {"equal", "nothing to find"}
TOLERANCE = {"factor-graph": 0.01, "deep-tracking-rnn": 0.01, "dilated-convgru": 0.01, "dogma": 0.01, "advection": 0.01}
"""Change in F1 that the order of 32-bit sums on another processor may cause."""


@pytest.mark.usefixtures("trackers_here")
def test_no_built_in_tracker_is_worse_than_its_baseline_and_deterministic_ones_are_equal(tmp_path, monkeypatch):
    (run,) = json.loads(BASELINE.read_text())["runs"]
    _, *arguments, _ = run["command"]
    monkeypatch.chdir(ROOT)
    gridtrack(*arguments, tmp_path / "run")
    tolerances = [f"--tolerance={label}={f1}" for label, f1 in TOLERANCE.items()]
    done = gridtrack("regress", tmp_path / "run", "--baseline", BASELINE, *tolerances, "--json")
    rows = json.loads(done.stdout)["rows"]
    assert {row["label"] for row in rows} == EXACT | TOLERANCE.keys()
    changed = {row["label"] for row in rows if row["score"] == "F1" and row["standing"] not in SAME}
    assert not changed & EXACT

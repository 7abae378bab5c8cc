"""Our own trackers under our own gate: those without chance in them exactly, the others within a stated tolerance.

`make baseline` makes the baseline again, after a change that is meant to change what a tracker forecasts.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
BASELINE = ROOT / "tests" / "baselines" / "own_trackers.json"
EXACT = {"persistence", "static-map", "blank", "kalman"}
TOLERANCE = {"deep-tracking-rnn": 0.01, "dilated-convgru": 0.01, "dogma": 0.01}
"""F1 by which the sums of 32-bit numbers, done in another order on another processor, may move a score."""


def gridtrack(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "gridtrack.cli", *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


def test_no_tracker_of_ours_is_worse_than_its_baseline_and_those_without_chance_are_as_they_were(tmp_path):
    (run,) = json.loads(BASELINE.read_text())["runs"]
    _, *as_then, _ = run["command"]
    compared = gridtrack(*as_then, str(tmp_path / "run"))
    assert compared.returncode == 0, compared.stderr
    stated = [f"--tolerance={label}={f1}" for label, f1 in TOLERANCE.items()]
    done = gridtrack("regress", str(tmp_path / "run"), "--baseline", str(BASELINE), *stated, "--json")
    assert done.returncode == 0, done.stdout + done.stderr
    rows = json.loads(done.stdout)["rows"]
    assert {row["label"] for row in rows} == EXACT | TOLERANCE.keys()
    changed = {row["label"] for row in rows if row["standing"] not in {"equal", "nothing to find"}}
    assert not changed & EXACT

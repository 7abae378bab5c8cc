"""The learned tracker: it keeps the contract after a short training, and its weights are not worse than before."""
# ruff: noqa: D103

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from gridtrack import open_stream, packaged_recording, stream_of

DEMO = packaged_recording("leg_tracker")
WEIGHTS = Path(__file__).parents[1] / "weights"


def test_it_learns_and_keeps_the_contract(tracker_contract: Any, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "gridtrack.cli", "train", "learned-tracker:updates=2,channels=2"]
    stretches = [f"{DEMO}@0s-10s", "--validation", f"{DEMO}@75s-81s"]
    subprocess.run([*command, *stretches, "--out", str(tmp_path)], check=True)
    stream = stream_of(open_stream(DEMO), tmp_path / "learned-tracker" / "leg_tracker.toml")
    tracker_contract("learned-tracker", stream)


@pytest.mark.skipif(not WEIGHTS.is_dir(), reason="no weights: gridtrack train learned-tracker RECORDING --out weights")
def test_it_is_not_worse_than_before(tracker_regression: Any) -> None:
    # after another training: pytest --gridtrack-update-baseline
    options = {"validation": f"{DEMO}@75s-81s", "horizon_s": 1.0, "every_s": 0.5, "weights": WEIGHTS}
    tracker_regression("learned-tracker", f"{DEMO}@114s-120s", baseline="learned_tracker.json", **options)

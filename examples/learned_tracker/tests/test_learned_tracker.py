"""The learned tracker: it keeps the contract after a short training, and its weights are not worse than before."""
# ruff: noqa: D103

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from gridtrack import open_stream, packaged_recording, stream_of

# replace them by your recording and three stretches of it that share no frame
RECORDING = packaged_recording("leg_tracker")
TRAIN, VALIDATION, TEST = (f"{RECORDING}@{stretch}" for stretch in ("0s-10s", "75s-81s", "114s-120s"))
WEIGHTS = Path(__file__).parents[1] / "weights"
STREAM = stream_of(open_stream(RECORDING))
CARD = Path("learned-tracker", f"{STREAM.site}.toml")


def test_it_learns_and_keeps_the_contract(tracker_contract: Any, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "gridtrack.cli", "train", "learned-tracker:updates=2", TRAIN]
    command += ["--validation", VALIDATION, "--out", str(tmp_path)]
    done = subprocess.run(command, check=False, stderr=subprocess.PIPE, text=True)
    assert not done.returncode, done.stderr
    tracker_contract("learned-tracker", replace(STREAM, weights=tmp_path / CARD))


@pytest.mark.skipif(not (WEIGHTS / CARD).exists(), reason=f"no {CARD}: gridtrack train learned-tracker --out weights")
def test_it_is_not_worse_than_before(tracker_regression: Any) -> None:
    # after another training: pytest --gridtrack-update-baseline
    options = {"validation": VALIDATION, "horizon_s": 1.0, "every_s": 0.5, "weights": WEIGHTS}
    tracker_regression("learned-tracker", TEST, baseline="learned_tracker.json", **options)

"""A tracker loads the libraries that it uses: one estimator runs where the library of the other is not installed."""

from __future__ import annotations

import importlib.util
import subprocess
import sys

import pytest

UPDATE_AND_FORECAST = """
import sys
sys.modules["{missing}"] = None  # an import of it raises ImportError
from gridtrack.recordings.stream import open_stream
from gridtrack.recordings import packaged_recording
from gridtrack.trackers.contract import stream_of
from gridtrack.trackers.registry import load

demo = packaged_recording("leg_tracker")
stream = open_stream(f"{{demo}}@90s-92s")
card = demo.parents[1] / "weights" / "{tracker}" / "leg_tracker.toml"
kind = load("{tracker}")
tracker = kind(stream_of(stream, card), kind.Options())
for frame in stream:
    tracker.update(frame)
print(tracker.predict(5).occupancy.shape, len(tracker.tracks) > 0)
"""


def printed_by(program: str) -> str:
    return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout


@pytest.mark.parametrize(
    ("tracker", "missing", "needed"), [("kalman", "gtsam", "filterpy"), ("factor-graph", "filterpy", "gtsam")]
)
def test_a_tracker_runs_without_the_library_of_the_other_estimator(tracker, missing, needed):
    if importlib.util.find_spec(needed) is None:
        pytest.skip(f"{needed} is not installed")
    assert printed_by(UPDATE_AND_FORECAST.format(tracker=tracker, missing=missing)) == "(6, 100, 100) True\n"

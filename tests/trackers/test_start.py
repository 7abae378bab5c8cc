"""Kernels are compiled when a tracker starts, and a tracker loads only the libraries that it uses."""

from __future__ import annotations

import subprocess
import sys

import pytest

STARTED_AND_FED = """
import sys
from dataclasses import replace
from itertools import islice
from gridtrack.recordings.stream import open_stream
from gridtrack.recordings import packaged_recording
from gridtrack.trackers.contract import stream_of
from gridtrack.trackers.registry import load

data = packaged_recording("leg_tracker").parents[1]
recordings = {"leg_tracker": "leg_tracker/leg_tracker.mcap@90s-94s", "junction": "junction/validation.tracks@0s-4s"}

def compiled():
    modules = [module for name, module in sys.modules.items() if name.startswith("gridtrack.trackers")]
    found = {value for module in modules for value in vars(module).values() if hasattr(value, "signatures")}
    return sum(len(kernel.signatures) for kernel in found)

for name, site in (("kalman", "leg_tracker"), ("kalman", "junction"), ("dogma", "leg_tracker")):
    stream = open_stream(f"{data}/{recordings[site]}")
    kind, before = load(name), compiled()
    spec = replace(stream_of(stream, data / "weights" / name / f"{site}.toml"), velocity_scored=True)
    tracker = kind(spec, kind.Options())
    started = compiled()
    for frame in islice(stream, 30):
        tracker.update(frame)
    tracker.predict(20)
    print(name, site, started > before, compiled() - started, bool(tracker.classes))
"""
WITHOUT = """
import sys
sys.modules["{missing}"] = None  # an import of it raises ImportError
from gridtrack.recordings.stream import open_stream
from gridtrack.recordings import packaged_recording
from gridtrack.trackers.contract import stream_of
from gridtrack.trackers.registry import load

demo = packaged_recording("leg_tracker")
stream = open_stream(f"{{demo}}@90s-92s")
kind = load("{tracker}")
tracker = kind(stream_of(stream, demo.parents[1] / "weights" / "{tracker}" / "leg_tracker.toml"), kind.Options())
for frame in stream:
    tracker.update(frame)
print(tracker.predict(5).occupancy.shape, len(tracker.tracks) > 0)
print(sorted({{"torch", "optuna", "sklearn"}} & set(sys.modules)))
"""


def printed_by(program: str) -> list[str]:
    return subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    ).stdout.splitlines()


def test_kernels_are_compiled_when_a_tracker_starts():
    pytest.importorskip("filterpy")
    assert printed_by(STARTED_AND_FED) == [
        "kalman leg_tracker True 0 False",
        "kalman junction True 0 True",
        "dogma leg_tracker True 0 False",
    ]


@pytest.mark.parametrize(
    ("tracker", "missing", "needed"), [("kalman", "gtsam", "filterpy"), ("factor-graph", "filterpy", "gtsam")]
)
def test_a_tracker_runs_without_the_library_of_the_other_estimator_and_without_those_of_training(
    tracker, missing, needed
):
    pytest.importorskip(needed)
    assert printed_by(WITHOUT.format(tracker=tracker, missing=missing)) == ["(6, 100, 100) True", "[]"]

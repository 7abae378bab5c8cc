"""Kernels are compiled when a tracker starts, and a tracker loads only the libraries that it uses."""

from __future__ import annotations

import subprocess
import sys

import pytest

STARTED_AND_FED = """
import sys
sys.modules["{missing}"] = None  # an import of it raises ImportError
from dataclasses import replace
from itertools import islice
from gridtrack.recordings.stream import open_stream
from gridtrack.recordings import packaged_recording
from gridtrack.trackers.contract import stream_of
from gridtrack.trackers.registry import load

data = packaged_recording("leg_tracker").parents[1]
recordings = {{"leg_tracker": "leg_tracker/leg_tracker.mcap@90s-94s", "junction": "junction/validation.tracks@0s-4s"}}

def compiled():
    modules = [module for name, module in sys.modules.items() if name.startswith("gridtrack.trackers")]
    found = {{value for module in modules for value in vars(module).values() if hasattr(value, "signatures")}}
    return sum(len(kernel.signatures) for kernel in found)

for name, site in {trackers}:
    stream = open_stream(f"{{data}}/{{recordings[site]}}")
    kind, before = load(name), compiled()
    spec = replace(stream_of(stream, data / "weights" / name / f"{{site}}.toml"), velocity_scored=True)
    tracker = kind(spec, kind.Options())
    started = compiled()
    for frame in islice(stream, 30):
        tracker.update(frame)
    forecast = tracker.predict(20)
    print(name, site, started > before, compiled() - started, bool(tracker.classes), len(forecast.objects) > 0)
print(sorted({{"torch", "optuna", "sklearn"}} & set(sys.modules)))
"""


@pytest.mark.parametrize(
    ("missing", "needed", "expected"),
    [
        ("gtsam", "filterpy", ["kalman junction True 0 True True", "dogma leg_tracker True 0 False False"]),
        ("filterpy", "gtsam", ["factor-graph leg_tracker True 0 False True"]),
    ],
)
def test_kernels_are_compiled_at_the_start_without_libraries_of_training_or_of_the_other_estimator(
    missing, needed, expected
):
    """Trackers and their recordings; of each whether kernels were compiled at the start and how many after it, whether
    it has classes, and whether it forecasts objects."""
    pytest.importorskip(needed)
    program = STARTED_AND_FED.format(missing=missing, trackers=[tuple(line.split()[:2]) for line in expected])
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == [*expected, "[]"]

"""The start of the kalman tracker: kernels are compiled before the first frame."""

from __future__ import annotations

import subprocess
import sys

import pytest

pytest.importorskip("filterpy")

STARTED_AND_FED = """
from gridtrack.recordings.stream import open_stream
from gridtrack.recordings import packaged_recording
from gridtrack.trackers.contract import stream_of
from gridtrack.trackers.model_free import association, estimators, kalman, matching, motion
from gridtrack.trackers.model_free import rasterise, segmentation, shape
from gridtrack.trackers.model_free.kalman import KalmanTracker
from gridtrack.trackers.model_free.settings import PipelineSettings
from gridtrack.trackers.training import calibration

def compiled():
    kernels = segmentation._segment, segmentation._cut_off, association._distances_to, matching._match, shape._update
    kernels = *kernels, motion.predict_state, motion.propagate_all, estimators._mixture
    kernels = *kernels, estimators._updated_probabilities
    kernels = *kernels, rasterise.draw_tracks, calibration._apply, kalman._normalise_state
    return [len(kernel.signatures) for kernel in kernels]

demo = packaged_recording("leg_tracker")
stream = open_stream(f"{demo}@90s-100s")
card = demo.parents[1] / "weights" / "kalman" / "leg_tracker.toml"
tracker = KalmanTracker(stream_of(stream, card), PipelineSettings())
before = compiled()
for frame in stream:
    tracker.update(frame)
tracker.predict(20)
print(set(before), set(compiled()))
"""


def test_kernels_are_compiled_when_the_tracker_starts():
    done = subprocess.run([sys.executable, "-c", STARTED_AND_FED], capture_output=True, text=True, check=True)
    assert done.stdout == "{1} {1}\n"

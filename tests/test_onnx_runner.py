"""The runner of exported networks, `examples/onnx_runner`: its forecasts are those of the trackers."""

import re
import runpy
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch")

from gridtrack.common.forecast_file import open_forecasts
from tests.trackers.recurrent.sources import TRACKERS, Walk, trained
from tests.trackers.recurrent.test_device import general_card

RUNNER = Path(__file__).parents[1] / "examples" / "onnx_runner" / "run.py"
STEPS = 4
TOLERANCE = 1e-5
"""Largest difference of P(occupied); kernels and ONNX Runtime sum in another order."""


class WalkWithGap(Walk):
    """Ten frames in a window that moves, of which two are lost."""

    def __iter__(self):
        yield from (frame for t, frame in enumerate(super().__iter__()) if t not in (5, 6))


def frames_file(source, path):
    frames, corner = list(source), source.grid.origin
    np.savez(
        path,
        stamp_ns=[frame.stamp_ns for frame in frames],
        visible=[frame.visible for frame in frames],
        occupied=[frame.occupied for frame in frames],
        origin_xy=[np.add(corner, (frame.world_T_grid.x, frame.world_T_grid.y)) for frame in frames],
    )
    return frames


@pytest.mark.parametrize(
    ("kind", "period_s"), [(TRACKERS[0], 0.2), (TRACKERS[1], 0.05)], ids=["two steps a frame", "two phases"]
)
def test_the_runner_forecasts_as_the_tracker(tmp_path, kind, period_s):
    source = WalkWithGap(24, 0.2, period_s, frames=12, drift=2)
    tracker = trained(kind, general_card(kind), source)
    tracker.export(tmp_path)
    frames = frames_file(source, tmp_path / "frames.npz")
    runpy.run_path(str(RUNNER))["main"](tmp_path, tmp_path / "frames.npz", tmp_path / "forecasts.npz", STEPS)
    found = open_forecasts(tmp_path / "forecasts.npz")
    assert found.stamp_ns.tolist() == [frame.stamp_ns for frame in frames]
    tracker.reset(0)
    for number, frame in enumerate(frames):
        tracker.update(frame)
        expected = tracker.predict(STEPS).occupancy
        assert expected.max() > 0.1, "the forecast has the walker"
        for lead in range(STEPS + 1):
            assert abs(found.occupancy(number, lead) - expected[lead]).max() < TOLERANCE


def test_the_runner_imports_numpy_and_onnx_runtime_only():
    imports = re.findall(r"^(?:import|from) (\w+)", RUNNER.read_text(), flags=re.MULTILINE)
    assert imports == ["json", "sys", "pathlib", "numpy", "onnxruntime"]


def test_the_runner_keeps_a_static_map_in_its_window():
    network = object.__new__(runpy.run_path(str(RUNNER))["Network"])
    network.unseen, network.corner, network.manifest = None, [1.0, 2.0], {"cell_m": 0.2}
    network.nothing = np.zeros((4, 4))
    network.follow(np.array([1.0, 2.0]))
    with pytest.raises(SystemExit, match=r"static memory of this network is for the window at \[1. 2.\], not \[1.2"):
        network.follow(np.array([1.2, 2.0]))

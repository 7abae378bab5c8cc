"""The junction: its layout keeps the streets free, its demand has the stated rates, as has the packaged set."""

from __future__ import annotations

import importlib.util
import itertools
import xml.etree.ElementTree as ET
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest

from gridtrack.common.errors import ConfigurationError
from gridtrack.common.grid import GridSpec
from gridtrack.recordings import open_recording, packaged_recording
from gridtrack.simulation import junction, sumo, traffic
from gridtrack.simulation.junction import JUNCTION_SET, layout, road_users, simulate_junction
from gridtrack.simulation.junction.road_users import Patience
from gridtrack.simulation.tracks_file import read_tracks, write_tracks
from gridtrack.simulation.traffic import inside

NETWORK = Path(junction.__file__).with_name("network.net.xml")
TESTS = [name for name in JUNCTION_SET if name.startswith("test-")]


def street_points() -> np.ndarray:
    """Points on the lanes, pavements, crossings and waiting areas of the network."""
    points = []
    for lane in ET.parse(NETWORK).getroot().iter("lane"):
        shape = np.array([tuple(map(float, corner.split(","))) for corner in lane.get("shape").split()])
        if ":C_w" in lane.get("id"):
            points.append(shape)
            continue
        for start, end in itertools.pairwise(shape):
            along = (end - start) / np.linalg.norm(end - start)
            across = np.array([-along[1], along[0]]) * float(lane.get("width")) / 2.0
            shares = np.linspace(0.0, 1.0, 30)[:, None]
            points += [start + shares * (end - start) + side * across for side in np.linspace(-1.0, 1.0, 11)]
    return np.concatenate(points)


def test_the_streets_have_no_static_objects() -> None:
    streets = street_points()
    assert len(streets) > 1000
    for outline in layout.static_outlines():
        assert not inside(streets, np.array(outline)).any(), outline


def test_the_laser_is_beside_the_streets_and_outside_the_houses() -> None:
    at = np.array([[layout.LASER.x, layout.LASER.y]])
    assert not any(inside(at, np.array(outline)).any() for outline in layout.static_outlines())
    assert np.linalg.norm(street_points() - at, axis=1).min() > 0.3


def test_the_window_is_twenty_metres_and_contains_the_middle_of_the_junction() -> None:
    grid = GridSpec.parse(layout.JUNCTION_GRID)
    assert (grid.size, grid.cell_m) == (100, 0.2)
    middle = layout.LASER.pose.inverse().apply(np.zeros((1, 2)))
    assert grid.cells_of(middle)[1].all()


def test_the_signals_have_the_cycle_of_the_recording() -> None:
    phases = ET.parse(NETWORK.with_name("signals.add.xml")).getroot().iter("phase")
    assert sum(float(phase.get("duration")) for phase in phases) == layout.CYCLE_S


def test_the_demand_sums_to_its_rates() -> None:
    root = ET.fromstring(road_users.routes())
    rates = dict.fromkeys(("car", "bus", "cyclist", "pedestrian"), 0.0)
    for flow in (*root.iter("flow"), *root.iter("personFlow")):
        rates[flow.get("type")] += float(flow.get("period")[4:-1])
    assert rates == pytest.approx(
        {
            "car": road_users.CARS,
            "bus": road_users.BUSES,
            "cyclist": road_users.CYCLISTS,
            "pedestrian": road_users.PEDESTRIANS,
        },
        abs=1e-4,
    )
    for distribution in root.iter("vTypeDistribution"):
        assert sum(float(kind.get("probability")) for kind in distribution) == pytest.approx(1.0)


def test_the_test_recordings_start_at_all_times_of_the_signal_cycle() -> None:
    begins = sorted(start_s % layout.CYCLE_S for name, (_, _, start_s) in JUNCTION_SET.items() if name in TESTS)
    assert np.diff([*begins, begins[0] + layout.CYCLE_S]).max() <= 6.0


def test_the_packaged_set_is_complete_and_small() -> None:
    files = [packaged_recording(f"junction/{name}") for name in JUNCTION_SET]
    assert len(TESTS) == 20
    assert sum(path.stat().st_size for path in files) < 4_000_000
    for name, path in zip(JUNCTION_SET, files, strict=True):
        info = read_tracks(path).info
        minutes, seed, _ = JUNCTION_SET[name]
        assert (info.frames, info.noise_seed, info.recording.site) == (minutes * 480, seed, "junction")
        assert info.recording.classes == layout.JUNCTION_CLASSES
        assert info.recording.grid == str(GridSpec.parse(layout.JUNCTION_GRID))


def test_the_test_recordings_have_no_faults_and_enough_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(traffic, "STRIDE", 240)  # moving cells are not checked here
    shares = []
    for name in TESTS[::4]:
        found = traffic.check_traffic(read_tracks(packaged_recording(f"junction/{name}")))
        assert found.faults == ()
        shares.append([kind.moving for kind in found.classes])
    pedestrian, cyclist, car, bus = np.mean(shares, axis=0)
    assert min(pedestrian, cyclist, car) >= 0.3
    assert bus >= 0.05


def test_a_packaged_recording_renders_with_truth(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    recording = open_recording(packaged_recording("junction/test-101"))
    summary = recording.overview().sensors["scan"]
    assert summary.scans == summary.labelled_scans == summary.scans_with_truth == 480
    assert summary.beams == (1081, 1081)
    assert not recording.warnings


def test_without_sumo_the_error_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "sumo", None)
    with pytest.raises(ConfigurationError, match=r"pip install 'gridtrack\[sim\]'"):
        simulate_junction(0.1, 1)


def test_an_error_of_sumo_reaches_the_user(tmp_path: Path) -> None:
    pytest.importorskip("sumo", reason="SUMO is not installed")
    with pytest.raises(sumo.SimulationError, match=r"SUMO failed with seed 3: Error: .*; try another seed"):
        sumo.run_sumo(tmp_path, NETWORK, "<routes><flow/></routes>", (), (0.0, 1.0), 3, Patience(layout.JUNCTION_NODE))


@pytest.mark.skipif(importlib.util.find_spec("sumo") is None, reason="SUMO is not installed")
def test_the_same_seed_gives_the_same_bytes_and_another_seed_other_traffic() -> None:
    files = []
    for seed in (1, 1, 2):
        file = BytesIO()
        write_tracks(file, simulate_junction(0.05, seed, start_s=10.0))
        files.append(file.getvalue())
    assert files[0] == files[1]
    assert files[0] != files[2]

"""The packaged worlds: number, seeds, size, variety, and rendering."""

from __future__ import annotations

import importlib.util
from importlib.metadata import version
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest

from gridtrack.recordings import open_recording
from gridtrack.simulation.tracks import Tracks
from gridtrack.simulation.tracks_file import read_tracks, write_tracks

FOLDER = Path(__file__).parents[3] / "data" / "worlds"
TEST, VALIDATION = sorted((FOLDER / "test").glob("*.tracks")), sorted((FOLDER / "validation").glob("*.tracks"))


def seed_of(path: Path) -> int:
    return int(path.stem.rpartition("-")[2])


@pytest.fixture(scope="module")
def shipped() -> dict[Path, Tracks]:
    return {path: read_tracks(path) for path in (*TEST, *VALIDATION)}


def test_the_set_has_its_seeds_half_of_it_indoors_and_is_small() -> None:
    assert sorted(map(seed_of, TEST)) == list(range(1002, 1022))
    assert sorted(map(seed_of, VALIDATION)) == list(range(2003, 2013))
    for paths in (TEST, VALIDATION):
        assert sum(path.name.startswith("indoors-") for path in paths) == len(paths) // 2
    assert sum(path.stat().st_size for path in (*TEST, *VALIDATION)) < 8e6


def test_each_is_its_own_site_with_its_command(shipped: dict[Path, Tracks]) -> None:
    for path, tracks in shipped.items():
        assert tracks.info.recording.site == f"world-{seed_of(path)}"
        assert tracks.info.recording.command.endswith(f"--count 1 --minutes 1 --seed {seed_of(path)}")
        assert tracks.info.frames == round(60.0 * tracks.info.rate_hz)


def test_their_lasers_vary(shipped: dict[Path, Tracks]) -> None:
    infos = [tracks.info for tracks in shipped.values()]
    lasers = [info.lasers["scan"] for info in infos]
    assert len({laser.model_dump_json() for laser in lasers}) == len(lasers)
    assert all(180 <= laser.beams <= 1440 and 5.0 <= laser.range_max <= 80.0 for laser in lasers)
    assert all(5.0 <= info.rate_hz <= 20.0 for info in infos)
    assert sum(info.rate_hz < 7.5 for info in infos) > 5
    assert sum(info.rate_hz > 15.0 for info in infos) > 3
    assert 0.15 < np.mean([info.carrier is not None for info in infos]) < 0.6
    planes = [info.world.plane_m for info in infos if info.world]
    assert len(planes) == len(infos)
    assert sum(plane < 0.5 for plane in planes) > 20


@pytest.mark.parametrize("kind", ["indoors-room", "outdoors-street"])
def test_a_world_renders_to_scans_of_its_road_users(kind: str, own_cache: Path) -> None:
    recording = open_recording(next(path for path in TEST if path.stem.startswith(kind)))
    static = recording.info.classes.index("static")
    seen = frames = 0
    for scan in recording.scans():
        assert scan.labels is not None
        assert scan.scene is not None
        assert set(scan.labels[scan.labels < static].tolist()) <= {body.label for body in scan.scene.objects}
        seen += bool((scan.labels < static).any())
        frames += 1
    assert seen > 0.3 * frames


@pytest.mark.skipif(importlib.util.find_spec("jupedsim") is None, reason="JuPedSim is not installed")
@pytest.mark.parametrize("kind", ["indoors-office", "outdoors-street"])
def test_a_world_simulated_again_has_the_same_bytes(kind: str, shipped: dict[Path, Tracks]) -> None:
    from gridtrack.simulation import worlds

    path, tracks = next((path, tracks) for path, tracks in shipped.items() if path.stem.startswith(kind))
    if any(version(name) != made for name, made in tracks.info.made_with.items()):
        pytest.skip("made with another version of the simulators")
    again = BytesIO()
    write_tracks(again, worlds.simulate_world(seed_of(path), 1.0))
    assert again.getvalue() == path.read_bytes()

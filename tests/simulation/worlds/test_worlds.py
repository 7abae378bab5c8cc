"""Worlds: no two alike, one seed one byte stream, people who walk where there is room, and lasers that see them."""

from __future__ import annotations

import subprocess
import sys
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest

from gridtrack.recordings import open_recording
from gridtrack.simulation.tracks import Tracks
from gridtrack.simulation.tracks_file import write_tracks
from gridtrack.simulation.traffic import inside

pytest.importorskip("jupedsim", reason="JuPedSim is not installed")
from gridtrack.simulation import worlds

MINUTES = 0.2
SEEDS = range(40, 40 + len(worlds.KINDS))


@pytest.fixture(scope="module")
def made() -> dict[int, Tracks]:
    return {seed: worlds.simulate_world(seed, MINUTES) for seed in SEEDS}


def content(tracks: Tracks) -> bytes:
    file = BytesIO()
    write_tracks(file, tracks)
    return file.getvalue()


def test_one_seed_is_one_byte_stream(made: dict[int, Tracks]) -> None:
    for seed, tracks in made.items():
        assert content(worlds.simulate_world(seed, MINUTES)) == content(tracks), worlds.world_name(seed)


def test_no_two_worlds_are_alike(made: dict[int, Tracks]) -> None:
    infos = [tracks.info for tracks in made.values()]
    for values in (
        {info.static for info in infos},
        {info.lasers["scan"].model_dump_json() for info in infos},
        {info.world.plane_m for info in infos if info.world},
    ):
        assert len(values) == len(infos)
    kinds = {worlds.world_name(seed).split("-", 1)[1].rsplit("-", 1)[0] for seed in SEEDS}
    assert kinds == set(worlds.KINDS)


def test_somebody_moves_in_every_world_and_nobody_through_walls(made: dict[int, Tracks]) -> None:
    for seed, tracks in made.items():
        people = tracks.without_carrier()
        pose = people.pose[people.label == 0]
        assert len(pose), worlds.world_name(seed)
        for outline in tracks.info.static:
            corners = np.array(outline)
            if np.ptp(corners, axis=0).max() > 1.0:
                assert inside(pose[:, :2], corners).mean() < 0.01, worlds.world_name(seed)


def test_paths_are_smooth(made: dict[int, Tracks]) -> None:
    for seed, tracks in made.items():
        walking = tracks.where(tracks.label == 0)
        order = np.lexsort((walking.frame, walking.track))
        follows = (np.diff(walking.track[order]) == 0) & (np.diff(walking.frame[order]) == 1)
        speed = np.hypot(*np.diff(walking.pose[order, :2], axis=0).T)[follows] * tracks.info.rate_hz
        assert speed.max(initial=0.0) < 3.0, worlds.world_name(seed)


def test_a_world_opens_as_a_recording_whose_laser_sees_people(
    made: dict[int, Tracks], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    seen = 0
    for seed, tracks in made.items():
        path = tmp_path / f"{worlds.world_name(seed)}.tracks"
        path.write_bytes(content(tracks))
        scans = list(open_recording(path).scans())
        assert len(scans) == tracks.info.frames
        labels = np.concatenate([scan.labels for scan in scans if scan.labels is not None])
        assert (labels == worlds.CLASSES.index("static")).mean() > 0.03, path.name
        seen += bool((labels < worlds.CLASSES.index("static")).any())
    assert seen >= 0.7 * len(made)


def test_the_command_keeps_worlds_that_exist_and_refuses_others_of_their_name(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "gridtrack.cli", "simulate", "worlds", "--seed", "8", "--out", str(tmp_path)]
    first = subprocess.run([*command, "--minutes", "0.1"], capture_output=True, text=True, check=True)
    (made,) = tmp_path.iterdir()
    assert str(made) in first.stdout
    assert "a laser" in first.stdout
    before = made.stat().st_mtime_ns
    again = subprocess.run([*command, "--minutes", "0.1", "--count", "2"], capture_output=True, text=True, check=True)
    assert again.stdout.startswith(first.stdout)
    assert made.stat().st_mtime_ns == before
    assert len(list(tmp_path.iterdir())) == 2
    other = subprocess.run([*command, "--minutes", "0.2"], capture_output=True, text=True, check=False)
    assert other.returncode == 2
    assert "there is another recording of this name" in other.stderr

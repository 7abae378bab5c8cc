"""Worlds: all different, one seed one byte stream, people on free ground, and lasers that see them."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from gridtrack.cli import app
from gridtrack.common.errors import RecordingError
from gridtrack.common.scene import UNLABELLED
from gridtrack.recordings import open_recording
from gridtrack.simulation.tracks import Tracks
from gridtrack.simulation.tracks_file import write_tracks
from gridtrack.simulation.traffic import inside

pytest.importorskip("jupedsim", reason="JuPedSim is not installed")
from gridtrack.simulation import worlds
from gridtrack.simulation.worlds.sensors import GRID_CELLS, draw_sensor

MINUTES = 0.1
SEEDS = range(40, 40 + len(worlds.KINDS))


@pytest.fixture(scope="module")
def made() -> dict[int, Tracks]:
    return {seed: worlds.simulate_world(seed, MINUTES) for seed in SEEDS}


def content(tracks: Tracks) -> bytes:
    file = BytesIO()
    write_tracks(file, tracks)
    return file.getvalue()


def test_one_seed_is_one_byte_stream(made: dict[int, Tracks]) -> None:
    seed = next(seed for seed in SEEDS if worlds.kind_of(seed) == "room")
    assert content(worlds.simulate_world(seed, MINUTES)) == content(made[seed])


def test_all_worlds_are_different(made: dict[int, Tracks]) -> None:
    infos = [tracks.info for tracks in made.values()]
    for values in (
        {info.static for info in infos},
        {info.lasers["scan"].model_dump_json() for info in infos},
        {info.world.plane_m for info in infos if info.world},
    ):
        assert len(values) == len(infos)
    kinds = {worlds.world_name(seed).split("-", 1)[1].rsplit("-", 1)[0] for seed in SEEDS}
    assert kinds == set(worlds.KINDS)


def test_there_are_people_in_every_world_and_none_inside_walls(made: dict[int, Tracks]) -> None:
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


@pytest.mark.parametrize("kind", ["room", "car-park", "street"])
def test_a_world_opens_as_a_recording_with_returns_of_people(own_cache, made, tmp_path: Path, kind: str) -> None:
    seed, tracks = next((seed, tracks) for seed, tracks in made.items() if worlds.kind_of(seed) == kind)
    path = tmp_path / f"{worlds.world_name(seed)}.tracks"
    path.write_bytes(content(tracks))
    scans = list(open_recording(path).scans())
    assert len(scans) == tracks.info.frames
    labels = np.concatenate([scan.labels[scan.labels != UNLABELLED] for scan in scans if scan.labels is not None])
    of_the_place = ("static", "car")  # parked cars, where a short laser sees nothing else
    assert np.isin(labels, [worlds.CLASSES.index(name) for name in of_the_place]).mean() > 0.03
    assert (labels < worlds.CLASSES.index("static")).any()


def test_the_command_keeps_existing_worlds_and_refuses_others_of_their_name(tmp_path: Path) -> None:
    def simulate(*options: str):
        return CliRunner().invoke(app, ["simulate", "worlds", "--seed", "8", "--out", str(tmp_path), *options])

    first = simulate("--minutes", "0.1")
    (path,) = tmp_path.iterdir()
    assert str(path) in first.stdout
    assert "a laser" in first.stdout
    before = path.stat().st_mtime_ns
    again = simulate("--minutes", "0.1", "--count", "2")
    assert again.stdout.startswith(first.stdout)
    assert path.stat().st_mtime_ns == before
    assert len(list(tmp_path.iterdir())) == 2
    other = simulate("--minutes", "0.2")
    assert isinstance(other.exception, RecordingError)
    assert "there is another recording of this name" in str(other.exception)


@pytest.mark.parametrize("outdoors", [False, True])
def test_lasers_of_every_range_are_recorded_slowly_and_fast(outdoors: bool) -> None:
    random = np.random.default_rng(1)
    drawn = [draw_sensor(random, outdoors) for _ in range(600)]
    assert all(5.0 <= one.rate_hz <= 20.0 for one in drawn)
    for far in (False, True):  # to 80 m: a SICK LMS 200, whose recordings aces and intel have 5 and 6.25 Hz
        rates = np.array([one.rate_hz for one in drawn if (one.laser.range_max > 60.0) == far])
        assert 0.1 < (rates < 7.5).mean() < 0.6
        assert (rates > 10.0).mean() > 0.15


def test_a_third_of_the_drivers_report_nan_and_half_of_these_lasers_are_short() -> None:
    random = np.random.default_rng(2)
    drawn = [draw_sensor(random, outdoors=False) for _ in range(600)]
    unknown = [one for one in drawn if one.laser.errors is not None and one.laser.errors.no_return == "nan"]
    assert 0.3 < len(unknown) / len(drawn) < 0.4
    in_window = np.array([one.laser.range_max / (GRID_CELLS * one.cell_m / 2.0) for one in unknown])
    assert in_window.min() >= 0.69
    assert (in_window < 1.5).mean() > 0.45

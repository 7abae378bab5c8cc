"""Tracks of a world: they round-trip, and people are two legs in scans and in truth."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from gridtrack.common.errors import GridtrackError, RecordingError
from gridtrack.recordings import RecordingInfo, open_recording
from gridtrack.simulation.bodies import Walker
from gridtrack.simulation.laser import Laser, LaserErrors
from gridtrack.simulation.tracks import ONLY_LASER, Tracks, TracksInfo, World
from gridtrack.simulation.tracks_file import read_tracks, write_recording

pytestmark = pytest.mark.usefixtures("own_cache")
FRAMES, RATE_HZ = 30, 10.0
WALL = ((5.0, -5.0), (6.0, -5.0), (6.0, 5.0), (5.0, 5.0))


def world(plane_m: float = 0.3, dark: bool = False, glass: frozenset[int] = frozenset()) -> Tracks:
    """A pedestrian who walks past the laser, 2 m ahead, at 1.2 m/s, in front of a wall."""
    errors = LaserErrors(std_m=0.0, glass_seen=0.0, dark_reach=0.05)
    info = TracksInfo(
        recording=RecordingInfo(site="world-1", classes=("pedestrian", "static"), grid="100x0.1", rate_hz=RATE_HZ),
        lasers={ONLY_LASER: Laser(angle_min=-1.5, angle_increment=0.005, beams=601, errors=errors)},
        frames=FRAMES,
        rate_hz=RATE_HZ,
        static=(WALL,),
        static_class="static",
        world=World(plane_m=plane_m, walkers={4: Walker(dark=dark)}, glass=glass),
    )
    y = np.arange(FRAMES) / RATE_HZ * 1.2 - 1.7
    pose = np.column_stack([np.full(FRAMES, 2.0), y, np.full(FRAMES, np.pi / 2)])
    frame, one = np.arange(FRAMES), np.ones(FRAMES, np.int64)
    return Tracks(info, frame, 4 * one, 0 * one, pose, np.tile([0.25, 0.45], (FRAMES, 1))).rounded()


def test_a_world_round_trips(tmp_path: Path) -> None:
    tracks = world(glass=frozenset({0}))
    write_recording(tmp_path / "world.tracks", tracks)
    found = read_tracks(tmp_path / "world.tracks")
    assert found.info == tracks.info
    np.testing.assert_array_equal(found.pose, tracks.pose)


def test_a_person_is_two_legs_in_the_scan_and_in_the_truth(tmp_path: Path) -> None:
    write_recording(tmp_path / "world.tracks", world())
    scans = list(open_recording(tmp_path / "world.tracks").scans())
    apart = 0
    for scan in scans:
        assert scan.scene is not None
        assert scan.labels is not None
        legs = scan.scene.objects
        assert [leg.track for leg in legs] == [4, 4]
        assert legs[0].world_T_object == legs[1].world_T_object
        person = np.flatnonzero(scan.labels == 0)
        assert person.size
        apart += bool((np.diff(person) > 3).any())
    assert apart > FRAMES / 2


def test_a_person_is_one_torso_at_chest_height(tmp_path: Path) -> None:
    write_recording(tmp_path / "world.tracks", world(plane_m=1.3))
    for scan in open_recording(tmp_path / "world.tracks").scans():
        assert scan.scene is not None
        assert len(scan.scene.objects) == 1


def test_dark_clothes_and_glass_give_no_returns(tmp_path: Path) -> None:
    write_recording(tmp_path / "dark.tracks", world(dark=True, glass=frozenset({0})))
    scans = list(open_recording(tmp_path / "dark.tracks").scans())
    aside = [scan.ranges[:200] for scan in scans]
    assert not np.isfinite(np.concatenate(aside)).any()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"glass": [1]}, "a glass or dark surface without a static outline"),
        ({"dark": [-1]}, "a glass or dark surface without a static outline"),
        ({"plane_m": 50.0}, "'world.plane_m' = 50.0"),
        ({"walkers": {"4": {"height_m": 9.0}}}, "height_m' = 9.0"),
        ({"walkers": {"4": {"companion": "elephant"}}}, "companion"),
    ],
)
def test_an_invalid_world_is_one_line_of_error(altered, change: dict[str, object], message: str) -> None:
    path = altered(world(), lambda values: values | {"world": values["world"] | change})
    with pytest.raises(GridtrackError, match=message) as error:
        read_tracks(path)
    assert "\n" not in str(error.value)


def test_errors_of_a_laser_without_a_world_are_refused(tmp_path: Path) -> None:
    tracks = world()
    without = dataclasses.replace(tracks, info=tracks.info.model_copy(update={"world": None}))
    with pytest.raises(RecordingError, match="needs a world"):
        write_recording(tmp_path / "lost.tracks", without)
    assert not (tmp_path / "lost.tracks").exists()

"""Files of tracks: they round-trip, hostile files are one line of error, and a recording is rendered from them.

In a world people are two legs in scans and in truth.
"""

from __future__ import annotations

import dataclasses
import shutil
from io import BytesIO
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from gridtrack.common.errors import GridtrackError, RecordingError
from gridtrack.recordings import open_recording, packaged_recording
from gridtrack.simulation.bodies import Walker, body_outline
from gridtrack.simulation.laser import Laser, LaserErrors
from gridtrack.simulation.recording_format import rendering_folder
from gridtrack.simulation.tracks import ONLY_LASER, Tracks, World
from gridtrack.simulation.tracks_file import METADATA_KEY, read_tracks, write_recording, write_tracks
from gridtrack.simulation.traffic import GRIDLOCK_S, check_traffic
from tests.simulation.conftest import tracks_of

pytestmark = pytest.mark.usefixtures("own_cache")
WALL = ((5.0, -5.0), (6.0, -5.0), (6.0, 5.0), (5.0, 5.0))


def walk(frames: int = 16) -> Tracks:
    """A pedestrian who walks north 3 m ahead of the laser at 1 m/s, and a standing car behind the laser."""
    lasers = {ONLY_LASER: Laser(angle_min=-np.pi, angle_increment=np.radians(1.0), beams=360)}
    y = np.arange(frames) / 8.0 - 1.0
    walker = np.column_stack([np.full(frames, 3.0), y, np.full(frames, np.pi / 2)])
    car = np.tile([-6.0, 0.0, -3.0], (frames, 1))
    users = (0, 0, walker, (0.3, 0.5)), (1, 2, car, (4.5, 1.82))
    return tracks_of(*users, lasers=lasers, static=(WALL,))


def test_tracks_round_trip_to_the_centimetre_and_the_milliradian(tmp_path: Path) -> None:
    tracks = walk()
    write_recording(tmp_path / "yard.tracks", tracks)
    found = read_tracks(tmp_path / "yard.tracks")
    assert found.info == tracks.info
    for name in ("frame", "track", "label", "pose", "size"):
        np.testing.assert_array_equal(getattr(found, name), getattr(tracks, name))
    random = np.random.default_rng(0)
    crooked = dataclasses.replace(tracks, pose=random.uniform(-20, 20, tracks.pose.shape))
    write_recording(tmp_path / "yard.tracks", crooked)
    difference = read_tracks(tmp_path / "yard.tracks").pose - crooked.pose
    assert abs(difference[:, :2]).max() <= 0.00501
    assert abs(np.angle(np.exp(1j * difference[:, 2]))).max() <= 0.001


def test_same_tracks_same_bytes() -> None:
    once, again = BytesIO(), BytesIO()
    write_tracks(once, walk())
    write_tracks(again, walk())
    assert once.getvalue() == again.getvalue()


def test_tracks_open_as_a_recording_with_scans_of_them(tmp_path: Path) -> None:
    write_recording(tmp_path / "yard.tracks", walk())
    recording = open_recording(tmp_path / "yard.tracks")
    scans = list(recording.scans())
    assert (recording.name, recording.info.site) == ("yard.tracks", "yard")
    assert [scan.stamp_ns for scan in scans] == [k * 125_000_000 for k in range(16)]
    ahead = scans[8]
    assert ahead.labels is not None
    assert ahead.scene is not None
    assert ahead.labels[[180, 210, 0]].tolist() == [0, 4, 2]
    # the body, 0.5 m wide towards the laser, is 3 m ahead
    assert ahead.ranges[180] == pytest.approx(3.0 - 0.25, abs=0.12)
    assert ahead.scene.objects[0].world_T_object.y == pytest.approx(0.0)
    assert np.array_equal(ahead.scene.static[0], np.array(WALL, np.float32))


def test_the_rendering_is_cached_and_repeated_if_it_is_damaged(tmp_path: Path, own_cache: Path) -> None:
    path = tmp_path / "yard.tracks"
    write_recording(path, walk())
    expected = [scan.ranges for scan in open_recording(path).scans()]
    (rendering,) = rendering_folder().glob("*.mcap")
    assert own_cache in rendering.parents
    made = rendering.stat().st_mtime_ns
    np.testing.assert_array_equal([scan.ranges for scan in open_recording(path).scans()], expected)
    assert rendering.stat().st_mtime_ns == made
    content = rendering.read_bytes()
    rendering.write_bytes(content[:-100] + bytes(100))
    np.testing.assert_array_equal([scan.ranges for scan in open_recording(path).scans()], expected)
    assert rendering.read_bytes() == content
    assert sorted(p.suffix for p in rendering_folder().iterdir()) == [".mcap", ".sha256"]


def test_the_cache_may_be_emptied_between_two_readings(tmp_path: Path, own_cache: Path) -> None:
    write_recording(tmp_path / "yard.tracks", walk())
    recording = open_recording(tmp_path / "yard.tracks")
    first = [scan.stamp_ns for scan in recording.scans()]
    shutil.rmtree(own_cache)
    assert [scan.stamp_ns for scan in recording.scans()] == first


def test_other_tracks_of_the_same_name_are_rendered_again(tmp_path: Path) -> None:
    path = tmp_path / "yard.tracks"
    for frames in (16, 24):
        write_recording(path, walk(frames))
        assert len(list(open_recording(path).scans())) == frames


def test_a_recording_of_scans_equals_the_rendering_of_its_tracks(tmp_path: Path) -> None:
    write_recording(tmp_path / "yard.tracks", walk())
    write_recording(tmp_path / "yard.mcap", walk())
    list(open_recording(tmp_path / "yard.tracks").scans())
    (rendering,) = rendering_folder().glob("*.mcap")
    assert rendering.read_bytes() == (tmp_path / "yard.mcap").read_bytes()


def test_the_error_for_a_cache_that_cannot_be_written_names_the_remedy(tmp_path: Path, own_cache: Path) -> None:
    own_cache.write_text("a file where the folder should be")
    write_recording(tmp_path / "yard.tracks", walk())
    with pytest.raises(RecordingError, match="set XDG_CACHE_HOME"):
        list(open_recording(tmp_path / "yard.tracks").scans())


@pytest.mark.parametrize(
    ("column", "value", "message"),
    [
        ("frame", 99, "a frame outside 0 to 15"),
        ("frame", -1, "a frame outside 0 to 15"),
        ("frame", 1, "a track twice in one frame"),
        ("track", -4, "a track below 0"),
        ("class", 5, "a class above 4"),
        ("length_cm", 0, "a body of size 0"),
        ("x_cm", None, "a value is missing"),
    ],
)
def test_a_file_with_an_invalid_row_is_one_line_of_error(tmp_path: Path, column: str, value, message: str) -> None:
    path = tmp_path / "odd.tracks"
    write_recording(path, walk())
    table = pq.read_table(path)
    changed = pa.array([value, *table[column].to_pylist()[1:]], table.schema.field(column).type)
    pq.write_table(table.set_column(table.schema.names.index(column), column, changed), path)
    with pytest.raises(RecordingError, match=message) as error:
        list(open_recording(path).scans())
    assert str(error.value).count("odd.tracks") == 1


BROAD = {"beams": 100_000, "angle_increment": 1e-5}


@pytest.mark.parametrize(
    ("about", "message"),
    [
        ({"schema": 4}, "schema 4; this gridtrack reads 1 to 3"),
        ([], "schema None"),
        ({"colour": "red"}, "there is no option 'colour'"),
        ({"static": [[[0, 0], [1, 1]]]}, "3 to 1000 corners"),
        ({"static_class": "wall"}, "not one of its classes"),
        ({"frames": 10**12}, "less than or equal to 5000000"),
        ({"frames": 5_000_000}, "beams to render; at most 1000000000"),
        ({"laser": {"beams": 10**9}}, "less than or equal to 100000"),
        ({"laser": {"angle_increment": 1e308}}, "less than or equal to 12"),
        ({"laser": {"angle_increment": 0.1, "beams": 1000}}, "the beams cover more than two turns"),
        ({"laser": {"angle_min": -1e308}}, "greater than or equal to -12"),
        ({"laser": {"x": 1e300}}, "less than or equal to 1000000"),
        ({"rate_hz": 1e-300}, "greater than or equal to 0.001"),
        ({"noise_seed": 2**63}, "less than 9223372036854775808"),
        ({"noise_seed": 10**30}, r"not valid JSON \(an integer of 31 digits; at most 64 bits"),
        ({"static": [[[0, 0], [1, 1], [1e300, 0]]]}, "further than 1e\\+06 m"),
        ({"laser": BROAD, "frames": 9, "static": [[[0, 0]] * 1000] * 11}, "1100000000 pairs of a beam and a static"),
    ],
)
def test_a_file_with_invalid_metadata_is_one_line_of_error(altered, about, message: str) -> None:
    path = altered(walk(), lambda values: values | about if isinstance(about, dict) else about)
    with pytest.raises(GridtrackError, match=message) as error:
        list(open_recording(path).scans())
    assert str(error.value).count("odd.tracks") == 1


def test_damaged_and_foreign_files_are_one_line_of_error(tmp_path: Path) -> None:
    path = tmp_path / "odd.tracks"
    write_recording(path, walk())
    content = path.read_bytes()
    for damaged in (content[:200], content[:100] + b"\xff" * 200 + content[300:], content[:-30]):
        path.write_bytes(damaged)
        with pytest.raises(RecordingError, match="damaged"):
            list(open_recording(path).scans())
    pq.write_table(pa.table({"a": [1]}), path)
    with pytest.raises(RecordingError, match="not a file of tracks"):
        list(open_recording(path).scans())


def test_a_body_is_counter_clockwise_and_has_its_size() -> None:
    for kind, length, width in (("pedestrian", 0.3, 0.5), ("cyclist", 1.75, 0.6), ("car", 4.5, 1.8), ("tram", 20, 3)):
        outline = body_outline(kind, length, width).astype(np.float64)
        x, y = outline.T
        assert np.ptp(x) == pytest.approx(length, rel=1e-6)
        assert np.ptp(y) == pytest.approx(width, rel=1e-6)
        assert (x * np.roll(y, -1) - np.roll(x, -1) * y).sum() > 0.0


def test_the_check_counts_moving_and_standing_road_users() -> None:
    traffic = check_traffic(walk(160))
    walker, _, car, _ = traffic.classes
    assert (walker.present, walker.moving, car.present, car.moving) == (
        pytest.approx(88 / 160),
        pytest.approx(88 / 160),
        1.0,
        0.0,
    )
    assert walker.moving_cells_per_minute > 0.0
    assert car.moving_cells_per_minute == 0.0
    assert traffic.longest_stand_s == pytest.approx(20.0)
    assert traffic.faults == ()


def test_the_check_finds_collisions_with_walls_and_the_laser_and_gridlock() -> None:
    tracks = walk(4000)
    pose = tracks.pose.copy()
    pose[20::2][:3, :2] = (5.5, 0.0)
    pose[60::2][:2, :2] = (0.05, 0.05)
    faults = "\n".join(check_traffic(dataclasses.replace(tracks, pose=pose)).faults)
    assert "pedestrian inside a static outline in 3 positions, the first of track 0 in frame 10" in faults
    assert "pedestrian on the laser in 2 positions, the first of track 0 in frame 30" in faults
    assert "gridlock: a vehicle stands for 500 s, the car of track 1 at (" in faults
    assert "from frame 0 on" in faults


def test_a_wait_of_two_green_phases_is_not_gridlock() -> None:
    assert check_traffic(walk(round(GRIDLOCK_S * 8.0))).faults == ()
    assert "gridlock" in check_traffic(walk(round(GRIDLOCK_S * 8.0) + 8)).faults[0]


def test_a_shipped_recording_is_written_again_with_the_same_metadata(tmp_path):
    shipped = packaged_recording("junction/test-101")
    path = tmp_path / "again.tracks"
    write_recording(path, read_tracks(shipped))
    before, after = (pq.read_schema(one).metadata[METADATA_KEY] for one in (shipped, path))
    assert after == before


# ---- worlds


FRAMES = 30


def world(plane_m: float = 0.3, dark: bool = False, glass: frozenset[int] = frozenset()) -> Tracks:
    """A pedestrian who walks past the laser, 2 m ahead, at 1.2 m/s, in front of a wall."""
    errors = LaserErrors(std_m=0.0, glass_seen=0.0, dark_reach=0.05)
    lasers = {ONLY_LASER: Laser(angle_min=-1.5, angle_increment=0.005, beams=601, errors=errors)}
    y = np.arange(FRAMES) / 10.0 * 1.2 - 1.7
    pose = np.column_stack([np.full(FRAMES, 2.0), y, np.full(FRAMES, np.pi / 2)])
    about = {"rate_hz": 10.0, "world": World(plane_m=plane_m, walkers={4: Walker(dark=dark)}, glass=glass)}
    recording = {"site": "world-1", "classes": ("pedestrian", "static"), "grid": "100x0.1"}
    return tracks_of((4, 0, pose, (0.25, 0.45)), lasers=lasers, recording=recording, static=(WALL,), **about)


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
    with pytest.raises(GridtrackError, match=message):
        read_tracks(path)


def test_errors_of_a_laser_without_a_world_are_refused(tmp_path: Path) -> None:
    tracks = world()
    without = dataclasses.replace(tracks, info=tracks.info.model_copy(update={"world": None}))
    with pytest.raises(RecordingError, match="needs a world"):
        write_recording(tmp_path / "lost.tracks", without)
    assert not (tmp_path / "lost.tracks").exists()

"""Rerun recordings of a recording and of a run, read back by Rerun's own reader and compared with a hand-drawn case."""

import math
import re
import shutil
import sys

import numpy as np
import psutil
import pytest
from rerun.chunk import RrdReader
from typer.testing import CliRunner

from gridtrack.cli import app
from gridtrack.common.errors import ConfigurationError
from gridtrack.common.geometry import SE2
from gridtrack.common.scan import Scan
from gridtrack.common.scene import Scene, SceneObject
from gridtrack.evaluation.referee.samples import SAMPLES
from gridtrack.recordings import RecordingInfo, write_native
from gridtrack.reports.run import ReportError
from gridtrack.reports.viewers import write_rerun_run

from scenes.drawn_samples import STAMP_NS, write_samples
from scenes.edited_run import edited

FREE, HIT, DARK = 0, 100, 255
START_NS = 1_600_000_000_000_000_000
WALLS = (np.array([[8, 3], [9, 3], [9, 3.5]], np.float32),)
CAR = np.array([[-1, -0.5], [1, -0.5], [1, 0.5], [-1, 0.5]], np.float32)


def gridtrack(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments], catch_exceptions=False)


def read(path):
    """The rows of each entity in the order of time: components by their names without the archetype."""
    rows = {}
    for chunk in RrdReader(path).stream():
        for row in chunk.to_record_batch().to_pylist():
            found = {name.rpartition(":")[2]: value for name, value in row.items()}
            rows.setdefault(str(chunk.entity_path), []).append(found)
    for entity in rows.values():
        entity.sort(key=lambda row: row.get("stamp").value if row.get("stamp") is not None else -1)
    return rows


def cells(row):
    """The values of a grid with the lowest row first: an image begins with the highest."""
    (image,) = row["format"]
    assert (image["color_model"], image["channel_datatype"]) == (1, 6)  # one channel of uint8
    values = np.array(row["data"][0]).reshape(image["height"], image["width"])
    return [[int(value) for value in line] for line in values[::-1]]


@pytest.fixture
def drive(tmp_path):
    """One beam along x, of a sensor that moves by 1.2 m in a second; a car ahead of it turns left."""
    scans = []
    for k, x in enumerate((10.2, 11.4)):
        car = SceneObject(5, 0, SE2(12.0, 5.0 + k, k * math.pi / 2), CAR)
        scene = Scene(WALLS, 1, (car,))
        beam = {"angle_min": 0.0, "angle_increment": 0.1, "range_min": 0.1, "range_max": 9.0}
        ranges = np.array([1.0], np.float32)
        stamp_ns = START_NS + k * 1_000_000_000
        scans.append(Scan(stamp_ns, ranges, sensor="laser/1", world_T_sensor=SE2(x, 5.1, 0.0), scene=scene, **beam))
    path = tmp_path / "drive.mcap"
    with path.open("wb") as file:
        info = RecordingInfo(site="yard", classes=("car", "static"), grid="4x1", rate_hz=1.0)
        write_native(file, info, scans)
    return path


def test_a_recording_has_its_frames_and_sensors_at_their_stamps_and_places_and_the_truth(drive, tmp_path):
    done = gridtrack("recording", "view", drive, "--out", tmp_path / "drive.rrd")
    assert "2 frames" in done.stdout
    rows = read(tmp_path / "drive.rrd")
    first, second = rows["/world/input"]
    assert [row["stamp"].value for row in (first, second)] == [START_NS, START_NS + 1_000_000_000]
    assert [row["time"].total_seconds() for row in (first, second)] == [0.0, 1.0]
    # four cells of a metre about (10, 5): from (8, 3); the sensor is in cell [2, 2] and the return in the one after it
    assert first["translation"] == [[8.0, 3.0, 0.0]]
    assert first["cell_size"] == [1.0]
    assert cells(first) == [[DARK] * 4, [DARK] * 4, [DARK, DARK, FREE, HIT], [DARK] * 4]
    assert second["translation"] == [[9.0, 3.0, 0.0]]
    poses = [row for row in rows[r"/world/sensors/laser\/1"] if "translation" in row]
    assert [row["translation"][0][:2] for row in poses] == [pytest.approx([10.2, 5.1]), pytest.approx([11.4, 5.1])]
    (walls,) = rows["/world/outlines"]  # once: they do not change
    (wall,) = walls["strips"]
    assert [corner[:2] for corner in wall] == [[8, 3], [9, 3], [9, 3.5], [8, 3]]
    at_first, later = rows["/world/objects"]
    assert at_first["labels"] == ["car 5"]
    corners = [[11, 4.5], [13, 4.5], [13, 5.5], [11, 5.5]]
    assert [corner[:2] for corner in at_first["strips"][0]] == [*corners, corners[0]]
    turned = [corner[:2] for corner in later["strips"][0]][:4]
    assert np.allclose(turned, [[12.5, 5.0], [12.5, 7.0], [11.5, 7.0], [11.5, 5.0]], atol=1e-6)


def test_the_file_is_named_after_the_stretch(drive, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    gridtrack("recording", "view", f"{drive}@1s-")
    (row,) = read(tmp_path / "drive@1s-.rrd")["/world/input"]
    assert row["time"].total_seconds() == 1.0


@pytest.fixture(scope="module")
def drawn_run(run_folder, tmp_path_factory):
    """The run with hand-drawn samples: of `good` two, of `fair` the first, of the others none."""
    run = shutil.copytree(run_folder, tmp_path_factory.mktemp("drawn") / "run")
    for samples in run.glob(f"*/{SAMPLES}"):
        samples.unlink()
    write_samples(run / "good@crossing" / SAMPLES)
    write_samples(run / "fair@crossing" / SAMPLES, seconds=(0,))
    return run


@pytest.fixture(scope="module")
def run_rows(drawn_run):
    done = gridtrack("report", drawn_run, "--rerun")
    path = drawn_run / "report" / "crossing.rrd"
    assert str(path) in done.stdout
    return read(path)


def test_a_run_has_input_observed_frame_truth_and_each_forecast(run_rows):
    first, second = run_rows["/world/input"]
    assert [row["stamp"].value - STAMP_NS for row in (first, second)] == [0, 1_000_000_000]
    assert cells(first) == [[FREE, HIT, DARK], [FREE, FREE, DARK], [DARK, DARK, DARK]]
    assert cells(run_rows[r"/world/observed/1\ s"][0]) == [[FREE, FREE, DARK], [HIT, FREE, DARK], [DARK, DARK, DARK]]
    # the hidden cell at the right of the second row is occupied; nothing is known of the highest row
    assert cells(run_rows[r"/world/truth/1\ s"][0]) == [[FREE, FREE, FREE], [HIT, FREE, HIT], [DARK, DARK, DARK]]
    forecast = run_rows[r"/world/forecast/good/1\ s"][0]
    assert cells(forecast) == [[0, 25, 0], [100, 50, 0], [0, 0, 20]]
    # the corner of the window is (-1, 2); in the world the window is turned by a quarter and moved by (10, -4)
    assert forecast["translation"][0] == pytest.approx([8.0, -5.0, 0.0])
    assert forecast["quaternion"][0] == pytest.approx([0, 0, math.sqrt(0.5), math.sqrt(0.5)])
    assert run_rows["/world/sensors"][0]["positions"][0][:2] == pytest.approx([9.5, -3.75])


def test_a_run_has_the_tracks_of_each_tracker(run_rows):
    first, second = run_rows["/world/tracks/good"]
    assert first["centers"][0][:2] == pytest.approx([7.5, -4.5])
    assert first["half_sizes"][0][:2] == pytest.approx([0.4, 0.2])
    x, y, z, w = first["quaternions"][0]
    assert (x, y, 2 * math.atan2(z, w)) == pytest.approx((0, 0, 0.5 + math.pi / 2))
    assert first["labels"] == ["7"]
    assert run_rows["/world/tracks/good/velocity"][0]["vectors"][0] == pytest.approx([0.8, 0.6, 0])
    assert second["centers"] == []


def test_a_tracker_that_kept_nothing_at_a_stamp_shows_nothing_there(run_rows):
    for entity in ("/world/forecast/fair", "/world/tracks/fair"):
        (cleared,) = [row for row in run_rows[entity] if row.get("is_recursive")]
        assert cleared["stamp"].value == STAMP_NS + 1_000_000_000
    assert not any(row.get("is_recursive") for row in run_rows["/world/tracks/good"])


def test_rows_are_chosen_by_their_labels(drawn_run, tmp_path):
    gridtrack("report", drawn_run, "--rerun", "--rows", "f*", "--out", tmp_path / "chosen")
    entities = read(tmp_path / "chosen" / "crossing.rrd")
    assert {name.split("/")[3] for name in entities if name.startswith("/world/tracks")} == {"fair"}


def test_a_damaged_file_of_forecasts_is_reported_and_the_rest_is_written(drawn_run, tmp_path):
    run = shutil.copytree(drawn_run, tmp_path / "run")
    damaged = run / "fair@crossing" / SAMPLES
    damaged.write_bytes(damaged.read_bytes()[:200])
    written, (notice,) = write_rerun_run(run)
    assert "fair has forecasts only of the frames before the damage" in notice
    assert "/world/tracks/fair" not in read(written[0])


def test_without_kept_forecasts_it_is_one_line(drawn_run, tmp_path):
    run = shutil.copytree(drawn_run, tmp_path / "run")
    for samples in run.glob(f"*/{SAMPLES}"):
        samples.unlink()
    with pytest.raises(ReportError, match=r"none of the trials has kept forecasts"):
        write_rerun_run(run)


def test_it_opens_no_connection_and_starts_no_process(drive, tmp_path):
    this = psutil.Process()
    before = len(this.net_connections()), len(this.children(recursive=True))
    gridtrack("recording", "view", drive, "--out", tmp_path / "drive.rrd")
    assert (len(this.net_connections()), len(this.children(recursive=True))) == before


@pytest.mark.parametrize(
    ("out", "says"),
    [("drive.rdd", "is written as .rrd"), ("nowhere/drive.rrd", "No such file or directory")],
)
def test_a_file_that_cannot_be_written_is_one_line(drive, tmp_path, out, says):
    with pytest.raises((ConfigurationError, OSError), match=says):
        gridtrack("recording", "view", drive, "--out", tmp_path / out)
    assert not list(tmp_path.glob("*.partial"))


def test_without_the_extra_the_error_names_it(drive, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(ConfigurationError, match=r"Rerun recordings need rerun-sdk: pip install 'gridtrack\[view\]'$"):
        gridtrack("recording", "view", drive, "--out", tmp_path / "drive.rrd")
    assert [path.name for path in tmp_path.iterdir()] == ["drive.mcap"]


def test_a_format_or_several_runs_are_refused(drawn_run):
    with pytest.raises(ConfigurationError, match="--rerun: forecasts have neither"):
        gridtrack("report", drawn_run, "--rerun", "--format", "csv")
    with pytest.raises(ConfigurationError, match="one run at a time"):
        gridtrack("report", drawn_run, drawn_run, "--rerun")


def test_a_hostile_label_is_one_part_of_a_path(drawn_run, tmp_path):
    label = "=_[*]<script>alert(1)</script> $x$ /** - world\x1b[31m".replace("/", "∕")

    def rename(summary):
        summary["trackers"][label] = summary["trackers"].pop("fair")

    run = edited(drawn_run, tmp_path / "run", rename)
    (run / "fair@crossing").rename(run / f"{label}@crossing")
    ((path,), _) = write_rerun_run(run)
    tracks = [name for name in read(path) if name.startswith("/world/tracks") and not name.endswith("/velocity")]
    assert len(tracks) == 2
    assert all(len(re.findall(r"(?<!\\)/", name)) == 3 for name in tracks)

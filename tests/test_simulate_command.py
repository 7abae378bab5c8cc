"""The command `gridtrack simulate`, without SUMO."""

import json
import subprocess
import sys

import pytest

from gridtrack.recordings import open_recording, packaged_recording

from scenes.command_line import gridtrack

LINES = "\n".join(f'0 {10 + f} 10 {30 + f} 30 {f} 0 0 0 "Pedestrian"' for f in range(90)) + "\n"


JUNCTION = ("simulate", "junction", "--minutes", "1", "--out", "a.tracks")


def test_the_check_prints_the_traffic_and_gives_every_file_as_json():
    paths = [str(packaged_recording(f"junction/{name}")) for name in ("test-104", "test-105")]
    shown = gridtrack("simulate", "check", paths[0]).stdout
    assert "1 minutes; longest standing time of a vehicle" in shown
    assert "fault" not in shown
    found = json.loads(gridtrack("simulate", "check", *paths, "--json").stdout)
    assert [one["tracks"] for one in found] == paths
    assert found[0]["faults"] == []
    assert {one["name"] for one in found[0]["classes"]} >= {"car", "pedestrian"}


@pytest.fixture
def annotations(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    path = tmp_path / "annotations.txt"
    path.write_text(LINES)
    return path


def simulate_tracks(source, out, *options, code=0):
    return gridtrack(
        "simulate", "tracks", "--format", "sdd", str(source), "--scale", "0.05", "--out", str(out), *options, code=code
    )


def test_annotated_tracks_become_a_recording_with_truth(annotations):
    out = annotations.with_name("walk.tracks")
    done = simulate_tracks(annotations, out, "--laser-at", "3,-5")
    assert "pedestrian: in 100.0% of frames, moving in 100.0%" in done.stdout
    shown = gridtrack("recording", "info", str(out)).stdout
    assert "classes: pedestrian, cyclist, car, bus" in shown
    assert "24 scans with truth" in shown
    assert open_recording(out).info.command == (
        "gridtrack simulate tracks --format sdd annotations.txt --out walk.tracks --scale 0.05 --site walk --rate 8.0"
        " --grid 100x0.2 --laser-at 3,-5 --seed 0"
    )


def test_a_road_user_on_the_laser_is_a_fault_with_exit_code_3(annotations):
    done = simulate_tracks(annotations, annotations.with_name("walk.tracks"), "--laser-at", "3,-1", code=3)
    assert "fault: pedestrian on the laser in" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("simulate", "junction", "--minutes", "1", "--out", "a.bag"), "a .tracks or .mcap file"),
        (("simulate", "junction", "--minutes", "nan", "--out", "a.tracks"), "nan minutes: expected more than 0"),
        ((*JUNCTION, "--start", "-3s"), "a start at -3 s: expected"),
        ((*JUNCTION, "--carrier", "car"), "--carrier car: only with --sensor drive"),
        ((*JUNCTION, "--odometry-noise", "1", "--sensor", "beside"), "--odometry-noise 1: only with --sensor drive"),
        ((*JUNCTION, "--odometry-noise", "-1", "--sensor", "drive"), "--odometry-noise -1: expected 0 to 10"),
        (("simulate", "check", "nowhere.tracks"), "nowhere.tracks"),
        (("simulate", "tracks", "a.txt", "--format", "kitti", "--scale", "1", "--out", "a.mcap"), "known is sdd"),
        (("simulate", "tracks", "a.txt", "--scale", "0", "--out", "a.mcap"), "--scale 0.0: it should be greater than"),
        (("simulate", "tracks", "a.txt", "--scale", "1", "--laser-at", "here", "--out", "a.mcap"), "--laser-at"),
    ],
)
def test_a_users_mistake_is_one_line_and_exit_code_2(arguments, says):
    done = gridtrack(*arguments, code=2)
    assert says in done.stderr
    assert done.stderr.startswith("gridtrack: ")
    assert done.stderr.count("\n") == 1


def test_worlds_without_jupedsim_name_the_extra(tmp_path):
    code = "import sys; sys.modules['shapely'] = None; from gridtrack.cli import main; main()"
    arguments = ("simulate", "worlds", "--out", str(tmp_path / "worlds"))
    done = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr == "gridtrack: simulating worlds needs JuPedSim: pip install 'gridtrack[sim]'\n"
    assert not (tmp_path / "worlds").exists()

"""Formats are found by the file, formats of other distributions only by name; a broken one stops no other."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from gridtrack.common.errors import PluginError, RecordingError
from gridtrack.recordings import CloudSlice, import_recording, open_recording
from gridtrack.recordings.opening import recordings_at
from gridtrack.recordings.stream import open_stream

Install = Callable[..., Path]

CSV_FORMAT = Path(__file__).parents[1] / "plugins" / "csv_scans.py"


@pytest.fixture
def csv_file(tmp_path: Path) -> Path:
    path = tmp_path / "walk.csv"
    path.write_text("scans\n1000,1.5,2.5\n2000,1.5,inf\n")
    return path


@pytest.fixture
def install_formats(install: Install) -> Callable[[dict[str, str]], None]:
    """Registers formats of the module `csv_scans` from the distribution `csv-scans`."""

    def install_formats(points: dict[str, str]) -> None:
        install("csv-scans", points, {CSV_FORMAT.name: CSV_FORMAT.read_text()}, group="gridtrack.recordings")

    yield install_formats
    sys.modules.pop("csv_scans", None)


def test_a_format_of_another_distribution_is_loaded_only_by_its_name(install_formats, csv_file: Path) -> None:
    install_formats({"csv": "csv_scans:FORMAT"})
    with pytest.raises(RecordingError, match=r"not a recording that gridtrack reads; formats: .*CARMEN log \(\.clf"):
        open_recording(csv_file)
    assert "csv_scans" not in sys.modules
    recording = open_recording(csv_file, format="csv")
    assert [scan.stamp_ns for scan in recording.scans()] == [1000, 2000]
    assert recording.overview().topics == {"csv": "CSV, 2"}
    assert recording.warnings == []
    assert recordings_at(csv_file.parent, "csv") == [csv_file]
    with pytest.raises(RecordingError, match=r"no such recording; did you mean 'walk\.csv'"):
        open_recording(csv_file.with_name("wakl.csv"), format="csv")


def test_an_import_keeps_the_name_of_the_format_in_its_command(install_formats, csv_file: Path, tmp_path: Path) -> None:
    install_formats({"csv": "csv_scans:FORMAT"})
    imported = import_recording(csv_file, tmp_path / "walk.mcap", format="csv")
    assert imported.info.command == "gridtrack recording import walk.csv --out walk.mcap --format csv"


def test_built_in_formats_are_found_beside_a_named_one(install_formats, csv_file: Path, write, scan) -> None:
    install_formats({"csv": "csv_scans:FORMAT"})
    assert len(list(open_recording(write([scan(0)]), format="csv").scans())) == 1


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("cvs", "no recording format 'cvs'; did you mean 'csv'"),
        ("absent", r"recording format 'absent' of csv-scans 1\.0 cannot be imported \(AttributeError"),
        ("a-type", r"recording format 'a-type' of csv-scans 1\.0: csv_scans:NO_FORMAT is not a"),
        ("missing", r"recording format 'missing' of csv-scans 1\.0 .*No module named 'no_such_module'"),
        ("Wrong", "'Wrong' is not a valid name"),
        ("carmen", r"recording format 'carmen' of .*: registered by two distributions, "),
    ],
)
def test_a_named_format_that_cannot_be_loaded_is_one_line_of_error(
    install_formats, csv_file: Path, name: str, message: str
) -> None:
    install_formats(
        {
            "absent": "csv_scans:ABSENT",
            "csv": "csv_scans:FORMAT",
            "missing": "no_such_module:FORMAT",
            "Wrong": "csv_scans:FORMAT",
            "a-type": "csv_scans:NO_FORMAT",
            "carmen": "csv_scans:FORMAT",
        }
    )
    with pytest.raises(PluginError, match=message):
        open_recording(csv_file, format=name)


def test_a_broken_format_stops_no_other_one(install_formats, csv_file: Path, write, scan, tmp_path: Path) -> None:
    """One that is not named is not loaded; one that has the name of a built-in one is reported, and neither is used."""
    install_formats({"buggy": "csv_scans:FORGETFUL", "missing": "no_such_module:FORMAT", "carmen": "csv_scans:FORMAT"})
    recording = open_recording(write([scan(0)]))
    assert len(list(recording.scans())) == 1
    (warning,) = recording.warnings
    assert re.search(r"recording format 'carmen' of .*: registered by two distributions, ", warning)
    assert "gridtrack " in warning
    assert "csv-scans 1.0" in warning
    recording = open_recording(write([scan(0)]), format="buggy")
    assert any("forgetful: its `recognises` failed" in line for line in recording.warnings)
    log = tmp_path / "a.clf"
    log.write_text("scans")
    with pytest.raises(RecordingError, match=r"not available: .*'carmen' of .*registered by two distributions"):
        open_recording(log)


def test_an_option_that_the_format_cannot_use_is_refused(install_formats, csv_file: Path) -> None:
    install_formats({"csv": "csv_scans:FORMAT", "unopenable": "csv_scans:UNOPENABLE"})
    with pytest.raises(RecordingError, match=r"--topic is for recordings with several topics; a CSV of scans"):
        open_recording(csv_file, format="csv", topic="front")
    with pytest.raises(RecordingError, match=r"--cloud-slice is for ROS recordings with point clouds"):
        open_recording(csv_file, format="csv", cloud_slice=CloudSlice(low_m=0.0, high_m=1.0))
    with pytest.raises(RecordingError, match=r"cannot be opened as unopenable \(ValueError: no header\)"):
        open_recording(csv_file, format="unopenable")


def test_a_format_loads_its_libraries_only_when_a_file_of_it_is_opened(tmp_path: Path, write, scan) -> None:
    """In three steps: the import, native and CARMEN recordings opened, a native one read as frames."""
    (tmp_path / "a.clf").write_text("# CARMEN\n")
    program = f"""
import json, sys
def loaded(*names):
    return [name for name in sys.modules if name.partition(".")[0] in names or name.startswith("gridtrack.simulation")]
from gridtrack.recordings import open_recording
assert not loaded("rosbags", "pyarrow", "numba"), loaded("rosbags", "pyarrow", "numba")
open_recording({str(write([scan(0)]))!r})
open_recording({str(tmp_path / "a.clf")!r})
assert not loaded("rosbags", "pyarrow", "numba"), loaded("rosbags", "pyarrow", "numba")
from gridtrack.recordings.stream import open_stream
list(open_stream({str(write([scan(0)]))!r}, rate_hz=10.0))
assert not loaded("rosbags", "pyarrow"), loaded("rosbags", "pyarrow")
"""
    done = subprocess.run([sys.executable, "-c", program], check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("folder", ["exp[1]", "a*b", "who?", "two words", "café"])
def test_a_path_is_never_read_as_a_pattern(folder: str, tmp_path: Path, write, scan) -> None:
    for place, scans in (("exp1", 9), ("aXb", 9), ("whom", 9), ("twowords", 9), (folder, 3)):
        (tmp_path / place).mkdir(exist_ok=True)
        write((scan(k) for k in range(scans)), f"{place}/rec [1]*?.mcap")
    path = tmp_path / folder / "rec [1]*?.mcap"
    assert len(list(open_recording(path).scans())) == 3
    imported = import_recording(path, tmp_path / folder / "out [2].mcap")
    assert len(list(imported.scans())) == 3
    assert len(open_stream(f"{path}@0s-0.15s")) == 2


def test_a_path_that_is_not_utf_8_is_one_error_line(write, scan, tmp_path: Path) -> None:
    path = write([scan(0)], "hall\udce9.mcap")
    with pytest.raises(RecordingError, match=r"hall\\xe9\.mcap: this path is not UTF-8, .* rename it") as error:
        open_recording(path)
    assert str(error.value).isprintable()
    with pytest.raises(RecordingError, match="this path is not UTF-8"):
        import_recording(write([scan(0)]), tmp_path / "\udce9.mcap")

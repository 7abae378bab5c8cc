"""CARMEN logs are read as scans with the pose of each line, damaged ones up to the damage."""

from __future__ import annotations

import bz2
import gzip
import math
from pathlib import Path

import numpy as np
import pytest

from gridtrack.common.errors import RecordingError
from gridtrack.common.geometry import SE2
from gridtrack.recordings import open_recording
from gridtrack.recordings.stream import open_stream

WALL = [f"{1 + 0.01 * beam:.2f}" for beam in range(180)]


def flaser(k: int, ranges: list[str], seconds: str | None = None) -> str:
    stamp = seconds or f"{100 + k}.250000"
    return f"FLASER {len(ranges)} {' '.join(ranges)} 1.5 {k} 0.5 9 9 9 {stamp} host {k}.0"


def robotlaser(k: int) -> str:
    ranges, remissions = "1.0 2.0 30.5 4.0", "7 8"
    return (
        f"ROBOTLASER1 0 -0.3 0.6 0.2 30.0 0.01 0 4 {ranges} 2 {remissions}"
        f" 1.5 {k} 0.5 9 9 9 0.1 0.2 0.3 0.4 1e6 {100 + k}.25 host {k}.0"
    )


def log(path: Path, *lines: str) -> Path:
    text = "\n".join(["# message_name [message contents]", "PARAM robot_use_laser on nohost 0", *lines, ""])
    packing = {".bz2": lambda content: bz2.compress(content, 1), ".gz": gzip.compress}.get(path.suffix.lower(), bytes)
    path.write_bytes(packing(text.encode("latin-1")))
    return path


@pytest.mark.parametrize("name", ["a.clf", "a.clf.bz2", "a.log.gz", "A.CLF", "A.Log.BZ2"])
def test_flaser_lines(name: str, tmp_path: Path) -> None:
    ranges = [f"{0.01 * (i + 1):.2f}" for i in range(179)] + ["81.83"]
    odometry = "ODOM 0 0 0 0 0 0 100.1 host 0.1"
    recording = open_recording(log(tmp_path / name, odometry, flaser(0, ranges), flaser(1, ranges)))
    first, second = recording.scans()
    assert (first.stamp_ns, second.stamp_ns) == (100_250_000_000, 101_250_000_000)
    assert second.world_T_sensor == SE2(1.5, 1.0, 0.5)
    assert (first.angle_min, first.angle_increment) == (-math.pi / 2, math.radians(1.0))
    np.testing.assert_array_equal(first.ranges, np.array(ranges, np.float32))
    assert first.ranges[-1] > first.range_max, "the value of the laser for no return is beyond its maximum"
    assert recording.survey.topics == {"PARAM": ("CARMEN", 1), "ODOM": ("CARMEN", 1), "FLASER": ("CARMEN", 2)}
    assert recording.info.site == name[0]


@pytest.mark.parametrize(
    ("beams", "first_deg", "step_deg"),
    [
        *[(180, -90, 1.0), (181, -90, 1.0), (360, -90, 0.5), (361, -90, 0.5), (400, -50, 0.25), (401, -50, 0.25)],
        *[(540, -135, 0.5), (541, -135, 0.5), (1080, -135, 0.25), (1081, -135, 0.25)],
    ],
)
def test_the_angles_follow_from_the_number_of_beams(
    beams: int, first_deg: float, step_deg: float, tmp_path: Path
) -> None:
    recording = open_recording(log(tmp_path / "a.clf", flaser(0, ["1.0"] * beams)), strict=True)
    (scan,) = recording.scans()
    assert math.degrees(scan.angle_min) == pytest.approx(first_deg)
    assert math.degrees(scan.angle_increment) == pytest.approx(step_deg)


def test_an_unknown_number_of_beams_is_a_warning(tmp_path: Path) -> None:
    recording = open_recording(log(tmp_path / "a.clf", *(flaser(k, WALL[:91]) for k in range(3))), strict=True)
    scan = next(iter(recording.scans()))
    assert math.degrees(scan.angle_min) == pytest.approx(-90)
    assert math.degrees(scan.angle_increment) == pytest.approx(2.0)
    (warning,) = recording.overview().warnings
    assert warning.endswith(
        "FLASER lines do not contain the angles of their beams, and no known laser has 91 beams: 180 deg are assumed,"
        " as in CARMEN; if that is wrong, use ROBOTLASER1 lines, which contain the angles"
    )


def test_robotlaser_lines_contain_their_angles(tmp_path: Path) -> None:
    (scan,) = open_recording(log(tmp_path / "a.clf", robotlaser(3))).scans()
    assert (scan.angle_min, scan.angle_increment, scan.range_max) == (-0.3, 0.2, 30.0)
    assert scan.ranges.tolist() == [1.0, 2.0, 30.5, 4.0]
    assert (scan.stamp_ns, scan.world_T_sensor) == (103_250_000_000, SE2(1.5, 3.0, 0.5))


def test_of_two_forms_of_the_same_scan_the_first_is_read(tmp_path: Path) -> None:
    lines = [line for k in range(3) for line in (robotlaser(k), flaser(k, ["1.0"] * 180))]
    path = log(tmp_path / "a.clf", *lines)
    recording = open_recording(path)
    assert [s.ranges.size for s in recording.scans()] == [4, 4, 4]
    assert len(recording.warnings) == 1
    assert "ROBOTLASER1 is read" in recording.warnings[0]
    assert [s.ranges.size for s in open_recording(path, topic="FLASER").scans()] == [180, 180, 180]


def test_stamps_are_exact_to_the_nanosecond(tmp_path: Path) -> None:
    (scan,) = open_recording(log(tmp_path / "a.clf", flaser(0, ["1"] * 180, "976052857.337284"))).scans()
    assert scan.stamp_ns == 976_052_857_337_284_000


@pytest.mark.parametrize(
    ("seconds", "stamp_ns"),
    [("1.1000000001e+09", 1_100_000_000_100_000_000), ("3.6e-05", 36_000), ("1.13486e+09", 1_134_860_000 * 10**9)],
)
def test_stamps_are_read_as_streams_write_them(seconds: str, stamp_ns: int, tmp_path: Path) -> None:
    (scan,) = open_recording(log(tmp_path / "a.clf", flaser(0, ["1"] * 180, seconds))).scans()
    assert scan.stamp_ns == stamp_ns


@pytest.mark.parametrize("seconds", ["nan", "inf", "-1.0", "1e999999999", "1e13", "far"])
def test_a_scan_with_a_stamp_that_is_no_time_is_left_out_and_the_log_goes_on(seconds: str, tmp_path: Path) -> None:
    """Public logs begin with negative stamps, or have one odd stamp in the middle."""
    path = log(tmp_path / "a.clf", *(flaser(k, ["1"] * 180, seconds if k in (0, 3) else "") for k in range(6)))
    recording = open_recording(path)
    assert [scan.world_T_sensor.y for scan in recording.scans()] == [1, 2, 4, 5]
    assert ["stamped outside 0 to 2^63 ns, left out: 2 of them" in line for line in recording.warnings] == [True]


def test_names_of_hosts_in_any_encoding_are_read(tmp_path: Path) -> None:
    path = log(tmp_path / "a.clf", "# \xe9", *(flaser(k, ["1"] * 180).replace("host", "\xe9") for k in range(3)))
    assert len(list(open_recording(path, strict=True).scans())) == 3


@pytest.mark.parametrize("line", ["FLASER 180 1.0 2.0", "FLASER x", "FLASER", flaser(0, ["1.0"] * 179 + ["far"])])
def test_a_warning_gives_the_number_of_an_invalid_line(line: str, tmp_path: Path) -> None:
    path = log(tmp_path / "a.clf", flaser(0, ["1.0"] * 180), line, flaser(2, ["1.0"] * 180))
    recording = open_recording(path)
    assert len(list(recording.scans())) == 1
    assert len(recording.warnings) == 1
    assert "line 4: not a readable FLASER" in recording.warnings[0]
    with pytest.raises(RecordingError, match="line 4"):
        list(open_recording(path, strict=True).scans())


def test_a_cut_archive_gives_the_lines_before_the_cut(tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    lines = [flaser(k, [f"{r:.2f}" for r in random.uniform(0, 80, 180)]) for k in range(600)]
    path = log(tmp_path / "a.clf.bz2", *lines)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) * 3 // 4])
    recording = open_recording(path)
    found = [s.stamp_ns for s in recording.scans()]
    assert found == [(100 + k) * 10**9 + 250_000_000 for k in range(len(found))]
    assert 60 < len(found) < 600
    assert len(recording.warnings) == 1


def test_the_error_for_a_wrong_topic_suggests_another(tmp_path: Path) -> None:
    path = log(tmp_path / "a.clf", flaser(0, ["1.0"] * 180))
    with pytest.raises(RecordingError, match="no topic 'FLASR'; did you mean 'FLASER'"):
        list(open_recording(path, topic="FLASR").scans())
    with pytest.raises(RecordingError, match="'PARAM' is CARMEN, not scans; topics with scans: FLASER"):
        list(open_recording(path, topic="PARAM").scans())


def test_many_equal_stamps_name_the_way_on(tmp_path: Path) -> None:
    path = log(tmp_path / "a.clf", *(flaser(k, WALL, "1.13486e+09") for k in range(20)))
    (warning,) = open_recording(path).overview().warnings
    assert (
        "95% of the stamps are alike or in disorder: give the rate of the laser, as in `gridtrack recording" in warning
    )
    assert "--out a-stamped.mcap --stamps 10hz`, or take the logger's times with --stamps received" in warning
    with pytest.raises(RecordingError, match="a single scan has no rate: scans of sensor 'scan' not stamped after"):
        open_stream(path)
    alike = (flaser(k, WALL, "1.13486e+09").rpartition(" ")[0] + " 1.13486e+09" for k in range(20))
    (warning,) = open_recording(log(tmp_path / "b.clf", *alike)).overview().warnings
    assert warning.endswith("--stamps 10hz`")
    assert [s.stamp_ns for s in open_recording(path, stamps="10hz").scans()] == [k * 10**8 for k in range(20)]
    assert [s.stamp_ns for s in open_recording(path, stamps="received").scans()] == [k * 10**9 for k in range(20)]

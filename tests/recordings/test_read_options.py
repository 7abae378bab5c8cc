"""Options of reading: mounts from text, and the meaning of ranges: codes for no return, limits."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gridtrack.common.errors import ConfigurationError, NothingMeasuredError
from gridtrack.evaluation.referee.splits import Sampling, plan_split
from gridtrack.recordings import import_recording, open_recording
from gridtrack.recordings.read_options import Mount, parse_mount
from gridtrack.recordings.stream import open_stream


@pytest.mark.parametrize(
    ("text", "heading_rad"), [("45deg", math.pi / 4), ("0.5rad", 0.5), ("0", 0.0), ("270deg", -math.pi / 2)]
)
def test_a_mount_is_metres_and_an_angle_with_its_unit(text: str, heading_rad: float) -> None:
    mount = parse_mount(f"front_laser=0.4,-0.2,{text}")
    assert mount == Mount(sensor="front_laser", x=0.4, y=-0.2, heading_rad=mount.heading_rad)
    assert mount.heading_rad == pytest.approx(heading_rad)


def test_a_mount_may_name_its_parent_and_be_mirrored() -> None:
    mount = parse_mount("rear/scan=base_link:-0.4,0,180deg,mirrored")
    assert (mount.sensor, mount.parent, mount.x, mount.mirrored) == ("rear/scan", "base_link", -0.4, True)
    assert abs(mount.heading_rad) == pytest.approx(math.pi)
    assert str(mount) == "rear/scan=base_link:-0.4,0,180deg,mirrored"
    assert parse_mount(str(mount)) == mount


@pytest.mark.parametrize(
    "text",
    ["", "a", "a=", "=1,2,3deg", "a=1,2", "a=1,2,3", "a=1,2,3deg,upside", "a=nan,0,0deg", "a=0,nan,0deg",
     "a=1,inf,0deg", "a=1,2,3deg,mirrored,mirrored", "a=1e12,0,0deg", "a=1,2,nandeg"],
)  # fmt: skip
def test_an_invalid_mount_is_one_line_of_error(text: str) -> None:
    with pytest.raises(ConfigurationError, match="--mount"):
        parse_mount(text)


@pytest.mark.parametrize(
    ("ranges", "limits", "why"),
    [
        ([np.inf], (0.1, 10.0), "all are inf; the laser was covered or switched off, or its driver failed"),
        ([np.nan, 0.0], (0.1, 10.0), "all are 0.0 or NaN; the laser was"),
        ([523.0, 9800.0], (0.1, 10.0), "(0.1 to 10): they are 523 to 9800; the ranges are probably millimetres: conv"),
        ([52.0, 980.0], (0.1, 10.0), "they are 52 to 980; the ranges are probably centimetres"),
        ([0.5, 9.8], (100.0, 10_000.0), "the limits are probably millimetres: import the recording with --range-limi"),
        ([0.5, 0.7], (1.0, 9.0), "they are 0.5 to 0.7; give the limits of the laser with --range-limits"),
        ([3.0], (0.1, 10.0), "every return is at 3 m: the driver writes a constant"),
        ([3.0, np.inf], (0.1, 10.0), "every return is at 3 m"),
        ([3.0, 3.5], (0.1, 10.0), ""),
    ],
)
def test_ranges_that_measure_nothing_say_why_in_info_and_are_refused_with_exit_code_3(
    write, scan, ranges: list[float], limits: tuple[float, float], why: str
) -> None:
    low_m, high_m = limits
    content = np.resize(np.float32(ranges), 36)
    path = write(replace(scan(k), ranges=content, range_min=low_m, range_max=high_m) for k in range(80))
    warnings = open_recording(path).overview().warnings
    if not why:
        plan_split(str(path), None, Sampling(1.0, 1.0))
        assert warnings == ()
        return
    assert [why in line for line in warnings] == [True]
    with pytest.raises(NothingMeasuredError, match=r"made\.mcap: (nothing is occupied|every return)") as refused:
        plan_split(str(path), None, Sampling(1.0, 1.0))
    assert (why in str(refused.value), refused.value.exit_code) == (True, 3)


def ranges_with(value: float, share: float) -> np.ndarray:
    ranges = np.linspace(1.5, 2.0, 100, dtype=np.float32)
    ranges[: round(share * 100)] = value
    return ranges


@pytest.fixture
def recording_with(write, scan) -> Callable[..., Path]:
    """Writes 80 scans in which a share of the ranges has one value."""

    def record(value: float, share: float, **changes: object) -> Path:
        ranges = ranges_with(value, share)
        return write(replace(scan(k), ranges=ranges, angle_increment=0.03, **changes) for k in range(80))

    return record


@pytest.mark.parametrize(
    ("value", "share", "changes", "warning"),
    [
        (np.nan, 0.2, {}, None),
        (np.nan, 0.21, {}, "21.0% of the ranges are invalid (NaN or below range_min): nothing is known"),
        (np.nan, 0.21, {}, "Where the driver writes NaN for no return, import the recording with --no-return nan"),
        (-np.inf, 0.5, {}, "50.0% of the ranges are invalid"),
        (np.inf, 0.9, {}, None),
        (0.0, 0.2, {}, None),
        (0.0, 0.43, {}, "43.0% of the ranges are invalid (NaN or below range_min) and 43.0% exactly 0.0"),
        (0.0, 0.43, {"range_min": 0.0}, "writes 0.0 for no return, import the recording with --no-return zero"),
        (30.0, 0.05, {}, None),
        (30.0, 0.06, {}, "6.0% of the ranges are 30 m, its maximum, or up to 5 cm less: walls at that distance"),
        (29.96, 0.97, {}, "Where the driver writes this for no return, import the recording with --no-return max"),
        (29.9, 0.97, {}, None),
        (30.1, 0.97, {}, None),
    ],
)
def test_many_ranges_that_may_be_no_return_are_a_warning(recording_with, value, share, changes, warning) -> None:
    path = recording_with(value, share, range_max=30.0, **changes)
    shown, compared = open_recording(path).overview().warnings, open_stream(path).recording.warnings
    split = plan_split(str(path), None, Sampling(horizon_s=1.0, every_s=0.5))
    assert list(shown) == compared == [f"{path}: {notice.text}" for notice in split.notices[: len(compared)]]
    assert len(shown) == (warning is not None)
    assert all(str(warning) in line for line in shown)


@pytest.mark.parametrize(
    ("codes", "value"), [("zero", 0.0), ("nan", np.nan), ("max", 10.0), ("max", 9.96), ("max,zero,nan", 0.0)]
)
def test_codes_for_no_return_are_infinite_in_reading_and_import(recording_with, tmp_path, codes, value) -> None:
    path = recording_with(value, 0.43, range_max=10.0)
    read = open_recording(path, no_return=codes)
    imported = import_recording(path, tmp_path / "out.mcap", no_return=codes.split(","))
    for recording in (read, imported):
        np.testing.assert_array_equal(next(recording.scans()).ranges, ranges_with(np.inf, 0.43))
        assert recording.overview().sensors["scan"].no_return_share > 0.4
        assert recording.warnings == []
    assert f"--no-return {codes}" in imported.info.command


def test_codes_stay_without_the_option_and_an_unknown_one_is_refused(recording_with, tmp_path: Path) -> None:
    path = recording_with(0.0, 0.43, range_min=0.0)
    (scan, *_) = import_recording(path, tmp_path / "out.mcap").scans()
    assert (scan.ranges == 0.0).sum() == 43
    assert scan.range_min > 0.0, "0.0 is never a return"
    with pytest.raises(ConfigurationError, match=r"'no_return\.0' = 'maybe': Input should be 'max', 'zero' or 'nan'"):
        open_recording(path, no_return="maybe")


def test_the_options_hold_for_every_format(tmp_path: Path) -> None:
    log = tmp_path / "a.clf"
    log.write_text("".join(f"FLASER 180 {'0.0 2.0 3.0 ' * 60} 0 0 0 0 0 0 {k}.5 host 0.0\n" for k in range(5)))
    (warning,) = open_recording(log).overview().warnings
    assert "--no-return zero" in warning
    assert open_recording(log, no_return="zero").overview().warnings == ()
    (scan, *_) = open_recording(log, range_limits="0.1,2.5", angles="-45deg,45deg").scans()
    assert (scan.range_min, scan.range_max, scan.angle_min) == (0.1, 2.5, -math.pi / 4)
    assert scan.angle_increment == pytest.approx(math.pi / 2 / 179)


@pytest.mark.parametrize(
    ("option", "text"),
    [
        *(("range_limits", text) for text in ("", "1", "2,1", "nan,3", "-1,3", "0.1,2e6", "1,1")),
        *(("angles", text) for text in ("", "1deg", "1,2", "1deg,1deg", "0deg,800deg", "nandeg,3deg")),
    ],
)
def test_invalid_limits_and_angles_are_one_line_of_error(recording_with, option: str, text: str) -> None:
    with pytest.raises(ConfigurationError, match=f"--{option.replace('_', '-')} {text}: expected "):
        open_recording(recording_with(1.0, 0.1), **{option: text})

"""Options of reading: mounts from text, and the meaning of ranges of exactly 0.0."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gridtrack.common.errors import ConfigurationError
from gridtrack.evaluation.referee.splits import Sampling, plan_split
from gridtrack.recordings import import_recording, open_recording
from gridtrack.recordings.read_options import Mount, parse_mount
from gridtrack.recordings.stream import open_stream

HINT = "exactly 0.0: where the driver writes 0.0 for no return, import the recording with --zero-range free"


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
    with pytest.raises(ConfigurationError, match="--mount") as error:
        parse_mount(text)
    assert "\n" not in str(error.value)


def ranges_with(value: float, share: float) -> np.ndarray:
    ranges = np.full(100, 2.0, np.float32)
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
        (np.nan, 0.21, {}, "21.0% of the ranges are invalid (NaN or below range_min)"),
        (-np.inf, 0.5, {}, "50.0% of the ranges are invalid"),
        (np.inf, 0.9, {}, None),
        (0.0, 0.2, {}, None),
        (0.0, 0.43, {}, "43.0% of the ranges are invalid (NaN or below range_min) and 43.0% exactly 0.0"),
        (0.0, 0.43, {"range_min": 0.0}, f"0.0% of the ranges are invalid (NaN or below range_min) and 43.0% {HINT}"),
    ],
)
def test_more_than_a_fifth_of_invalid_ranges_is_a_warning(recording_with, value, share, changes, warning) -> None:
    path = recording_with(value, share, **changes)
    shown, compared = open_recording(path).overview().warnings, open_stream(path).recording.warnings
    split = plan_split(str(path), None, Sampling(horizon_s=1.0, every_s=0.5))
    assert list(shown) == compared == list(split.notices[: len(compared)])
    assert len(shown) == (warning is not None)
    assert all(str(warning) in line for line in shown)
    assert all((HINT in line) == (value == 0.0) for line in shown)


@pytest.mark.parametrize("range_min", [0.0, 0.05])
@pytest.mark.parametrize(("meaning", "value"), [("free", np.inf), ("unknown", np.nan)])
def test_zero_ranges_are_replaced_in_reading_and_import(recording_with, tmp_path, meaning, value, range_min) -> None:
    path = recording_with(0.0, 0.43, range_min=range_min)
    read = open_recording(path, zero_range=meaning)
    imported = import_recording(path, tmp_path / "out.mcap", zero_range=meaning)
    for recording in (read, imported):
        np.testing.assert_array_equal(next(recording.scans()).ranges, ranges_with(value, 0.43))
        sensor = recording.overview().sensors["scan"]
        assert (sensor.zero_share, sensor.no_return_share > 0.4) == (0.0, meaning == "free")
        assert not any("exactly 0.0" in line for line in recording.warnings)
    assert f"--zero-range {meaning}" in imported.info.command


def test_zero_ranges_stay_without_the_option_and_an_unknown_meaning_is_refused(recording_with, tmp_path: Path) -> None:
    path = recording_with(0.0, 0.43)
    assert (next(import_recording(path, tmp_path / "out.mcap").scans()).ranges == 0.0).sum() == 43
    with pytest.raises(ConfigurationError, match="'zero_range' = 'maybe': Input should be 'free' or 'unknown'"):
        open_recording(path, zero_range="maybe")


def test_the_option_holds_for_every_format(tmp_path: Path) -> None:
    log = tmp_path / "a.clf"
    log.write_text("".join(f"FLASER 180 {'0.0 2.0 3.0 ' * 60} 0 0 0 0 0 0 {k}.5 host 0.0\n" for k in range(5)))
    (warning,) = open_recording(log).overview().warnings
    assert HINT in warning
    assert open_recording(log, zero_range="free").overview().warnings == ()

"""Many invalid ranges are a warning, and ranges of exactly 0.0 have the meaning that an option gives them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gridtrack.common.errors import ConfigurationError
from gridtrack.common.scan import Scan
from gridtrack.evaluation.referee.splits import Sampling, plan_split
from gridtrack.recordings import import_recording, open_recording
from gridtrack.recordings.stream import open_stream

HINT = "exactly 0.0: where the driver writes 0.0 for no return, import the recording with --zero-range free"


def ranges_with(value: float, share: float, beams: int = 100) -> np.ndarray:
    ranges = np.full(beams, 2.0, np.float32)
    ranges[: round(share * beams)] = value
    return ranges


@pytest.fixture
def recording_with(write: Callable[..., Path], scan: Callable[..., Scan]) -> Callable[..., Path]:
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
def test_more_than_a_fifth_of_invalid_ranges_is_a_warning(
    recording_with: Callable[..., Path], value: float, share: float, changes: dict[str, object], warning: str | None
) -> None:
    path = recording_with(value, share, **changes)
    shown, compared = open_recording(path).overview().warnings, open_stream(path).recording.warnings
    split = plan_split(str(path), None, Sampling(horizon_s=1.0, every_s=0.5))
    assert list(shown) == compared == list(split.notices[: len(compared)])
    assert len(shown) == (warning is not None)
    assert all(str(warning) in line for line in shown)
    assert all((HINT in line) == (value == 0.0) for line in shown)


@pytest.mark.parametrize("range_min", [0.0, 0.05])
@pytest.mark.parametrize(("meaning", "value"), [("free", np.inf), ("unknown", np.nan)])
def test_zero_ranges_are_replaced_on_reading_and_by_an_import(
    recording_with: Callable[..., Path], tmp_path: Path, meaning: str, value: float, range_min: float
) -> None:
    path = recording_with(0.0, 0.43, range_min=range_min)
    read = open_recording(path, zero_range=meaning)
    imported = import_recording(path, tmp_path / "out.mcap", zero_range=meaning)
    for recording in (read, imported):
        np.testing.assert_array_equal(next(recording.scans()).ranges, ranges_with(value, 0.43))
        sensor = recording.overview().sensors["scan"]
        assert (sensor.zero_share, sensor.no_return_share > 0.4) == (0.0, meaning == "free")
        assert not any("exactly 0.0" in line for line in recording.warnings)
    assert f"--zero-range {meaning}" in imported.info.command


def test_zero_ranges_stay_without_the_option_and_an_unknown_meaning_is_refused(
    recording_with: Callable[..., Path], tmp_path: Path
) -> None:
    path = recording_with(0.0, 0.43)
    assert (next(import_recording(path, tmp_path / "out.mcap").scans()).ranges == 0.0).sum() == 43
    with pytest.raises(ConfigurationError, match="'zero_range' = 'maybe': Input should be 'free' or 'unknown'"):
        open_recording(path, zero_range="maybe")


def test_zero_ranges_of_a_carmen_log(tmp_path: Path) -> None:
    log = tmp_path / "a.clf"
    ranges = "0.0 2.0 3.0 " * 60
    log.write_text("".join(f"FLASER 180 {ranges} 0 0 0 0 0 0 {k}.5 host 0.0\n" for k in range(5)))
    (warning,) = open_recording(log).overview().warnings
    assert HINT in warning
    assert open_recording(log, zero_range="free").overview().warnings == ()

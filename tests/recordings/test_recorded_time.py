"""The time that a stretch covers is known under every name, cut and format of its recording."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from gridtrack.common.scan import Scan
from gridtrack.recordings import import_recording
from gridtrack.recordings.stream import open_stream
from gridtrack.recordings.stretches import WALL_CLOCK_FROM_NS, RecordedTime

DAY_NS = 86_400 * 1_000_000_000


def recorded(path: Path, stretch: str = "") -> RecordedTime:
    return open_stream(f"{path}{stretch}", rate_hz=10.0).recorded


def log_of(path: Path, first_s: int, count: int) -> Path:
    """A CARMEN log of one scan a second, whose clock starts at 0."""
    seconds = range(first_s, first_s + count)
    path.write_text("".join(f"FLASER 3 1.0 2.0 {k % 7}.5 0 0 0 0 0 0 {k}.0 host {k}.0\n" for k in seconds))
    return path


def test_an_import_of_an_import_has_the_time_of_its_first_source(tmp_path: Path) -> None:
    log = log_of(tmp_path / "a.clf", 0, 20)
    once = import_recording(log, tmp_path / "b.mcap", site="hall", stretches={"train": (0.0, 10.0)})
    twice = import_recording(once.path, tmp_path / "c.mcap", credit="another name")
    assert len({once.sha256, twice.sha256, recorded(log).source_sha256}) == 3
    assert recorded(twice.path).source_sha256 == recorded(once.path).source_sha256 == recorded(log).source_sha256
    assert twice.info.source == "a.clf"
    assert recorded(log, "@5s-8s").overlaps(recorded(twice.path, "@train"))
    assert not recorded(log, "@10s-").overlaps(recorded(twice.path, "@train"))


def test_a_file_that_another_program_cut_overlaps_where_its_stamps_are_times_of_the_day(
    write: Callable[..., Path], scan: Callable[..., Scan]
) -> None:
    whole, cut = write(map(scan, range(100)), "whole.mcap"), write(map(scan, range(40, 60)), "cut.mcap")
    assert recorded(whole).overlaps(recorded(cut))
    assert recorded(whole, "@5s-").overlaps(recorded(cut))
    assert not recorded(whole, "@6s-").overlaps(recorded(cut))
    elsewhere = write(map(scan, range(100)), "elsewhere.mcap", site="elsewhere")
    assert not recorded(elsewhere).overlaps(recorded(cut))


@pytest.mark.parametrize(("start_ns", "expected"), [(0, False), (WALL_CLOCK_FROM_NS + DAY_NS, True)])
def test_equal_stamps_of_two_sources_tell_nothing_where_a_clock_starts_at_zero(start_ns: int, expected: bool) -> None:
    one, other = (RecordedTime(name, "junction", start_ns, start_ns + 1000) for name in ("seed 1", "seed 2"))
    assert one.overlaps(other) is expected

"""A damaged file gives everything before the damage and one warning, or with strict an error; never anything else."""

from __future__ import annotations

import contextlib
import struct
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gridtrack.common.errors import GridtrackError, RecordingError
from gridtrack.common.scan import Scan
from gridtrack.recordings import RecordingInfo, open_recording, write_native
from gridtrack.recordings.mcap_file import MCAP_MAGIC

SCANS = 600


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of several chunks."""
    random = np.random.default_rng(0)
    path = tmp_path_factory.mktemp("whole") / "whole.mcap"
    with path.open("wb") as file:
        ranges = random.uniform(0.1, 5.0, (SCANS, 90)).astype(np.float32)
        scans = (Scan(k * 10**8, r, -1.0, 0.02, 0.05, 5.0) for k, r in enumerate(ranges))
        write_native(file, RecordingInfo(site="here"), scans)
    return path


def read(path: Path, content: bytes) -> tuple[list[int], list[str]]:
    path.write_bytes(content)
    recording = open_recording(path)
    return [scan.stamp_ns // 10**8 for scan in recording.scans()], recording.warnings


def test_a_cut_file_gives_all_scans_before_the_cut_chunk(whole: Path, tmp_path: Path) -> None:
    content = whole.read_bytes()
    numbers, warnings = read(tmp_path / "cut.mcap", content[: len(content) * 2 // 3])
    assert numbers == list(range(len(numbers)))
    assert len(numbers) > SCANS // 3
    assert len(warnings) == 1
    assert "cut off" in warnings[0]
    with pytest.raises(RecordingError, match=r"cut\.mcap: cut off"):
        list(open_recording(tmp_path / "cut.mcap", strict=True).scans())


def test_the_scans_of_a_killed_writer_can_be_read(whole: Path, tmp_path: Path) -> None:
    content = whole.read_bytes()
    numbers, warnings = read(tmp_path / "killed.mcap", content[: content.rindex(b"\x0f\x04\0\0\0\0\0\0\0")])
    assert numbers == list(range(SCANS))
    assert len(warnings) == 1
    assert "the end of the data is missing" in warnings[0]


def test_a_flipped_bit_is_noticed(whole: Path, tmp_path: Path) -> None:
    content = bytearray(whole.read_bytes())
    content[len(content) // 2] ^= 0x10
    numbers, warnings = read(tmp_path / "flipped.mcap", bytes(content))
    assert numbers == list(range(len(numbers)))
    assert 0 < len(numbers) < SCANS
    assert len(warnings) == 1


def test_a_record_that_is_too_large_is_refused_before_memory_is_allocated(whole: Path, tmp_path: Path) -> None:
    content = whole.read_bytes()
    header_size = struct.unpack_from("<Q", content, len(MCAP_MAGIC) + 1)[0]
    at = len(MCAP_MAGIC) + 9 + header_size
    (metadata_size,) = struct.unpack_from("<Q", content, at + 1)
    absurd = content[: at + 9 + metadata_size] + struct.pack("<BQ", 6, 1 << 50)
    tracemalloc.start()
    with pytest.raises(RecordingError, match=f"a record of {1 << 50} bytes"):
        read(tmp_path / "absurd.mcap", absurd)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 10_000_000


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_random_damage_gives_no_wrong_scan_and_only_our_errors(
    whole: Path, tmp_path: Path, data: st.DataObject
) -> None:
    content = bytearray(whole.read_bytes())
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.one_of(st.integers(0, len(content) - 1), st.integers(0, 4000)))
        content[at] = data.draw(st.integers(0, 255))
    content = content[: data.draw(st.integers(1, len(content)))]
    numbers: list[int] = []
    with contextlib.suppress(GridtrackError):
        numbers, _ = read(tmp_path / "damaged.mcap", bytes(content))
    assert numbers == list(range(len(numbers)))


def test_memory_does_not_grow_with_the_length(tmp_path: Path, write) -> None:
    def peak_of(scans: int) -> int:
        ranges = np.random.default_rng(0).uniform(0.1, 5.0, 360).astype(np.float32)
        path = write((Scan(k * 10**8, ranges, -1.0, 0.01, 0.05, 5.0) for k in range(scans)), f"{scans}.mcap")
        tracemalloc.start()
        for _ in open_recording(path).scans():
            pass
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return peak

    assert peak_of(4000) < 1.3 * peak_of(400)

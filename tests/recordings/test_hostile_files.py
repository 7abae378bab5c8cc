"""Damaged, cut and hostile files: the scans before the fault and one line, in bounded memory and time."""

from __future__ import annotations

import bz2
import contextlib
import struct
import tracemalloc
import zlib
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gridtrack.common.errors import GridtrackError, RecordingError
from gridtrack.common.scan import Scan
from gridtrack.recordings import RecordingInfo, file_reading, open_recording, write_native
from gridtrack.recordings.file_reading import FREE_RECORDS, NOT_A_RECORDING
from gridtrack.recordings.mcap_file import MCAP_MAGIC
from gridtrack.recordings.native_messages import METADATA_NAME, NATIVE_SCHEMA

from scenes.drive_bag import FRONT, Ros, mounts, scans_of

SCANS = 600
LINE = "FLASER 4 1 1 1 1 0 0 0 0 0 0 {} host 0\n"
NO_RECORDING = NOT_A_RECORDING.partition(":")[0]
MIB = 1 << 20


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A native recording of several chunks."""
    path = tmp_path_factory.mktemp("whole") / "whole.mcap"
    with path.open("wb") as file:
        ranges = np.random.default_rng(0).uniform(0.1, 5.0, (SCANS, 90)).astype(np.float32)
        scans = (Scan(k * 10**8, r, -1.0, 0.02, 0.05, 5.0) for k, r in enumerate(ranges))
        write_native(file, RecordingInfo(site="here"), scans)
    return path.read_bytes()


def read(path: Path, content: bytes) -> tuple[list[int], list[str]]:
    """The numbers of the scans, and the warnings."""
    path.write_bytes(content)
    recording = open_recording(path)
    return [scan.stamp_ns // 10**8 for scan in recording.scans()], recording.warnings


@pytest.fixture
def free_mib(monkeypatch: pytest.MonkeyPatch) -> Callable[[int], None]:
    """Reduces the free amount of unpacked bytes, so that small bombs are large enough."""
    return lambda mib: monkeypatch.setattr(file_reading, "FREE_BYTES", mib * MIB)


def peak_of(work: Callable[[], object]) -> int:
    """The peak of the memory that Python allocates, bytes."""
    tracemalloc.start()
    work()
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return peak


def refusal(path: Path) -> str:
    """The error of a file without a usable scan."""
    with pytest.raises(RecordingError) as refused:
        list(open_recording(path).scans())
    return str(refused.value)


# ---- damage


def test_a_cut_file_gives_all_scans_before_the_cut_chunk(whole: bytes, tmp_path: Path) -> None:
    numbers, (warning,) = read(tmp_path / "cut.mcap", whole[: len(whole) * 2 // 3])
    assert numbers == list(range(len(numbers)))
    assert len(numbers) > SCANS // 3
    assert "cut off" in warning
    with pytest.raises(RecordingError, match=r"cut\.mcap: cut off"):
        list(open_recording(tmp_path / "cut.mcap", strict=True).scans())


def test_the_scans_of_a_killed_writer_can_be_read(whole: bytes, tmp_path: Path) -> None:
    numbers, (warning,) = read(tmp_path / "killed.mcap", whole[: whole.rindex(b"\x0f\x04\0\0\0\0\0\0\0")])
    assert numbers == list(range(SCANS))
    assert "the end of the data is missing" in warning


def test_a_flipped_bit_is_noticed(whole: bytes, tmp_path: Path) -> None:
    content = bytearray(whole)
    content[len(content) // 2] ^= 0x10
    numbers, (_,) = read(tmp_path / "flipped.mcap", bytes(content))
    assert numbers == list(range(len(numbers)))
    assert 0 < len(numbers) < SCANS


def test_a_record_that_is_too_large_is_refused_before_memory_is_allocated(whole: bytes, tmp_path: Path) -> None:
    (header_size,) = struct.unpack_from("<Q", whole, len(MCAP_MAGIC) + 1)
    at = len(MCAP_MAGIC) + 9 + header_size
    (metadata_size,) = struct.unpack_from("<Q", whole, at + 1)
    absurd = whole[: at + 9 + metadata_size] + struct.pack("<BQ", 6, 1 << 50)

    def refused() -> None:
        with pytest.raises(RecordingError, match=f"a record of {1 << 50} bytes"):
            read(tmp_path / "absurd.mcap", absurd)

    assert peak_of(refused) < 10_000_000


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_random_damage_gives_no_wrong_scan_and_only_our_errors(whole: bytes, tmp_path: Path, data) -> None:
    content = bytearray(whole)
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.one_of(st.integers(0, len(content) - 1), st.integers(0, 4000)))
        content[at] = data.draw(st.integers(0, 255))
    content = content[: data.draw(st.integers(1, len(content)))]
    numbers: list[int] = []
    with contextlib.suppress(GridtrackError):
        numbers, _ = read(tmp_path / "damaged.mcap", bytes(content))
    assert numbers == list(range(len(numbers)))


def test_memory_does_not_grow_with_the_length(write) -> None:
    def peak_for(scans: int) -> int:
        ranges = np.random.default_rng(0).uniform(0.1, 5.0, 360).astype(np.float32)
        path = write((Scan(k * 10**8, ranges, -1.0, 0.01, 0.05, 5.0) for k in range(scans)), f"{scans}.mcap")
        return peak_of(lambda: [None for _ in open_recording(path).scans()])

    assert peak_for(2000) < 1.3 * peak_for(400)


# ---- files that unpack to far more than they are


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def text(value: str | bytes) -> bytes:
    content = value.encode() if isinstance(value, str) else value
    return struct.pack("<I", len(content)) + content


def mcap(path: Path, content: bytes, compression: str) -> Path:
    """A native recording of one chunk, with valid checksums."""
    pairs = text("schema") + text(NATIVE_SCHEMA) + text("info") + text('{"site": "here"}')
    metadata = record(12, text(METADATA_NAME) + text(pairs))
    schema = record(3, struct.pack("<H", 1) + text("other") + text("protobuf") + text(b""))
    channel = record(4, struct.pack("<HH", 1, 1) + text("/other") + text("protobuf") + text(b""))
    content = schema + channel + content
    packed = zstandard.compress(content, 19) if compression == "zstd" else lz4.frame.compress(content)
    head = struct.pack("<QQQI", 0, 1, len(content), zlib.crc32(content)) + text(compression)
    path.write_bytes(MCAP_MAGIC + metadata + record(6, head + struct.pack("<Q", len(packed)) + packed))
    return path


def test_millions_of_empty_messages_are_refused(tmp_path: Path) -> None:
    messages = record(5, struct.pack("<HIQQ", 1, 0, 0, 0)) * (FREE_RECORDS + 50_000)
    path = mcap(tmp_path / "a.mcap", messages, "zstd")
    assert path.stat().st_size < 100_000
    assert f"records; {NO_RECORDING}" in refusal(path)


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_an_mcap_chunk_is_refused_before_it_is_unpacked(tmp_path: Path, free_mib, compression: str) -> None:
    free_mib(16)
    path = mcap(tmp_path / "a.mcap", record(200, bytes(40 * MIB)), compression)
    assert path.stat().st_size < 200_000
    assert peak_of(lambda: refusal(path)) < 16 * MIB
    assert f"MiB; {NO_RECORDING}" in refusal(path)


@pytest.mark.parametrize(("line", "count"), [("\n", FREE_RECORDS + 200_000), ("# " + "0" * 100_000 + "\n", 60)])
def test_a_carmen_log_gives_the_scans_before_the_bomb(line: str, count: int, tmp_path: Path, free_mib) -> None:
    free_mib(4)
    path = tmp_path / "a.clf.bz2"
    path.write_bytes(bz2.compress(("".join(LINE.format(k) for k in range(20)) + line * count).encode()))
    assert path.stat().st_size < 100_000
    recording = open_recording(path)
    assert len(list(recording.scans())) == 20
    assert ["no known laser" in warning for warning in recording.warnings] == [True, False]
    assert NO_RECORDING in recording.warnings[1]


def test_a_ros_1_chunk_that_declares_200_mb_is_refused(tmp_path: Path) -> None:
    fields = {"op": b"\x05", "compression": b"bz2", "size": struct.pack("<I", 200 * MIB)}
    header = b"".join(text(name.encode() + b"=" + value) for name, value in fields.items())
    path = tmp_path / "a.bag"
    path.write_bytes(b"#ROSBAG V2.0\n" + text(header) + text(bz2.compress(bytes(MIB))))
    assert NO_RECORDING in refusal(path)


@pytest.fixture
def ros2_folder(tmp_path: Path) -> Path:
    ros = Ros(2)
    messages = [*scans_of(ros, 1000, FRONT), ros.transforms(0, *mounts(FRONT), topic="/tf_static")]
    return ros.write(tmp_path / "bag", messages)


def test_a_compressed_ros_2_bag_is_not_unpacked_without_limit(ros2_folder: Path, free_mib) -> None:
    assert len(list(open_recording(ros2_folder).scans())) == 10
    (storage,) = ros2_folder.glob("*.db3")
    metadata = ros2_folder / "metadata.yaml"
    described = metadata.read_text().replace("compression_format: ''", "compression_format: zstd")
    metadata.write_text(described.replace("compression_mode: ''", "compression_mode: file"))
    whole = zstandard.compress(storage.read_bytes())
    storage.write_bytes(whole)
    assert len(list(open_recording(ros2_folder).scans())) == 10
    free_mib(4)
    storage.write_bytes(whole + zstandard.compress(bytes(20 * MIB)))
    assert NO_RECORDING in refusal(ros2_folder)


@pytest.mark.parametrize(
    ("yaml", "reason"),
    [
        ("a: &a [x, x]\nb: &b [*a, *a]\nc: [*b, *b]\n", "has aliases"),
        ("a: " + "[" * 100_000, "nested deeply"),
        ("# " + "x" * (2 << 20), "larger than"),
        ("a: [", "cannot be read"),
    ],
)
def test_hostile_metadata_of_a_ros_2_bag_are_refused(yaml: str, reason: str, ros2_folder: Path) -> None:
    (ros2_folder / "metadata.yaml").write_text(yaml)
    assert reason in refusal(ros2_folder)
    (database,) = ros2_folder.glob("*.db3")
    assert reason in refusal(database), "its one file is named, and the metadata lie beside it"


def test_a_still_scene_is_no_bomb(write, free_mib) -> None:
    """Half an hour of equal scans unpacks to less than the free amount; here both are a tenth."""
    free_mib(6)
    ranges = np.full(360, 2.5, np.float32)
    path = write((Scan(k * 10**8, ranges, -1.0, 0.01, 0.05, 5.0) for k in range(2000)), "still.mcap")
    recording = open_recording(path)
    assert sum(1 for _ in recording.scans()) == 2000
    assert recording.warnings == []

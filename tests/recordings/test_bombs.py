"""Small files that unpack to far more are read up to a limit in proportion to their size, and give one clear line."""

from __future__ import annotations

import bz2
import shutil
import struct
import tracemalloc
import zlib
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard

from gridtrack.common.errors import RecordingError
from gridtrack.common.scan import Scan
from gridtrack.recordings import open_recording
from gridtrack.recordings.file_reading import FREE_BYTES, FREE_RECORDS, NOT_A_RECORDING
from gridtrack.recordings.mcap_file import MCAP_MAGIC
from gridtrack.recordings.native_messages import METADATA_NAME, NATIVE_SCHEMA

from scenes.drive_bag import FRONT, Ros, mounts, scans_of

LINE = "FLASER 4 1 1 1 1 0 0 0 0 0 0 {} host 0\n"
NO_RECORDING = NOT_A_RECORDING.partition(":")[0]


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def text(value: str | bytes) -> bytes:
    content = value.encode() if isinstance(value, str) else value
    return struct.pack("<I", len(content)) + content


def chunk(content: bytes, compression: str) -> bytes:
    packed = zstandard.compress(content, 19) if compression == "zstd" else lz4.frame.compress(content)
    head = struct.pack("<QQQI", 0, 1, len(content), zlib.crc32(content)) + text(compression)
    return record(6, head + struct.pack("<Q", len(packed)) + packed)


def mcap(path: Path, content: bytes, compression: str) -> Path:
    """A native recording of one chunk, with valid checksums."""
    pairs = text("schema") + text(NATIVE_SCHEMA) + text("info") + text('{"site": "here"}')
    metadata = record(12, text(METADATA_NAME) + text(pairs))
    schema = record(3, struct.pack("<H", 1) + text("other") + text("protobuf") + text(b""))
    channel = record(4, struct.pack("<HH", 1, 1) + text("/other") + text("protobuf") + text(b""))
    path.write_bytes(MCAP_MAGIC + metadata + chunk(schema + channel + content, compression))
    return path


def refusal(path: Path) -> str:
    """The error of a file of which nothing can be used."""
    with pytest.raises(RecordingError) as refused:
        list(open_recording(path).scans())
    return str(refused.value)


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_an_mcap_file_of_millions_of_empty_messages(compression: str, tmp_path: Path) -> None:
    messages = record(5, struct.pack("<HIQQ", 1, 0, 0, 0)) * (2 * FREE_RECORDS)
    path = mcap(tmp_path / "a.mcap", messages, compression)
    assert path.stat().st_size < 100_000
    assert f"records; {NO_RECORDING}" in refusal(path)


def test_an_mcap_chunk_is_refused_before_it_is_unpacked(tmp_path: Path) -> None:
    path = mcap(tmp_path / "a.mcap", record(200, bytes(2 * FREE_BYTES)), "zstd")
    assert path.stat().st_size < 20_000
    tracemalloc.start()
    assert f"MiB; {NO_RECORDING}" in refusal(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < FREE_BYTES


@pytest.mark.parametrize(("line", "count"), [("\n", 3 * FREE_RECORDS), ("# " + "0" * 100_000 + "\n", 1500)])
def test_a_carmen_log_gives_the_scans_before_the_bomb(line: str, count: int, tmp_path: Path) -> None:
    log = "".join(LINE.format(k) for k in range(20)) + line * count
    path = tmp_path / "a.clf.bz2"
    path.write_bytes(bz2.compress(log.encode()))
    assert path.stat().st_size < 100_000
    recording = open_recording(path)
    assert len(list(recording.scans())) == 20
    assert ["no known laser" in line for line in recording.warnings] == [True, False]
    assert NO_RECORDING in recording.warnings[1]


def bag_record(fields: dict[str, bytes], data: bytes) -> bytes:
    header = b"".join(text(name.encode() + b"=" + value) for name, value in fields.items())
    return text(header) + text(data)


def test_a_bag_of_an_empty_chunk_of_200_mb(tmp_path: Path) -> None:
    content = bytes(200 << 20)
    fields = {"op": b"\x05", "compression": b"bz2", "size": struct.pack("<I", len(content))}
    path = tmp_path / "a.bag"
    path.write_bytes(b"#ROSBAG V2.0\n" + bag_record(fields, bz2.compress(content[: 1 << 20])))
    assert NO_RECORDING in refusal(path)


@pytest.fixture
def ros2_folder(tmp_path: Path) -> Path:
    ros = Ros(2)
    messages = [*scans_of(ros, 1000, FRONT), ros.transforms(0, *mounts(FRONT), topic="/tf_static")]
    return ros.write(tmp_path / "bag", messages)


def test_a_compressed_ros_2_bag_is_not_unpacked_without_limit(ros2_folder: Path) -> None:
    assert len(list(open_recording(ros2_folder).scans())) == 10
    (storage,) = ros2_folder.glob("*.db3")
    metadata = ros2_folder / "metadata.yaml"
    described = metadata.read_text().replace("compression_format: ''", "compression_format: zstd")
    metadata.write_text(described.replace("compression_mode: ''", "compression_mode: file"))
    whole = zstandard.compress(storage.read_bytes())
    storage.write_bytes(whole)
    assert len(list(open_recording(ros2_folder).scans())) == 10
    storage.write_bytes(whole + zstandard.compress(bytes(2 * FREE_BYTES)))
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
def test_metadata_of_a_ros_2_bag_that_repeats_itself(yaml: str, reason: str, ros2_folder: Path) -> None:
    (ros2_folder / "metadata.yaml").write_text(yaml)
    assert reason in refusal(ros2_folder)


def test_a_recording_of_a_scene_without_any_change_is_no_bomb(tmp_path: Path, write) -> None:
    ranges = np.full(360, 2.5, np.float32)
    path = write((Scan(k * 10**8, ranges, -1.0, 0.01, 0.05, 5.0) for k in range(20_000)), "still.mcap")
    recording = open_recording(path)
    assert sum(1 for _ in recording.scans()) == 20_000
    assert recording.warnings == []
    shutil.rmtree(tmp_path)

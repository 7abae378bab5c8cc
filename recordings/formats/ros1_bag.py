"""ROS 1 bags (format 2.0), read record by record, so that bags without an index or cut in the middle can be read.

Format: http://wiki.ros.org/Bags/Format/2.0
"""

from __future__ import annotations

import bz2
import struct
from collections.abc import Iterator
from io import SEEK_CUR, BytesIO
from pathlib import Path
from typing import BinaryIO

import lz4.frame  # type: ignore[import-untyped]

from gridtrack.recordings.file_reading import DamageError, ReadBudget
from gridtrack.recordings.framed_recording import EncodedMessage
from gridtrack.recordings.registry import RecordingFormat
from gridtrack.recordings.ros_recording import ROS_OPTIONS, RosRecording, ros2_name

ROS1_MAGIC = b"#ROSBAG V2.0\n"
MAX_BAG_RECORD_BYTES = 1 << 28
MESSAGE_OP, BAG_HEADER_OP, INDEX_OP, CHUNK_OP, CONNECTION_OP = 2, 3, 4, 5, 7
INDEX_ENTRY_BYTES = 12
MAX_HEADER_BYTES = 1 << 16
"""Limit of a record's header: distinguishes a record from other bytes."""

Fields = dict[str, bytes]


class Ros1Bag(RosRecording):
    """A ROS 1 bag."""

    def messages(self) -> Iterator[EncodedMessage]:
        """All messages in the order of the file. Raises DamageError if it is cut off or corrupt."""
        with self.path.open("rb") as file:
            if file.read(len(ROS1_MAGIC)) != ROS1_MAGIC:
                raise DamageError("does not begin as a ROS 1 bag of format 2.0")
            connections: dict[bytes, tuple[str, str]] = {}
            chunks_left, budget = 0, ReadBudget()
            try:
                for header, data in _records(file):
                    operation = header["op"][0]
                    if operation == BAG_HEADER_OP:
                        (chunks_left,) = struct.unpack("<I", header["chunk_count"])
                    elif operation == CHUNK_OP:
                        chunks_left -= 1
                        for inner, body in _chunk(header, data, budget, file.tell()):
                            yield from _read_record(inner, body, connections)
                    else:
                        yield from _read_record(header, data, connections)
            except (struct.error, KeyError, UnicodeDecodeError, IndexError, ValueError) as error:
                raise DamageError(f"corrupt {file.tell()} bytes into the file ({error})") from None
            if chunks_left > 0:
                raise DamageError(f"cut off: {chunks_left} of the chunks in the bag's header are missing")


def is_ros1_bag(path: Path, head: bytes) -> bool:
    """Whether the file begins as a ROS 1 bag."""
    return head.startswith(ROS1_MAGIC)


ROS1_BAG_FORMAT = RecordingFormat("ROS 1 bag", (".bag",), is_ros1_bag, Ros1Bag, ROS_OPTIONS)


def _chunk(header: Fields, data: bytes, budget: ReadBudget, position: int) -> Iterator[tuple[Fields, bytes]]:
    """The records inside a chunk that ends at `position`, up to the cut if it is cut off."""
    (size,) = struct.unpack("<I", header["size"])
    budget.take_bytes(size, position)
    content = _decompressed(header["compression"].decode(), data, size)
    for record in _records(BytesIO(content)):
        budget.take_record(position)
        yield record
    if len(content) != size:
        raise DamageError(f"cut off or corrupt: a chunk of {len(content)} bytes, where its header says {size}")


def _read_record(header: Fields, data: bytes, connections: dict[bytes, tuple[str, str]]) -> Iterator[EncodedMessage]:
    operation = header["op"][0]
    if operation == CONNECTION_OP:
        kind = ros2_name(_fields(data)["type"].decode())
        connections[header["conn"]] = (header["topic"].decode(), kind)
    elif operation == MESSAGE_OP:
        topic, kind = connections[header["conn"]]
        seconds, nanoseconds = struct.unpack("<II", header["time"])
        yield EncodedMessage(topic, kind, seconds * 1_000_000_000 + nanoseconds, "ros1", data)


def _records(file: BinaryIO) -> Iterator[tuple[Fields, bytes]]:
    while size := file.read(4):
        header_bytes, header_is_whole = _sized(file, size)
        header = _fields(header_bytes) if header_is_whole else {}
        data, data_is_whole = _sized(file, _true_size(file, header, file.read(4)))
        if data_is_whole or header.get("op") == bytes([CHUNK_OP]):
            yield header, data
        if not data_is_whole:
            raise DamageError("cut off in the middle of a record")


def _true_size(file: BinaryIO, header: Fields, size_bytes: bytes) -> bytes:
    """The size of a record's data; for an index from its number of entries if no record follows at the stated size."""
    if header.get("op") != bytes([INDEX_OP]) or len(size_bytes) != 4 or len(header.get("count", b"")) != 4:
        return size_bytes
    by_count = struct.pack("<I", INDEX_ENTRY_BYTES * int.from_bytes(header["count"], "little"))
    wrong = by_count != size_bytes and not _record_follows(file, size_bytes) and _record_follows(file, by_count)
    return by_count if wrong else size_bytes


def _record_follows(file: BinaryIO, size_bytes: bytes) -> bool:
    """Whether a record begins, or the file ends, this many bytes ahead."""
    position = file.tell()
    file.seek(int.from_bytes(size_bytes, "little"), SEEK_CUR)
    size = int.from_bytes(file.read(4), "little")
    header = file.read(size) if size <= MAX_HEADER_BYTES else b""
    file.seek(position)
    return len(header) == size and (size == 0 or b"op=" in header)


def _sized(file: BinaryIO, size_bytes: bytes) -> tuple[bytes, bool]:
    """As many bytes as `size_bytes` says, and whether the file has all of them. Raises DamageError."""
    (size,) = struct.unpack("<I", size_bytes) if len(size_bytes) == 4 else (0,)
    if size > MAX_BAG_RECORD_BYTES:
        raise DamageError(f"corrupt: a record of {size} bytes, where at most {MAX_BAG_RECORD_BYTES} are read")
    content = file.read(size)
    return content, len(content) == size and len(size_bytes) == 4


def _fields(data: bytes) -> Fields:
    """The `name=value` fields of a record's header."""
    fields, at = {}, 0
    while at < len(data):
        (size,) = struct.unpack_from("<I", data, at)
        name, equals, value = data[at + 4 : at + 4 + size].partition(b"=")
        if not equals:
            raise DamageError("corrupt: a record's header cannot be read")
        fields[name.decode()] = value
        at += 4 + size
    return fields


def _decompressed(compression: str, data: bytes, size: int) -> bytes:
    """The records inside a chunk, at most `size` bytes. Raises DamageError."""
    if size > MAX_BAG_RECORD_BYTES:
        raise DamageError(f"corrupt: a chunk of {size} bytes, where at most {MAX_BAG_RECORD_BYTES} are read")
    if compression == "none":
        return data
    try:
        if compression == "bz2":
            return bz2.BZ2Decompressor().decompress(data, size)
        if compression == "lz4":
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, size))
    except (OSError, RuntimeError) as error:
        raise DamageError(f"corrupt: a chunk cannot be decompressed ({error})") from None
    raise DamageError(f"a chunk is compressed as '{compression}'; expected none, bz2 or lz4")

"""The records of an MCAP file, read in order: sizes are checked before memory is allocated, checksums verified.

Format: https://mcap.dev/spec. The stream reader of the mcap package is not used: it unpacks chunks without a limit,
keeps all messages of a chunk in memory, and accepts records that are cut off.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, DataEnd, Metadata, Schema

from gridtrack.recordings.file_reading import DamageError, FileEnds, GrowingFile, Growth, ReadBudget

MCAP_MAGIC = b"\x89MCAP0\r\n"
MAX_MCAP_RECORD_BYTES = 1 << 28
ENVELOPE = struct.Struct("<BQ")
MESSAGE_HEADER = struct.Struct("<HIQQ")
CHUNK_HEADER = struct.Struct("<QQQII")
"""Start, end, size, checksum, and the number of bytes of the name of the compression."""
WITHOUT_SCHEMA = Schema(id=0, data=b"", encoding="", name="")
"""The schema 0 of a channel without a schema, such as a JSON channel."""


class McapMessage(NamedTuple):
    """One message, still encoded, with its channel and schema."""

    schema: Schema
    channel: Channel
    log_time_ns: int
    data: bytes


class McapFile:
    """An MCAP file, read from its beginning to its end or to the first damage.

    With `growth` it may still be written: then its present end is not damage.
    """

    def __init__(self, path: Path, growth: Growth | None = None, budget: ReadBudget | None = None) -> None:
        """`budget`: limits of one pass; the default is for recordings."""
        self.path, self._growth, self._budget = path, growth, budget or ReadBudget()
        self.metadata: dict[str, dict[str, str]] = {}
        self.channels: dict[int, Channel] = {}
        self._schemas: dict[int, Schema] = {}

    def messages(self) -> Iterator[McapMessage]:
        """All messages in the order of the file; fills `metadata` and `channels` meanwhile.

        Raises DamageError if the file is cut off or corrupt.
        """
        with self._growth.open(self.path) if self._growth else self.path.open("rb") as file:
            try:
                yield from self._data_section(file)
            except FileEnds:
                return
            except (McapError, struct.error, UnicodeDecodeError, zstandard.ZstdError) as error:
                raise DamageError(
                    f"damaged {file.tell()} bytes into the file ({error or type(error).__name__})"
                ) from None

    def _data_section(self, file: BinaryIO | GrowingFile) -> Iterator[McapMessage]:
        if file.read(len(MCAP_MAGIC)) != MCAP_MAGIC:
            raise DamageError("does not begin as an MCAP file")
        checksum, budget = zlib.crc32(MCAP_MAGIC), replace(self._budget)
        for opcode, content in _records(file):
            stream = ReadDataStream(BytesIO(content))
            if opcode == Opcode.CHUNK:
                (chunk, is_cut), position = _chunk_in(content), file.tell()
                budget.take_bytes(chunk.uncompressed_size, position)
                for inner_opcode, inner in _records(BytesIO(_decompressed(chunk, is_cut))):
                    budget.take_record(position)
                    yield from self._read_record(inner_opcode, inner)
            elif opcode == Opcode.METADATA:
                record = Metadata.read(stream)
                self.metadata[record.name] = record.metadata
            elif opcode == Opcode.DATA_END:
                if DataEnd.read(stream).data_section_crc not in (0, checksum):
                    raise DamageError("corrupt: the checksum of the whole file is wrong")
                if self._growth:
                    _read_to_the_end(file)
                return
            else:
                yield from self._read_record(opcode, content)
            checksum = zlib.crc32(content, zlib.crc32(ENVELOPE.pack(opcode, len(content)), checksum))
        raise DamageError("cut off: the end of the data is missing")

    def _read_record(self, opcode: int, content: bytes) -> Iterator[McapMessage]:
        if opcode == Opcode.MESSAGE:
            channel_id, _, log_time_ns, _ = MESSAGE_HEADER.unpack_from(content)
            channel = self.channels.get(channel_id)
            schema = self._schemas.get(channel.schema_id) if channel else None
            if channel is not None and channel.schema_id == 0:
                schema = WITHOUT_SCHEMA
            if channel is None or schema is None:
                raise DamageError(f"corrupt: a message of channel {channel_id}, which the file does not define")
            yield McapMessage(schema, channel, log_time_ns, content[MESSAGE_HEADER.size :])
        elif opcode == Opcode.SCHEMA:
            schema = Schema.read(ReadDataStream(BytesIO(content)))
            self._schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(ReadDataStream(BytesIO(content)))
            self.channels[channel.id] = channel


def _records(file: BinaryIO | GrowingFile) -> Iterator[tuple[int, bytes]]:
    """Opcode and content of each record; of a chunk that is cut off, the part before the cut.

    Raises DamageError if a record is cut off or too large.
    """
    while head := file.read(ENVELOPE.size):
        if len(head) < ENVELOPE.size:
            raise DamageError("cut off in the middle of a record")
        opcode, size = ENVELOPE.unpack(head)
        if size > MAX_MCAP_RECORD_BYTES:
            raise DamageError(f"corrupt: a record of {size} bytes, where at most {MAX_MCAP_RECORD_BYTES} are read")
        content = file.read(size)
        if len(content) == size or opcode == Opcode.CHUNK:
            yield opcode, content
        if len(content) < size:
            raise DamageError("cut off in the middle of a record")


def _read_to_the_end(file: BinaryIO | GrowingFile) -> None:
    """Read the records after the data, up to the magic bytes at the end of the file."""
    for opcode, _ in _records(file):
        if opcode == Opcode.FOOTER:
            file.read(len(MCAP_MAGIC))
            return


def _chunk_in(content: bytes) -> tuple[Chunk, bool]:
    """The chunk in a record, and whether it is cut off; the data of such a chunk end at the cut."""
    start_ns, end_ns, size, checksum, name_bytes = CHUNK_HEADER.unpack_from(content)
    compression = content[CHUNK_HEADER.size :][:name_bytes].decode()
    at = CHUNK_HEADER.size + name_bytes
    (data_bytes,) = struct.unpack_from("<Q", content, at)
    data = content[at + 8 :][:data_bytes]
    chunk = Chunk(
        message_start_time=start_ns,
        message_end_time=end_ns,
        uncompressed_size=size,
        uncompressed_crc=checksum,
        compression=compression,
        data=data,
    )
    return chunk, len(data) < data_bytes


def _decompressed(chunk: Chunk, is_cut: bool) -> bytes:
    """The records inside a chunk. Raises DamageError if they are too large or their checksum is wrong."""
    size = chunk.uncompressed_size
    if size > MAX_MCAP_RECORD_BYTES:
        raise DamageError(f"corrupt: a chunk of {size} bytes, where at most {MAX_MCAP_RECORD_BYTES} are read")
    if chunk.compression == "zstd":
        with zstandard.ZstdDecompressor().stream_reader(chunk.data) as stream:
            content = stream.read(size)
    elif chunk.compression == "lz4":
        try:
            content = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, size)
        except RuntimeError as error:
            raise DamageError(f"corrupt: a chunk cannot be decompressed ({error})") from None
    elif chunk.compression == "":
        content = chunk.data
    else:
        raise DamageError(f"a chunk is compressed as '{chunk.compression}'; expected zstd or lz4")
    if is_cut:
        return content
    if len(content) != size or (chunk.uncompressed_crc and zlib.crc32(content) != chunk.uncompressed_crc):
        raise DamageError("corrupt: the checksum of a chunk is wrong")
    return content

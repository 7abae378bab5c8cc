"""Files of several parts, damaged in one part and packed again: lengths, checksums and digests are right."""

from __future__ import annotations

import bz2
import sqlite3
import struct
import zlib
from contextlib import closing, suppress
from io import BytesIO
from pathlib import Path
from typing import Any

import pyarrow as pa
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Chunk, Metadata
from pyarrow import parquet

from fuzz.damage import Choices, damaged_bytes, damaged_json, damaged_text, one_of
from gridtrack.recordings.mcap_file import ENVELOPE, MCAP_MAGIC
from gridtrack.recordings.native_messages import METADATA_NAME, NATIVE_SCHEMA
from gridtrack.trackers.wire import MAGIC, MESSAGE_PREFIX, VERSION

Record = tuple[int, bytes]
BAG_MAGIC = b"#ROSBAG V2.0\n"
BAG_CHUNK, BAG_HEADER = b"\x05", b"\x03"


def sized(content: bytes) -> bytes:
    """`content` after its length, as MCAP and ROS write it."""
    return struct.pack("<I", len(content)) + content


def damaged_list(choices: Choices, parts: list[Any], damage: Any) -> list[Any]:
    """`parts` with one of them damaged, left out, repeated or moved to the front."""
    if not parts:
        return parts
    at = choices.below(len(parts))
    rest = parts[:at] + parts[at + 1 :]
    edits = [
        lambda: [*parts[:at], damage(parts[at]), *parts[at + 1 :]],
        lambda: [*parts[:at], damage(parts[at]), *parts[at + 1 :]],
        lambda: rest,
        lambda: [*parts, parts[at]],
        lambda: [parts[at], *rest],
    ]
    return one_of(choices, edits)()


def damaged_mcap(choices: Choices, content: bytes) -> bytes:
    """An MCAP file with a damaged record, in one chunk with a valid checksum."""
    records = damaged_list(choices, list(_mcap_records(content)), lambda record: _damaged_record(choices, record))
    plain = b"".join(ENVELOPE.pack(op, len(body)) + body for op, body in records if op == Opcode.METADATA)
    inner = b"".join(ENVELOPE.pack(op, len(body)) + body for op, body in records if op != Opcode.METADATA)
    packed = zstandard.compress(inner)
    chunk = struct.pack("<QQQI", 0, 1, len(inner), zlib.crc32(inner)) + sized(b"zstd")
    chunk += struct.pack("<Q", len(packed)) + packed
    end = ENVELOPE.pack(Opcode.DATA_END, 4) + bytes(4) + ENVELOPE.pack(Opcode.FOOTER, 20) + bytes(20) + MCAP_MAGIC
    return MCAP_MAGIC + plain + ENVELOPE.pack(Opcode.CHUNK, len(chunk)) + chunk + end


def _mcap_records(content: bytes) -> Any:
    at = len(MCAP_MAGIC)
    kept = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.METADATA)
    while at + ENVELOPE.size <= len(content):
        opcode, size = ENVELOPE.unpack_from(content, at)
        body = content[at + ENVELOPE.size : at + ENVELOPE.size + size]
        at += ENVELOPE.size + size
        if opcode == Opcode.CHUNK:
            chunk = Chunk.read(ReadDataStream(BytesIO(body)))
            data = zstandard.decompress(chunk.data) if chunk.compression == "zstd" else chunk.data
            yield from _mcap_records(MCAP_MAGIC + data)
        elif opcode == Opcode.DATA_END:
            return
        elif opcode in kept:
            yield opcode, body


def _damaged_record(choices: Choices, record: Record) -> Record:
    opcode, body = record
    if opcode == Opcode.METADATA:
        found = Metadata.read(ReadDataStream(BytesIO(body)))
        if found.name == METADATA_NAME and choices.below(4):
            info = damaged_json(choices, found.metadata["info"].encode())
            pairs = b"".join(map(sized, (b"schema", NATIVE_SCHEMA.encode(), b"info", info)))
            return opcode, sized(METADATA_NAME.encode()) + sized(pairs)
    return opcode, damaged_bytes(choices, body)


def damaged_bag(choices: Choices, content: bytes) -> bytes:
    """A ROS 1 bag with a damaged record, in one chunk that is compressed again."""
    records = damaged_list(choices, list(_bag_records(content)), lambda one: _damaged_bag_record(choices, one))
    inner = b"".join(_bag_record(fields, data) for fields, data in records)
    header = {b"op": BAG_HEADER, b"chunk_count": struct.pack("<I", 1), b"conn_count": bytes(4), b"index_pos": bytes(8)}
    chunk = {b"op": BAG_CHUNK, b"compression": b"bz2", b"size": struct.pack("<I", len(inner))}
    return BAG_MAGIC + _bag_record(header, b" " * 100) + _bag_record(chunk, bz2.compress(inner))


def _bag_record(fields: dict[bytes, bytes], data: bytes) -> bytes:
    return sized(b"".join(sized(name + b"=" + value) for name, value in fields.items())) + sized(data)


def _bag_records(content: bytes) -> Any:
    """Messages and connections, those inside chunks included."""
    file = BytesIO(content.removeprefix(BAG_MAGIC))

    def read() -> bytes:
        (size,) = struct.unpack("<I", file.read(4))
        return file.read(size)

    while file.tell() < len(file.getbuffer()):
        header, data = BytesIO(read()), read()
        fields = {}
        while size := header.read(4):
            name, _, value = header.read(*struct.unpack("<I", size)).partition(b"=")
            fields[name] = value
        if fields[b"op"] == BAG_CHUNK:
            yield from _bag_records(data)
        elif fields[b"op"] in (b"\x02", b"\x07"):
            yield fields, data


def _damaged_bag_record(choices: Choices, record: tuple[dict[bytes, bytes], bytes]) -> tuple[dict[bytes, bytes], bytes]:
    fields, data = record
    if choices.below(3):
        return fields, damaged_bytes(choices, data)
    name = one_of(choices, list(fields))
    return {**fields, name: damaged_bytes(choices, fields[name])}, data


def damage_sqlite(choices: Choices, path: Path) -> None:
    """A damaged cell of a table, a row that is missing, or a damaged page."""
    if not choices.below(4):
        path.write_bytes(damaged_bytes(choices, path.read_bytes()))
        return
    with suppress(sqlite3.IntegrityError), closing(sqlite3.connect(path)) as database, database:
        tables = [name for (name,) in database.execute("select name from sqlite_master where type = 'table'")]
        table = one_of(choices, sorted(tables))
        rows = [row for (row,) in database.execute(f"select rowid from {table}")]
        columns = [column[1] for column in database.execute(f"pragma table_info({table})")]
        if not rows:
            return
        row, column = one_of(choices, rows), one_of(choices, columns)
        (value,) = database.execute(f"select {column} from {table} where rowid = ?", [row]).fetchone()
        if not choices.below(6):
            database.execute(f"delete from {table} where rowid = ?", [row])
            return
        changed: Any = one_of(choices, [None, -1, 2**63 - 1, 0, 1e308, "\x1b[31m\u202e", b"\xff", "x" * 5000])
        if isinstance(value, bytes) and choices.below(4):
            changed = damaged_bytes(choices, value)
        elif isinstance(value, str) and choices.below(2):
            changed = damaged_text(choices, value.encode()).decode(errors="replace")
        database.execute(f"update or replace {table} set {column} = ? where rowid = ?", [changed, row])


def damage_parquet(choices: Choices, path: Path, metadata_key: bytes | None = None) -> None:
    """A damaged value, column or metadata of a Parquet file, or damaged bytes."""
    kind = choices.below(5)
    table = parquet.read_table(path)
    if kind == 0:
        path.write_bytes(damaged_bytes(choices, path.read_bytes()))
        return
    if kind == 1 and metadata_key is not None:
        metadata = dict(table.schema.metadata or {})
        metadata[metadata_key] = damaged_json(choices, metadata[metadata_key])
        table = table.replace_schema_metadata(metadata)
    elif kind == 2:
        order = list(range(table.num_rows))
        table = table.take(damaged_list(choices, order, lambda at: at))
    elif kind == 3:
        table = table.drop_columns([one_of(choices, table.column_names)])
    else:
        table = _with_damaged_column(choices, table)
    parquet.write_table(table, path, compression="zstd")


def _with_damaged_column(choices: Choices, table: pa.Table) -> pa.Table:
    at = choices.below(table.num_columns)
    field = table.schema.field(at)
    values = table.column(at).to_pylist()
    if values:
        row = choices.below(len(values))
        values[row] = one_of(choices, [None, 0, -1, 1, 2**15, 2**31 - 1, 2**63 - 1, 1e308, float("nan"), "x" * 500, []])
    try:
        column = pa.array(values, field.type)
    except (pa.ArrowException, TypeError, ValueError, OverflowError):
        field = pa.field(field.name, one_of(choices, [pa.string(), pa.int64(), pa.float64(), pa.binary()]))
        column = pa.nulls(len(values), field.type)
    return table.set_column(at, field, column)


def damaged_message(choices: Choices, content: bytes) -> bytes:
    """A message of the wire with a damaged header or body of the right length, or with damaged bytes."""
    if not choices.below(6):
        return damaged_bytes(choices, content)
    size = MESSAGE_PREFIX.unpack_from(content)[2]
    header, body = content[MESSAGE_PREFIX.size :][:size], content[MESSAGE_PREFIX.size + size :]
    if choices.below(4):
        header = damaged_json(choices, header)
    else:
        body = damaged_bytes(choices, body)
    return MESSAGE_PREFIX.pack(MAGIC, VERSION, len(header), len(body)) + header + body


def damaged_safetensors(choices: Choices, content: bytes) -> bytes:
    """A file of arrays with a damaged header of the right length, or with damaged bytes."""
    if not choices.below(3):
        return damaged_bytes(choices, content)
    (size,) = struct.unpack_from("<Q", content)
    header = damaged_json(choices, content[8 : 8 + size])
    return struct.pack("<Q", len(header)) + header + content[8 + size :]

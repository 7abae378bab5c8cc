"""The wire: length-prefixed messages between the referee and a tracker process (docs/wire.md describes them).

A message is a fixed prefix, a small JSON header and a body of raw little-endian arrays; their names, types and shapes
the header declares. Nothing is unpickled, and every size is checked before memory is taken for it.
"""

from __future__ import annotations

import json
import math
import os
import struct
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.errors import GridtrackError
from gridtrack.common.untrusted import parse_json

MAGIC = b"GTW"
VERSION = 1
MESSAGE_PREFIX = struct.Struct("<3sBIQ")
"""Magic, version, header length and body length in bytes: 16 bytes."""
MAX_HEADER = 1 << 20
MAX_ARRAYS = 64
MAX_DIMENSIONS = 8
PIPE_BYTES = 1 << 20

DTYPES = {
    name: np.dtype(code)
    for name, code in {
        "bool": "?",
        "uint8": "u1",
        "int32": "<i4",
        "int64": "<i8",
        "float16": "<f2",
        "float32": "<f4",
        "float64": "<f8",
    }.items()
}
RESERVED = ("type", "id", "arrays")

Fill = Callable[[list[memoryview]], None]
"""Fills the buffers in their order with received bytes; raises if it cannot."""
FieldType = TypeVar("FieldType")


class WireError(GridtrackError):
    """Bytes that are not a message of this protocol, or a message with missing or invalid content."""


class TooLargeError(WireError):
    """A message that declares more bytes than are accepted; no memory was taken for it."""


@dataclass(frozen=True, slots=True)
class Message:
    """One message: its `kind`, the `number` of its request, JSON `fields` and named `arrays`."""

    kind: str
    number: int
    fields: Mapping[str, Any] = field(default_factory=dict)
    arrays: Mapping[str, NDArray[Any]] = field(default_factory=dict)

    def value(self, name: str, kind: type[FieldType]) -> FieldType:
        """The JSON field `name`, which must be a `kind`; an integer passes for a float. Raises WireError."""
        found = self.fields.get(name)
        if kind is float and type(found) is int:
            found = float(found)
        if not isinstance(found, kind) or (isinstance(found, bool) and kind is not bool):
            raise WireError(f"'{self.kind}' needs a field '{name}' of type {kind.__name__}; found {found!r:.80}")
        return found

    def array(self, name: str, dtype: str, shape: tuple[int | None, ...]) -> NDArray[Any]:
        """The array `name` of this dtype and shape; None is any length. Raises WireError."""
        found = self.arrays.get(name)
        if found is None:
            raise WireError(f"'{self.kind}' needs an array '{name}'")
        if found.dtype != DTYPES[dtype] or not fits(found.shape, shape):
            raise WireError(f"'{self.kind}': array '{name}' is {found.dtype} {found.shape}; expected {dtype} {shape}")
        return found


def fits(shape: tuple[int, ...], expected: tuple[int | None, ...]) -> bool:
    """Whether `shape` is the expected one; None is any length."""
    return len(shape) == len(expected) and all(e is None or s == e for s, e in zip(shape, expected, strict=True))


def encode(message: Message) -> list[memoryview]:
    """The bytes of a message as consecutive buffers. Raises WireError for a dtype that is not in DTYPES."""
    declared, buffers = [], []
    for name, array in message.arrays.items():
        code = array.dtype.name
        if code not in DTYPES:
            raise WireError(f"'{message.kind}': array '{name}' is {array.dtype}; the wire carries {', '.join(DTYPES)}")
        declared.append({"name": name, "dtype": code, "shape": array.shape})
        if array.size:
            buffers.append(np.ascontiguousarray(array, DTYPES[code]).reshape(-1).view(np.uint8).data)
    content = {"type": message.kind, "id": message.number, "arrays": declared} | dict(message.fields)
    try:
        header = json.dumps(content, separators=(",", ":"), allow_nan=False).encode()
    except (TypeError, ValueError) as error:
        raise WireError(f"'{message.kind}': a field is not JSON ({error})") from None
    if len(header) > MAX_HEADER:
        raise WireError(f"'{message.kind}': a header of {len(header)} bytes; at most {MAX_HEADER}")
    prefix = MESSAGE_PREFIX.pack(MAGIC, VERSION, len(header), sum(b.nbytes for b in buffers))
    return [memoryview(prefix + header), *buffers]


def receive(fill: Fill, max_body: int) -> Message:
    """Read one message with a body of at most `max_body` bytes.

    Raises TooLargeError, WireError, and the errors of `fill`.
    """
    prefix = bytearray(MESSAGE_PREFIX.size)
    fill([memoryview(prefix)])
    magic, version, header_bytes, body_bytes = MESSAGE_PREFIX.unpack(prefix)
    if magic != MAGIC:
        raise WireError(f"not a message: it starts with {bytes(prefix[:8])!r} instead of {MAGIC!r}")
    if version != VERSION:
        raise WireError(f"a message of wire version {version}; this gridtrack speaks version {VERSION}")
    if header_bytes > MAX_HEADER or body_bytes > max_body:
        raise TooLargeError(
            f"a message declares a header of {header_bytes} and a body of {body_bytes} bytes;"
            f" at most {MAX_HEADER} and {max_body} are accepted here"
        )
    header = bytearray(header_bytes)
    body = np.empty(body_bytes, np.uint8)
    fill([memoryview(header), body.data])
    return _decode(header, body)


def _decode(header: bytearray, body: NDArray[np.uint8]) -> Message:
    try:
        content = parse_json(header)
    except ValueError as error:
        raise WireError(f"the header is not JSON that can be read ({error})") from None
    if not isinstance(content, dict):
        raise WireError("the header is not a JSON object")
    kind, number, declared = (content.pop(key, None) for key in RESERVED)
    if not isinstance(kind, str) or type(number) is not int or not isinstance(declared, list):
        raise WireError("the header needs 'type' (a string), 'id' (an integer) and 'arrays' (a list)")
    return Message(kind, number, content, _arrays(declared, body))


def _arrays(declared: Sequence[Any], body: NDArray[np.uint8]) -> dict[str, NDArray[Any]]:
    """Views of `body` as declared; raises WireError unless they fill it exactly."""
    if len(declared) > MAX_ARRAYS:
        raise WireError(f"{len(declared)} arrays in one message; at most {MAX_ARRAYS}")
    arrays: dict[str, NDArray[Any]] = {}
    start = 0
    for item in declared:
        name, dtype, shape = _declaration(item)
        if name in arrays:
            raise WireError(f"array '{name}' is declared twice")
        end = start + math.prod(shape) * dtype.itemsize
        if end > body.nbytes:
            raise WireError(f"array '{name}' ends at byte {end} of a body of {body.nbytes}")
        arrays[name] = _array(body[start:end], dtype).reshape(shape)
        start = end
    if start != body.nbytes:
        raise WireError(f"the declared arrays fill {start} bytes of a body of {body.nbytes}")
    return arrays


def _declaration(item: Any) -> tuple[str, np.dtype[Any], tuple[int, ...]]:
    if not isinstance(item, dict) or set(item) != {"name", "dtype", "shape"}:
        raise WireError(f"an array is declared by name, dtype and shape; found {item!r:.80}")
    name, dtype, shape = item["name"], item["dtype"], item["shape"]
    if not isinstance(name, str) or not isinstance(dtype, str) or dtype not in DTYPES:
        raise WireError(f"array {name!r:.80} of dtype {dtype!r:.80}; the wire carries {', '.join(DTYPES)}")
    if not isinstance(shape, list) or len(shape) > MAX_DIMENSIONS or not all(_is_length(n) for n in shape):
        raise WireError(f"array '{name}': {shape!r:.80} is not a shape")
    return name, DTYPES[dtype], tuple(shape)


def _is_length(value: Any) -> bool:
    return type(value) is int and 0 <= value < 1 << 31


def _array(part: NDArray[np.uint8], dtype: np.dtype[Any]) -> NDArray[Any]:
    if dtype == np.bool_:
        return np.not_equal(part, 0)  # in a numpy bool, bytes other than 0 and 1 are undefined
    return np.require(part.view(dtype), requirements="A")


def fill_from(fd: int) -> Fill:
    """Blocking reads of the file descriptor `fd`. Raises EOFError if the stream ends inside or before a message."""

    def fill(buffers: list[memoryview]) -> None:
        left = [b for b in buffers if b.nbytes]
        while left:
            count = os.readv(fd, left)
            if count == 0:
                raise EOFError
            left = without(left, count)

    return fill


def write_to(fd: int, buffers: list[memoryview]) -> None:
    """Blocking write of all buffers to the file descriptor `fd`."""
    left = buffers
    while left:
        left = without(left, os.writev(fd, left))


def without(buffers: list[memoryview], count: int) -> list[memoryview]:
    """The buffers without their first `count` bytes."""
    for index, buffer in enumerate(buffers):
        if count < buffer.nbytes:
            return [buffer[count:], *buffers[index + 1 :]]
        count -= buffer.nbytes
    return []


def widen(fd: int) -> None:
    """Set the capacity of the pipe `fd` to 1 MiB if the system allows it: a forecast needs fewer writes."""
    if sys.platform == "linux":
        import fcntl

        try:
            fcntl.fcntl(fd, fcntl.F_SETPIPE_SZ, PIPE_BYTES)
        except OSError:
            return  # not a pipe, or a lower limit: slower only

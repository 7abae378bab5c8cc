"""Reading files that are damaged, compressed far, or still being written."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from types import TracebackType
from typing import Self

import zstandard

from gridtrack.common.errors import RecordingError
from gridtrack.common.files import atomic_write

FREE_BYTES, BYTES_PER_BYTE = 64 << 20, 100
"""Limit of the unpacked bytes of a file: a free amount, and more for each byte of the file."""
FREE_RECORDS, BYTES_PER_RECORD = 200_000, 2
"""Limit of the records (messages, lines) of a file: a free number, and one more for every two bytes of the file."""
ZSTD_MAGIC, UNPACKED_BLOCK_BYTES = b"\x28\xb5\x2f\xfd", 1 << 20
NOT_A_RECORDING = "no recording is compressed so far: import it from a trusted copy"


class DamageError(RecordingError):
    """A file is cut off or corrupt: only the scans before the damage can be used."""


@dataclass
class ReadBudget:
    """Counts the unpacked content of a compressed file in one pass, with limits in proportion to the file's size.

    Scans compress to a tenth, and a message takes tens of bytes. Ten kilobytes that unpack to 200 MB, or to millions of
    empty messages, are not a recording, and would take minutes of processor time.
    """

    bytes_per_byte: int = BYTES_PER_BYTE
    free_records: int = FREE_RECORDS
    unpacked_bytes: int = 0
    records: int = 0

    def take_bytes(self, count: int, file_bytes: int) -> None:
        """Count bytes before they are unpacked from the first `file_bytes` of the file. Raises DamageError."""
        self.unpacked_bytes += count
        if self.unpacked_bytes > FREE_BYTES + self.bytes_per_byte * file_bytes:
            raise DamageError(
                f"its first {file_bytes} bytes unpack to more than {self.unpacked_bytes >> 20} MiB; {NOT_A_RECORDING}"
            )

    def take_record(self, file_bytes: int) -> None:
        """Count a message or a line in the first `file_bytes` of the file. Raises DamageError."""
        self.records += 1
        if self.records > self.free_records + file_bytes // BYTES_PER_RECORD:
            raise DamageError(
                f"its first {file_bytes} bytes have more than {self.records - 1} records; {NOT_A_RECORDING}"
            )


def is_packed(path: Path) -> bool:
    """Whether the file is packed by Zstandard."""
    with path.open("rb") as file:
        return file.read(len(ZSTD_MAGIC)) == ZSTD_MAGIC


@contextmanager
def unpacked(path: Path) -> Iterator[Path]:
    """The file at `path`, or a temporary copy without the packing if it is packed by Zstandard.

    Raises DamageError if it is damaged, or unpacks to far more than its size.
    """
    if not is_packed(path):
        yield path
        return
    with path.open("rb") as file, TemporaryDirectory(prefix="gridtrack-unpacked-") as folder:
        copy, budget = Path(folder) / path.name.removesuffix(".zstd"), ReadBudget()
        try:
            with (
                zstandard.ZstdDecompressor().stream_reader(file, read_across_frames=True) as content,
                atomic_write(copy) as out,
            ):
                while block := content.read(UNPACKED_BLOCK_BYTES):
                    budget.take_bytes(len(block), file.tell())
                    out.write(block)
        except zstandard.ZstdError as error:
            raise DamageError(f"{path.name}: damaged ({error})") from None
        yield copy


class FileEnds(Exception):
    """The current end of a growing file, when its reader does not wait for more."""


def _no_more() -> bool:
    return False


@dataclass
class Growth:
    """How to read a file that may still be written.

    At the end of the file `more()` may wait for more bytes; it returns whether to read on. By default the present
    content is read. Bytes from `limit` on are not read, and sensors outside of `sensors` are left out; None: no limit,
    all sensors. `position` is the number of bytes read last; `cut`: the file ended there before its writer closed it.
    """

    more: Callable[[], bool] = _no_more
    limit: int | None = None
    sensors: frozenset[str] | None = None
    position: int = 0
    cut: bool = False

    def open(self, path: Path) -> GrowingFile:
        """The file at `path`, from its first byte. Raises OSError."""
        return GrowingFile(path, self)


class GrowingFile:
    """A file that grows: a read returns all requested bytes, and waits for them according to its Growth."""

    def __init__(self, path: Path, growth: Growth) -> None:
        self._file, self._growth = path.open("rb"), growth
        growth.cut = False

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()

    def read(self, size: int) -> bytes:
        """The next `size` bytes. Raises FileEnds if they are missing and the reader does not wait."""
        content = bytearray()
        while len(content) < size:
            found = self._file.read(self._readable(size - len(content)))
            self._growth.position = self._file.tell()
            content += found
            if not found and not self._growth.more():
                self._growth.cut = True
                raise FileEnds
        return bytes(content)

    def tell(self) -> int:
        """The position, bytes."""
        return self._file.tell()

    def _readable(self, size: int) -> int:
        limit = self._growth.limit
        return size if limit is None else max(0, min(size, limit - self._file.tell()))

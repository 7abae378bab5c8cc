"""A budget for reading a compressed file: what it may unpack to, in proportion to its own bytes.

A recording's scans compress to a tenth, and a message takes tens of bytes. Ten kilobytes that unpack to 200 MB, or to
millions of empty messages, are no recording, and would take minutes of processor time.
"""

from __future__ import annotations

from dataclasses import dataclass

from gridtrack.recordings.recording import DamageError

FREE_BYTES, BYTES_PER_BYTE = 64 << 20, 100
"""Limit of the bytes that a file unpacks to: so many, and so many more for each of its own bytes."""
FREE_RECORDS, BYTES_PER_RECORD = 200_000, 2
"""Limit of its records (messages, lines): so many, and one more for so many of its own bytes."""
NOT_A_RECORDING = "no recording is compressed so far: import it from a trusted copy"


@dataclass
class ReadBudget:
    """What one pass over a file has unpacked, and its limits."""

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
        """Count a message or a line of the first `file_bytes` of the file. Raises DamageError."""
        self.records += 1
        if self.records > self.free_records + file_bytes // BYTES_PER_RECORD:
            raise DamageError(
                f"its first {file_bytes} bytes have more than {self.records - 1} records; {NOT_A_RECORDING}"
            )

"""All readers of untrusted input, by name."""

from __future__ import annotations

from fuzz import recording_readers, result_readers, wire_readers
from fuzz.reader import Reader

READERS: dict[str, Reader] = recording_readers.READERS | wire_readers.READERS | result_readers.READERS

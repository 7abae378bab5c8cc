"""The contract of a recording format: its name, how a file of it is recognised, and how it is opened."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from gridtrack.recordings.read_options import ReadOptions
from gridtrack.recordings.recording import Recording


@dataclass(frozen=True, slots=True)
class RecordingFormat:
    """One format of recordings.

    A distribution registers it in the entry point group `gridtrack.recordings` as `NAME = "package.module:FORMAT"`. The
    module is loaded whenever a recording is opened that no earlier format recognises, so it imports heavy libraries
    only inside `open`.
    """

    name: str
    """For messages, in the singular: `ROS 1 bag`."""
    suffixes: tuple[str, ...]
    """Usual ends of the file names. They suggest a name for a missing file; `recognises` decides."""
    recognises: Callable[[Path, bytes], bool]
    """Whether a file or folder is of this format, from its path and its first HEAD_BYTES bytes (none for a folder)."""
    open: Callable[[Path, ReadOptions], Recording]
    """The recording at a path of this format, nothing of its scans read yet. Raises RecordingError."""
    options: tuple[str, ...] = ("topic",)
    """The fields of ReadOptions that the format can use; `strict` and `zero_range` hold for every format."""
    can_grow: bool = False
    """Whether a file can be read while it is written: its recordings read it by their `growth`."""


HEAD_BYTES = 16

"""Recording formats: what a format is, and the registry of the installed ones."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from pathlib import Path

from gridtrack.common.entry_points import Registration, registrations
from gridtrack.common.errors import PluginError
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


FORMAT_GROUP = "gridtrack.recordings"


class FormatRegistry:
    """The installed formats, each loaded when its turn comes: those of gridtrack first, then the others by name.

    A format that cannot be loaded, that two distributions register, or that fails on a file, is left out; `problems`
    holds one line for each.
    """

    def __init__(self) -> None:
        found = registrations(FORMAT_GROUP).values()
        self._registrations = sorted(found, key=lambda entry: entry.distribution_name != "gridtrack")
        self._loaded: dict[str, RecordingFormat] = {}
        self.problems: list[str] = []
        for entry in found:
            if entry.problem:
                self._note(f"{_described(entry)}: {entry.problem}")

    def recognising(self, path: Path, head: bytes) -> RecordingFormat | None:
        """The first format that recognises the file at `path`, whose first bytes are `head`; None where none does."""
        return next((found for found in self.formats() if self._recognises(found, path, head)), None)

    def formats(self) -> Iterator[RecordingFormat]:
        """All formats that can be loaded."""
        for entry in self._registrations:
            if entry.name not in self._loaded:
                try:
                    self._loaded[entry.name] = load_format(entry)
                except PluginError as error:
                    self._note(str(error))
                    continue
            yield self._loaded[entry.name]

    def _recognises(self, found: RecordingFormat, path: Path, head: bytes) -> bool:
        try:
            return found.recognises(path, head)
        except Exception as error:  # noqa: BLE001  a plugin's failure must not stop the other formats
            self._note(f"{found.name}: its `recognises` failed on {path} ({type(error).__name__}: {error})")
            return False

    def _note(self, problem: str) -> None:
        line = " ".join(problem.split())
        if line not in self.problems:
            self.problems.append(line)


def load_format(entry: Registration) -> RecordingFormat:
    """Import a registered format. Raises PluginError, which names the format, its distribution and the reason."""
    where = _described(entry)
    if entry.problem:
        raise PluginError(f"{where}: {entry.problem}")
    try:
        found = EntryPoint(entry.name, entry.value, FORMAT_GROUP).load()
    except (Exception, SystemExit) as error:
        raise PluginError(f"{where} cannot be imported ({type(error).__name__}: {error})") from error
    if not isinstance(found, RecordingFormat):
        raise PluginError(f"{where}: {entry.value} is not a gridtrack.recordings.registry.RecordingFormat")
    return found


def _described(entry: Registration) -> str:
    return f"recording format '{entry.name}' of {entry.distribution}"

"""Recording formats: the definition of a format, and the registry of the installed ones."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from pathlib import Path

from gridtrack.common.entry_points import Registration, registrations
from gridtrack.common.errors import PluginError, did_you_mean
from gridtrack.recordings.read_options import ReadOptions
from gridtrack.recordings.recording import Recording

FORMAT_GROUP, OWN_DISTRIBUTION = "gridtrack.recordings", "gridtrack"
HEAD_BYTES = 64


@dataclass(frozen=True, slots=True)
class RecordingFormat:
    """One format of recordings.

    A distribution registers it in the entry point group `gridtrack.recordings` as `NAME = "package.module:FORMAT"`.
    """

    name: str
    """For messages, in the singular: `ROS 1 bag`."""
    suffixes: tuple[str, ...]
    """Usual ends of the file names, to suggest a name for a missing file; `recognises` decides."""
    recognises: Callable[[Path, bytes], bool]
    """Whether a file or folder has this format, from its path and its first HEAD_BYTES bytes (none for a folder)."""
    open: Callable[[Path, ReadOptions], Recording]
    """The recording at a path; reads no scans yet. Raises RecordingError."""
    options: tuple[str, ...] = ("topic",)
    """The fields of ReadOptions that the format can use; `format`, `strict`, `no_return`, `range_limits` and
    `angles` hold for every format."""
    can_grow: bool = False
    """Whether a file can be read while it is written: its recordings read it by their `growth`."""


class FormatRegistry:
    """The formats of gridtrack, and before them the format `named`, of any distribution. Each is loaded at its turn.

    Code of another distribution thus runs only if the user names its format. `problems` has one line for each format
    that cannot be loaded, is registered twice, or fails on a file.
    """

    def __init__(self, named: str | None = None) -> None:
        """Raises PluginError if the format `named` is unknown or cannot be loaded."""
        installed = registrations(FORMAT_GROUP)
        # "gridtrack 1.0", or "gridtrack 1.0 and other 2.0" for a name that both register
        own = [entry for entry in installed.values() if OWN_DISTRIBUTION in entry.distribution.split()]
        self._registrations = [entry for entry in own if entry.name != named]
        self._loaded: dict[str, RecordingFormat] = {}
        self.problems: list[str] = []
        if named is not None:
            if named not in installed:
                raise PluginError(f"no recording format '{named}'; {did_you_mean(named, installed)}")
            self._registrations.insert(0, installed[named])
            self._loaded[named] = load_format(installed[named])

    def recognising(self, path: Path, head: bytes) -> RecordingFormat | None:
        """The first format that recognises the file at `path`, which begins with `head`; None without any."""
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
        except Exception as error:  # noqa: BLE001  the failure of one format must not stop the others
            self._note(f"{found.name}: its `recognises` failed on {path} ({type(error).__name__}: {error})")
            return False

    def _note(self, problem: str) -> None:
        line = " ".join(problem.split())
        if line not in self.problems:
            self.problems.append(line)


def load_format(entry: Registration) -> RecordingFormat:
    """Import a registered format. Raises PluginError with the format, its distribution and the reason."""
    where = f"recording format '{entry.name}' of {entry.distribution}"
    if entry.problem:
        raise PluginError(f"{where}: {entry.problem}")
    try:
        found = EntryPoint(entry.name, entry.value, FORMAT_GROUP).load()
    except (Exception, SystemExit) as error:
        raise PluginError(f"{where} cannot be imported ({type(error).__name__}: {error})") from error
    if not isinstance(found, RecordingFormat):
        raise PluginError(f"{where}: {entry.value} is not a gridtrack.recordings.RecordingFormat")
    return found

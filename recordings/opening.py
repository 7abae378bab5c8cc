"""Opening a recording in any format, by its path or its name in the package."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import Any

from gridtrack.common.config import validated
from gridtrack.common.errors import GridtrackError, RecordingError, did_you_mean
from gridtrack.common.files import LFS_POINTER, NOT_PULLED, check_utf8, open_regular
from gridtrack.common.options import option_fields
from gridtrack.recordings.file_reading import Growth
from gridtrack.recordings.read_options import ReadOptions
from gridtrack.recordings.recording import Recording
from gridtrack.recordings.registry import HEAD_BYTES, FormatRegistry, RecordingFormat


def open_recording(path: Path | str, *, growth: Growth | None = None, **options: Any) -> Recording:
    """The recording at `path`, in any format; only the beginning of the file is read yet.

    `options` are the fields of ReadOptions. `growth` is for a file that is still being written. Raises RecordingError,
    PluginError and ConfigurationError.

    >>> from gridtrack.recordings import open_recording, packaged_recording
    >>> recording = open_recording(packaged_recording("leg_tracker"))
    >>> recording.info.site, recording.survey.rate_hz, next(recording.scans()).ranges.shape
    ('leg_tracker', 10.0, (512,))
    """
    path = Path(path)
    check_utf8(path, RecordingError)
    given = validated(ReadOptions, options, str(path))
    registry = FormatRegistry(given.format)
    recording_format = registry.recognising(path, _head(path, registry))
    if recording_format is None:
        raise RecordingError(f"{path}: {_why_unknown(path, registry)}")
    for option in option_fields(ReadOptions):
        (field,), purpose = option.path, option.own.purpose
        if purpose and field in given.given and field not in recording_format.options:
            raise RecordingError(
                f"{path}: --{option.name} is for {purpose}; a {recording_format.name} has no use for it: leave it out"
            )
    if growth is not None:
        _require_growing(path, recording_format)
    recording = _opened(path, recording_format, given)
    recording.growth = growth
    for problem in registry.problems:
        recording.notify(problem)
    return recording


def _require_growing(path: Path, recording_format: RecordingFormat) -> None:
    """Raise RecordingError for a recording that cannot be read while it is written."""
    if path.is_dir():
        raise RecordingError(f"{path}: a folder cannot be followed: name the MCAP file in it that is being written")
    if not recording_format.can_grow:
        raise RecordingError(
            f"{path}: a {recording_format.name} cannot be followed while it is written: record MCAP (`ros2 bag record"
            " --storage mcap`), or compare the finished file without --follow"
        )


def _opened(path: Path, recording_format: RecordingFormat, options: ReadOptions) -> Recording:
    try:
        return recording_format.open(path, options)
    except GridtrackError:
        raise
    except Exception as error:
        reason = f"{type(error).__name__}: {error}"
        raise RecordingError(f"{path}: cannot be opened as {recording_format.name} ({reason})") from error


def _head(path: Path, registry: FormatRegistry) -> bytes:
    """The first bytes of a file, none for a folder. Raises RecordingError."""
    if path.is_dir():
        return b""
    try:
        with open_regular(path) as file:
            return file.read(HEAD_BYTES)
    except FileNotFoundError:
        candidates = _recordings_in(path.parent, registry) if path.parent.is_dir() else []
        suggestion = f"; {did_you_mean(path.name, candidates)}" if candidates else ""
        raise RecordingError(f"{path}: no such recording{suggestion}") from None
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error.strerror})") from None


def _recordings_in(folder: Path, registry: FormatRegistry) -> list[str]:
    """Names in `folder` that look like recordings: files by their suffix, folders by their content."""
    suffixes = tuple(suffix for found in registry.formats() for suffix in found.suffixes)
    return [
        path.name
        for path in folder.iterdir()
        if (registry.recognising(path, b"") if path.is_dir() else path.name.endswith(suffixes))
    ]


def recordings_at(path: Path, format: str | None = None) -> list[Path]:
    """`path`, or all recordings in a folder of recordings, sorted by name. Raises RecordingError without any.

    A folder that is itself a recording, such as a ROS 2 bag, is one recording; its files then have the same format.
    `format`: as in ReadOptions.
    """
    if not path.is_dir():
        return [path]
    registry = FormatRegistry(format)
    own = registry.recognising(path, b"")
    found = [path / name for name in sorted(_recordings_in(path, registry))]
    if own and all(registry.recognising(file, _head(file, registry)) in (own, None) for file in found):
        return [path]
    if not found:
        raise RecordingError(f"{path}: no recording in this folder")
    return found


OTHER_FILES = {
    LFS_POINTER: NOT_PULLED,
    b"<": "an HTML or XML page, not the recording: download it again",
    b"{": "JSON, not a recording",
    b"[": "JSON, not a recording",
    b"\x1f\x8b": "packed by gzip: unpack it with `gunzip`",
    b"BZh": "packed by bzip2: unpack it with `bunzip2`",
    b"\x28\xb5\x2f\xfd": "packed by Zstandard: unpack it with `zstd -d`",
    b"PK\x03\x04": "a ZIP archive: unpack it",
    b"\x75\x73\x74\x61\x72": "a tar archive: unpack it",
    **dict.fromkeys((b"#ROSBAG V1", b"#ROSRECORD V1"), "a ROS bag of format 1: convert it with `rosbag fix`"),
}
"""Kind of a file that no format reads, by its first bytes, and the remedy."""


def _why_unknown(path: Path, registry: FormatRegistry) -> str:
    known = ", ".join(f"{found.name} ({', '.join(found.suffixes)})" for found in registry.formats())
    broken = f"; not available: {'; '.join(registry.problems)}" if registry.problems else ""
    if path.is_dir():
        return f"a folder, but not a recording (a ROS 2 bag has metadata.yaml): name a file in it{broken}"
    head = _head(path, registry)
    if not head:
        return f"an empty file: copy it again from its origin{broken}"
    if found := next((text for magic, text in OTHER_FILES.items() if head.lstrip().startswith(magic)), ""):
        return f"{found}{broken}"
    return (
        f"not a recording that gridtrack reads; formats: {known}, or a format of another package by --format"
        f" NAME{broken}"
    )


def packaged_recording(name: str) -> Path:
    """The file of a recording in the gridtrack package, such as `leg_tracker` or `worlds/test/indoors-room-1008`.

    Raises RecordingError.
    """
    data = Path(str(files("gridtrack.data")))
    known = {_packaged_name(path, data): path for path in (*data.rglob("*.mcap"), *data.rglob("*.tracks"))}
    if name not in known:
        raise RecordingError(f"no recording '{name}' in the package; {did_you_mean(name, known)}")
    return known[name]


def _packaged_name(path: Path, data: Path) -> str:
    """The folder's name if the file has the same, else both."""
    folder = path.parent.relative_to(data).as_posix()
    return folder if path.stem == folder else f"{folder}/{path.stem}"

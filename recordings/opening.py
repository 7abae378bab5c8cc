"""Opening a recording in any registered format."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

from gridtrack.common.config import validated
from gridtrack.common.errors import GridtrackError, RecordingError, did_you_mean
from gridtrack.common.files import check_utf8
from gridtrack.recordings.file_reading import Growth
from gridtrack.recordings.read_options import CloudSlice, Mount, ReadOptions
from gridtrack.recordings.recording import Recording
from gridtrack.recordings.registry import HEAD_BYTES, FormatRegistry, RecordingFormat

OPTION_PURPOSE = {
    "topic": "--topic is for recordings with several topics",
    "cloud_slice": "--cloud-slice is for ROS recordings with point clouds",
    "pose_topic": "--pose-topic is for recordings whose poses are on topics of their own (ROS, Foxglove)",
    "mounts": "--mount is for recordings whose scans name their frame (ROS, Foxglove)",
}


def open_recording(
    path: Path | str,
    *,
    topic: str | None = None,
    strict: bool = False,
    cloud_slice: CloudSlice | None = None,
    pose_topic: str | None = None,
    mounts: Sequence[Mount] = (),
    zero_range: str | None = None,
    growth: Growth | None = None,
) -> Recording:
    """The recording at `path`, in any format; nothing but the beginning of the file is read yet.

    `topic` keeps one sensor of several; of ROS recordings `cloud_slice` says how a PointCloud2 topic becomes a scan,
    `pose_topic` where the poses of what carries the sensors are ("none": they stand still), and `mounts` their places
    on it, where the transforms in the recording do not tell; `zero_range` is the meaning of a range of 0.0, "free" or
    "unknown"; `strict` turns what would be a warning into an error; `growth` is that of a file that is still being
    written. Raises RecordingError and ConfigurationError.
    """
    path = Path(path)
    check_utf8(path, RecordingError)
    given = {
        "topic": topic,
        "strict": strict,
        "cloud_slice": cloud_slice,
        "pose_topic": pose_topic,
        "mounts": tuple(mounts),
        "zero_range": zero_range,
    }
    options = validated(ReadOptions, given, str(path))
    registry = FormatRegistry()
    recording_format = registry.recognising(path, _head(path, registry))
    if recording_format is None:
        raise RecordingError(_why_unknown(path, registry))
    for name, purpose in OPTION_PURPOSE.items():
        if getattr(options, name) not in (None, ()) and name not in recording_format.options:
            raise RecordingError(f"{path}: {purpose}; a {recording_format.name} has no use for it: leave it out")
    if growth is not None:
        _require_growing(path, recording_format)
    recording = _opened(path, recording_format, options)
    recording.growth = growth
    for problem in registry.problems:
        recording.notify(problem)
    return recording


def _require_growing(path: Path, recording_format: RecordingFormat) -> None:
    """Raise RecordingError for what cannot be read while it is written."""
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
        with path.open("rb") as file:
            return file.read(HEAD_BYTES)
    except FileNotFoundError:
        candidates = _recordings_in(path.parent, registry) if path.parent.is_dir() else []
        suggestion = f"; {did_you_mean(path.name, candidates)}" if candidates else ""
        raise RecordingError(f"{path}: no such recording{suggestion}") from None
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error.strerror})") from None


def _recordings_in(folder: Path, registry: FormatRegistry) -> list[str]:
    """Names in `folder` that look like recordings: by the end of a file's name, by the content of a folder."""
    suffixes = tuple(suffix for found in registry.formats() for suffix in found.suffixes)
    return [
        path.name
        for path in folder.iterdir()
        if (registry.recognising(path, b"") if path.is_dir() else path.name.endswith(suffixes))
    ]


def recordings_at(path: Path) -> list[Path]:
    """`path`, or where it is a folder of recordings, all of them sorted by name. Raises RecordingError without any.

    A folder that is itself a recording, such as a ROS 2 bag, is one; its files are then of the same format.
    """
    if not path.is_dir():
        return [path]
    registry = FormatRegistry()
    own = registry.recognising(path, b"")
    found = [path / name for name in sorted(_recordings_in(path, registry))]
    if own and all(registry.recognising(file, _head(file, registry)) in (own, None) for file in found):
        return [path]
    if not found:
        raise RecordingError(f"{path}: no recording in this folder")
    return found


def _why_unknown(path: Path, registry: FormatRegistry) -> str:
    known = ", ".join(f"{found.name} ({', '.join(found.suffixes)})" for found in registry.formats())
    broken = f"; not available: {'; '.join(registry.problems)}" if registry.problems else ""
    if path.is_dir():
        return f"{path}: a folder that is no recording (a ROS 2 bag has metadata.yaml): name a recording's file{broken}"
    return f"{path}: not a recording that gridtrack reads; formats: {known}{broken}"


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
    """The folder's name where the file has the same, else both."""
    folder = path.parent.relative_to(data).as_posix()
    return folder if path.stem == folder else f"{folder}/{path.stem}"

"""Opening a recording in whatever format it is in; formats that need an extra are loaded when they are met."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

from gridtrack.common.errors import RecordingError, did_you_mean
from gridtrack.common.recordings.carmen import CarmenLog
from gridtrack.common.recordings.mcap_file import MAGIC as MCAP_MAGIC
from gridtrack.common.recordings.mcap_file import McapFile
from gridtrack.common.recordings.native import NativeRecording
from gridtrack.common.recordings.recording import DamageError, Recording
from gridtrack.common.recordings.rosbag1 import MAGIC as ROS1_MAGIC

if TYPE_CHECKING:
    from gridtrack.common.recordings.ros_messages import CloudSlice

SQLITE_MAGIC = b"SQLite format 3\x00"
CARMEN_SUFFIXES = (".clf", ".clf.bz2", ".log", ".log.bz2")


def open_recording(
    path: Path | str, *, topic: str | None = None, strict: bool = False, cloud_slice: CloudSlice | None = None
) -> Recording:
    """The recording at `path`, whatever its format; nothing but its first bytes is read yet.

    `topic` keeps one sensor of several; `cloud_slice` says how a PointCloud2 topic becomes a scan; `strict` turns
    what would be a warning into an error. Raises RecordingError.
    """
    path = Path(path)
    if _is_native(path):
        return NativeRecording(path, topic, strict)
    if _is_carmen(path):
        return CarmenLog(path, topic, strict)
    return _open_ros(path, topic, strict, cloud_slice)


def _open_ros(path: Path, topic: str | None, strict: bool, cloud_slice: CloudSlice | None) -> Recording:
    head = _head(path)
    if not (path.is_dir() or head.startswith((MCAP_MAGIC, ROS1_MAGIC, SQLITE_MAGIC))):
        kinds = "MCAP, ROS 1 bag, ROS 2 bag or CARMEN log (.clf, .clf.bz2)"
        raise RecordingError(f"{path}: not a recording that gridtrack reads: {kinds}")
    from gridtrack.common.recordings import ros

    if head.startswith(ROS1_MAGIC):
        return ros.Ros1Bag(path, topic, strict, cloud_slice)
    if head.startswith(MCAP_MAGIC) or (path.is_dir() and ros.is_ros2_folder_of_mcap(path)):
        return ros.RosMcap(path, topic, strict, cloud_slice)
    return ros.Ros2Bag(path, topic, strict, cloud_slice)


def _head(path: Path) -> bytes:
    """The first bytes of a file, none for a folder. Raises RecordingError."""
    if path.is_dir():
        return b""
    try:
        with path.open("rb") as file:
            return file.read(16)
    except FileNotFoundError:
        near = did_you_mean(path.name, (p.name for p in path.parent.iterdir())) if path.parent.is_dir() else ""
        raise RecordingError(f"{path}: no such recording; {near}") from None
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error.strerror})") from None


def _is_native(path: Path) -> bool:
    """Whether it is an MCAP file whose messages are not ROS messages."""
    if not _head(path).startswith(MCAP_MAGIC):
        return False
    file = McapFile(path)
    try:
        first = next(file.messages(), None)
    except DamageError:
        first = None
    return "gridtrack" in file.metadata or first is None or first.schema.encoding == "protobuf"


def _is_carmen(path: Path) -> bool:
    return path.is_file() and path.name.endswith(CARMEN_SUFFIXES)


def packaged_recording(name: str) -> Path:
    """The file of a recording that gridtrack brings along, by its name. Raises RecordingError."""
    data = Path(str(files("gridtrack.data")))
    path = data / name / f"{name}.mcap"
    if not path.is_file():
        known = did_you_mean(name, (p.parent.name for p in data.glob("*/*.mcap")))
        raise RecordingError(f"no recording '{name}' in the package; {known}")
    return path

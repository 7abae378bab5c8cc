"""Opening a recording in whatever format it is in; formats that need an extra are loaded when they are met."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

from gridtrack.common.errors import RecordingError, did_you_mean
from gridtrack.recordings.carmen import CarmenLog
from gridtrack.recordings.mcap_file import MAGIC as MCAP_MAGIC
from gridtrack.recordings.mcap_file import McapFile
from gridtrack.recordings.native import NativeRecording
from gridtrack.recordings.recording import DamageError, Recording
from gridtrack.recordings.rosbag1 import MAGIC as ROS1_MAGIC

if TYPE_CHECKING:
    from gridtrack.recordings.ros_messages import CloudSlice

TRACKS_MAGIC = b"PAR1"
SQLITE_MAGIC = b"SQLite format 3\x00"
CARMEN_SUFFIXES = (".clf", ".clf.bz2", ".log", ".log.bz2")
SUFFIXES = (".mcap", ".tracks", ".bag", ".db3", *CARMEN_SUFFIXES)
"""What the files of recordings are usually called; none is needed to be read."""
ROS2_METADATA = "metadata.yaml"


def open_recording(
    path: Path | str,
    *,
    topic: str | None = None,
    strict: bool = False,
    cloud_slice: CloudSlice | None = None,
    pose_topic: str | None = None,
) -> Recording:
    """The recording at `path`, whatever its format; nothing but its first bytes is read yet.

    `topic` keeps one sensor of several; of ROS recordings `cloud_slice` says how a PointCloud2 topic becomes a scan,
    and `pose_topic` where the sensor's poses are; `strict` turns what would be a warning into an error.
    Raises RecordingError.
    """
    path = Path(path)
    other = _other_than_ros(path, topic, strict)
    if other is None:
        return _open_ros(path, topic, strict, cloud_slice, pose_topic)
    if pose_topic is not None:
        raise RecordingError(f"{path}: --pose-topic is for ROS recordings; one of this format has poses of its own")
    return other


def _other_than_ros(path: Path, topic: str | None, strict: bool) -> Recording | None:
    if _is_native(path):
        return NativeRecording(path, topic, strict)
    if _head(path).startswith(TRACKS_MAGIC):
        from gridtrack.simulation.rendered import RenderedRecording

        return RenderedRecording(path, topic, strict)
    if _is_carmen(path):
        return CarmenLog(path, topic, strict)
    return None


def _open_ros(
    path: Path, topic: str | None, strict: bool, cloud_slice: CloudSlice | None, pose_topic: str | None
) -> Recording:
    head = _head(path)
    if not (path.is_dir() or head.startswith((MCAP_MAGIC, ROS1_MAGIC, SQLITE_MAGIC))):
        kinds = "MCAP, simulated tracks, ROS 1 bag, ROS 2 bag or CARMEN log (.clf, .clf.bz2)"
        raise RecordingError(f"{path}: not a recording that gridtrack reads: {kinds}")
    if path.is_dir() and not _is_ros2_bag(path):
        raise RecordingError(f"{path}: a folder that holds no ROS 2 bag (no {ROS2_METADATA}): name a recording's file")
    from gridtrack.recordings import ros

    if head.startswith(ROS1_MAGIC):
        return ros.Ros1Bag(path, topic, strict, cloud_slice, pose_topic)
    if head.startswith(MCAP_MAGIC) or (path.is_dir() and ros.is_ros2_folder_of_mcap(path)):
        return ros.RosMcap(path, topic, strict, cloud_slice, pose_topic)
    return ros.Ros2Bag(path, topic, strict, cloud_slice, pose_topic)


def _head(path: Path) -> bytes:
    """The first bytes of a file, none for a folder. Raises RecordingError."""
    if path.is_dir():
        return b""
    try:
        with path.open("rb") as file:
            return file.read(16)
    except FileNotFoundError:
        beside = [p.name for p in path.parent.iterdir() if _may_be_one(p)] if path.parent.is_dir() else []
        near = f"; {did_you_mean(path.name, beside)}" if beside else ""
        raise RecordingError(f"{path}: no such recording{near}") from None
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error.strerror})") from None


def _is_ros2_bag(folder: Path) -> bool:
    """Whether a folder holds a ROS 2 bag, or at least the MCAP files of one."""
    return (folder / ROS2_METADATA).is_file() or any(folder.glob("*.mcap"))


def _may_be_one(path: Path) -> bool:
    """Whether it looks like a recording, by its name or as a folder."""
    return (path / ROS2_METADATA).is_file() if path.is_dir() else path.name.endswith(SUFFIXES)


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
    """The file of a recording that gridtrack brings along, such as `leg_tracker` or `junction/train`.

    Raises RecordingError.
    """
    data = Path(str(files("gridtrack.data")))
    known = {_packaged_name(path, data): path for path in (*data.glob("*/*.mcap"), *data.glob("*/*.tracks"))}
    if name not in known:
        raise RecordingError(f"no recording '{name}' in the package; {did_you_mean(name, known)}")
    return known[name]


def _packaged_name(path: Path, data: Path) -> str:
    """The folder's name where the file has the same, else both."""
    folder = path.parent.relative_to(data).as_posix()
    return folder if path.stem == folder else f"{folder}/{path.stem}"

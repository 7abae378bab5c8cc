"""ROS 2 bags kept in SQLite: a folder with its metadata, or one `.db3` file."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import zstandard

from gridtrack.common.files import read_bounded
from gridtrack.common.untrusted import MAX_NESTING
from gridtrack.recordings.file_reading import DamageError, ReadBudget
from gridtrack.recordings.formats.ros_mcap import mcap_files
from gridtrack.recordings.framed_recording import EncodedMessage
from gridtrack.recordings.registry import RecordingFormat
from gridtrack.recordings.ros_recording import ROS_OPTIONS, RosRecording

SQLITE_MAGIC = b"SQLite format 3\x00"
METADATA_FILE = "metadata.yaml"
MAX_METADATA_BYTES = 1 << 20
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
UNPACKED_BLOCK_BYTES = 1 << 20


class Ros2Bag(RosRecording):
    """A ROS 2 bag in SQLite."""

    def messages(self) -> Iterator[EncodedMessage]:
        """All messages in the order of reception. Raises DamageError if the bag is cut off or corrupt."""
        from rosbags.rosbag2 import Reader

        file_bytes = _check_files(self.path)
        budget = ReadBudget()
        try:
            with Reader(self.path) as reader:
                for connection, received_ns, data in reader.messages():
                    budget.take_record(file_bytes)
                    budget.take_bytes(len(data), file_bytes)
                    yield EncodedMessage(connection.topic, connection.msgtype, received_ns, "cdr", data)
        except DamageError:
            raise
        except Exception as error:  # noqa: BLE001  damage makes the reader raise KeyError, TypeError and others, too
            raise DamageError(f"damaged ({type(error).__name__}: {error})") from None


def _check_files(path: Path) -> int:
    """The size of a bag, bytes. Raises DamageError if its metadata or its unpacked files are too large."""
    files = sorted(file for file in path.iterdir() if file.is_file()) if path.is_dir() else [path]
    for file in files:
        if file.name == METADATA_FILE:
            _check_metadata(read_bounded(file, MAX_METADATA_BYTES, DamageError))
        else:
            _check_unpacked(file)
    return sum(file.stat().st_size for file in files)


def _check_metadata(text: bytes) -> None:
    """Raise DamageError for deeply nested YAML, or YAML with aliases, which repeat their content without limit."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError
    from ruamel.yaml.events import AliasEvent, CollectionEndEvent, CollectionStartEvent

    depth = 0
    try:
        for event in YAML(typ="safe").parse(text.decode()):
            depth += isinstance(event, CollectionStartEvent) - isinstance(event, CollectionEndEvent)
            if depth > MAX_NESTING or isinstance(event, AliasEvent):
                raise DamageError(f"{METADATA_FILE} has aliases or is nested deeply; no recorder writes such files")
    except (YAMLError, UnicodeDecodeError) as error:
        raise DamageError(f"{METADATA_FILE} cannot be read ({error})") from None


def _check_unpacked(path: Path) -> None:
    """Raise DamageError if a compressed file unpacks to far more than its size: its reader writes it to the disk."""
    budget = ReadBudget()
    with path.open("rb") as file:
        if file.read(len(ZSTD_MAGIC)) != ZSTD_MAGIC:
            return
        file.seek(0)
        try:
            with zstandard.ZstdDecompressor().stream_reader(file, read_across_frames=True) as unpacked:
                while block := unpacked.read(UNPACKED_BLOCK_BYTES):
                    budget.take_bytes(len(block), file.tell())
        except zstandard.ZstdError as error:
            raise DamageError(f"{path.name}: damaged ({error})") from None


def is_ros2_bag(path: Path, head: bytes) -> bool:
    """Whether it is an SQLite file, or the folder of a ROS 2 bag without MCAP files."""
    if path.is_dir():
        return (path / METADATA_FILE).is_file() and not mcap_files(path)
    return head.startswith(SQLITE_MAGIC)


ROS2_BAG_FORMAT = RecordingFormat("ROS 2 bag", (".db3",), is_ros2_bag, Ros2Bag, ROS_OPTIONS)

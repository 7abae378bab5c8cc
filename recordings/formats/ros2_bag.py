"""ROS 2 bags kept in SQLite: a folder with or without its metadata, or one `.db3` or `.db3.zstd` file.

A recorder that was killed leaves messages in a side file, `.db3-wal`, and no metadata. Such a file is read from a copy,
into which SQLite writes the side file: the bag itself stays as it is.
"""

from __future__ import annotations

import re
import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager, nullcontext
from pathlib import Path
from tempfile import TemporaryDirectory

from gridtrack.common.files import read_bounded
from gridtrack.common.untrusted import MAX_NESTING
from gridtrack.recordings.file_reading import ZSTD_MAGIC, DamageError, ReadBudget, is_packed, unpacked
from gridtrack.recordings.formats.ros_mcap import mcap_files
from gridtrack.recordings.framed_recording import EncodedMessage
from gridtrack.recordings.registry import RecordingFormat
from gridtrack.recordings.ros_recording import ROS_OPTIONS, RosRecording

SQLITE_MAGIC = b"SQLite format 3\x00"
DATABASES = (".db3", ".db3.zstd")
NUMBERED = re.compile(r"(.*)_(\d+)\.db3")
"""The name of a bag and the number of one of its files."""
METADATA_FILE = "metadata.yaml"
MAX_METADATA_BYTES = 1 << 20


class Ros2Bag(RosRecording):
    """A ROS 2 bag in SQLite."""

    def messages(self) -> Iterator[EncodedMessage]:
        """All messages in the order of reception. Raises DamageError if the bag is cut off or corrupt."""
        file_bytes, budget = _checked_size(self.path), ReadBudget()
        for path in _parts(self.path):
            with unpacked(path) if path.is_file() else nullcontext(path) as part, _with_side_file(part) as whole:
                yield from _messages_in(whole, budget, file_bytes)


def _messages_in(path: Path, budget: ReadBudget, file_bytes: int) -> Iterator[EncodedMessage]:
    from rosbags.rosbag2 import Reader

    try:
        with Reader(path) as reader:
            for connection, received_ns, data in reader.messages():
                budget.take_record(file_bytes)
                budget.take_bytes(len(data), file_bytes)
                yield EncodedMessage(connection.topic, connection.msgtype, received_ns, "cdr", data)
    except DamageError:
        raise
    except Exception as error:  # noqa: BLE001  damage makes the reader raise KeyError, TypeError and others, too
        raise DamageError(f"damaged ({type(error).__name__}: {error})") from None


def _parts(path: Path) -> list[Path]:
    """The paths to open, one after the other: the folder, or its files if any is packed or unfinished.

    Raises DamageError.
    """
    folder = path if path.is_dir() else path.parent
    files = databases_in(folder) if path.is_dir() else [path]
    has_copies = any(is_packed(file) or _side_file(file).exists() for file in files)
    if (folder / METADATA_FILE).is_file() and not has_copies and (path.is_dir() or _is_packed_in(folder, path)):
        return [folder]
    return files


@contextmanager
def _with_side_file(file: Path) -> Iterator[Path]:
    """The database, or a temporary copy with the messages that are still in its side file."""
    if not _side_file(file).exists():
        yield file
        return
    with TemporaryDirectory(prefix="gridtrack-bag-") as folder:
        copy = Path(folder) / file.name
        shutil.copyfile(file, copy)
        shutil.copyfile(_side_file(file), _side_file(copy))
        with closing(sqlite3.connect(copy)) as database:
            database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        yield copy


def _is_packed_in(folder: Path, file: Path) -> bool:
    """Whether a file is the only one of a bag with packed messages: its metadata says so. Raises DamageError."""
    from ruamel.yaml import YAML

    _check_metadata(folder / METADATA_FILE)
    try:
        bag = YAML(typ="safe").load(folder / METADATA_FILE)["rosbag2_bagfile_information"]
        has_packed = bool(bag.get("compression_format"))
        names = [Path(name).name for name in bag["relative_file_paths"]]
    except Exception as error:  # noqa: BLE001  the file may be any YAML
        raise DamageError(f"{METADATA_FILE} is not that of a bag ({type(error).__name__}: {error})") from None
    if has_packed and names != [file.name]:
        raise DamageError(f"one file of a bag with packed messages: name the folder {folder}")
    return has_packed


def _side_file(file: Path) -> Path:
    """Where SQLite keeps messages that are not yet in the file."""
    return file.with_name(f"{file.name}-wal")


def databases_in(folder: Path) -> list[Path]:
    """The SQLite files in a folder in the order in which a recorder writes them: bag_2 before bag_10."""

    def number(file: Path) -> tuple[int, str]:
        numbered = NUMBERED.match(file.name)
        return (int(numbered[2]) if numbered else 0, file.name)

    return sorted((file for file in folder.iterdir() if file.name.endswith(DATABASES)), key=number)


def _checked_size(path: Path) -> int:
    """The size of a bag, bytes. Raises DamageError if its metadata are too large."""
    files = [file for file in path.iterdir() if file.is_file()] if path.is_dir() else [path]
    for file in files:
        if file.name == METADATA_FILE:
            _check_metadata(file)
    return sum(file.stat().st_size for file in files)


def _check_metadata(path: Path) -> None:
    """Raise DamageError for large or deeply nested YAML, or with aliases, which repeat their content without limit."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError
    from ruamel.yaml.events import AliasEvent, CollectionEndEvent, CollectionStartEvent

    text, depth = read_bounded(path, MAX_METADATA_BYTES, DamageError), 0
    try:
        for event in YAML(typ="safe").parse(text.decode()):
            depth += isinstance(event, CollectionStartEvent) - isinstance(event, CollectionEndEvent)
            if depth > MAX_NESTING or isinstance(event, AliasEvent):
                raise DamageError(f"{METADATA_FILE} has aliases or is nested deeply; no recorder writes such files")
    except (YAMLError, UnicodeDecodeError) as error:
        raise DamageError(f"{METADATA_FILE} cannot be read ({error})") from None


def _is_one_bag(folder: Path) -> bool:
    """Whether the numbered SQLite files in a folder without metadata have the name of one bag."""
    names = [NUMBERED.match(file.name) for file in databases_in(folder)]
    return len({name and name[1] for name in names}) == 1 and None not in names


def is_ros2_bag(path: Path, head: bytes) -> bool:
    """Whether it is an SQLite file, or the folder of one ROS 2 bag without MCAP files."""
    if path.is_dir():
        return ((path / METADATA_FILE).is_file() or _is_one_bag(path)) and not mcap_files(path)
    return head.startswith(SQLITE_MAGIC) or (path.name.endswith(".db3.zstd") and head.startswith(ZSTD_MAGIC))


ROS2_BAG_FORMAT = RecordingFormat("ROS 2 bag", DATABASES, is_ros2_bag, Ros2Bag, ROS_OPTIONS)

"""ROS 2 bags kept in SQLite: a folder with its metadata, or one `.db3` file."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from gridtrack.recordings.format import RecordingFormat
from gridtrack.recordings.formats.ros_mcap import mcap_files
from gridtrack.recordings.framed_recording import EncodedMessage
from gridtrack.recordings.recording import DamageError
from gridtrack.recordings.ros_recording import ROS_OPTIONS, RosRecording

SQLITE_MAGIC = b"SQLite format 3\x00"
METADATA_FILE = "metadata.yaml"


class Ros2Bag(RosRecording):
    """A ROS 2 bag in SQLite."""

    def messages(self) -> Iterator[EncodedMessage]:
        """All messages in the order of reception. Raises DamageError where the bag is cut off or corrupt."""
        import apsw
        from rosbags.rosbag2 import Reader, ReaderError

        try:
            with Reader(self.path) as reader:
                for connection, received_ns, data in reader.messages():
                    yield EncodedMessage(connection.topic, connection.msgtype, received_ns, "cdr", data)
        except (ReaderError, apsw.Error, FileNotFoundError) as error:
            raise DamageError(f"damaged ({error})") from None


def is_ros2_bag(path: Path, head: bytes) -> bool:
    """Whether it is an SQLite file, or the folder of a ROS 2 bag that is not kept in MCAP files."""
    if path.is_dir():
        return (path / METADATA_FILE).is_file() and not mcap_files(path)
    return head.startswith(SQLITE_MAGIC)


ROS2_BAG_FORMAT = RecordingFormat("ROS 2 bag", (".db3",), is_ros2_bag, Ros2Bag, ROS_OPTIONS)

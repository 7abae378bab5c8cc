"""MCAP files with ROS messages, and ROS 2 bags that are folders of such files."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from gridtrack.recordings.format import RecordingFormat
from gridtrack.recordings.formats.native import is_native
from gridtrack.recordings.mcap_file import MCAP_MAGIC, McapFile
from gridtrack.recordings.ros_messages import RosMessage, ros2_name
from gridtrack.recordings.ros_recording import ROS_OPTIONS, RosRecording


class RosMcap(RosRecording):
    """An MCAP file with ROS messages, or a folder of them as ROS 2 records it."""

    def messages(self) -> Iterator[RosMessage]:
        """All messages in the order of the file. Raises DamageError where it is cut off or corrupt."""
        for path in mcap_files(self.path) if self.path.is_dir() else [self.path]:
            for schema, channel, received_ns, data in McapFile(path).messages():
                yield RosMessage(channel.topic, ros2_name(schema.name), received_ns, channel.message_encoding, data)


def mcap_files(folder: Path) -> list[Path]:
    """The MCAP files of a folder in the order in which they were written: bag_2 before bag_10."""

    def number(file: Path) -> tuple[int, str]:
        digits = re.search(r"(\d+)$", file.stem)
        return (int(digits[1]) if digits else 0, file.name)

    return sorted(folder.glob("*.mcap"), key=number)


def is_ros_mcap(path: Path, head: bytes) -> bool:
    """Whether it is a folder with MCAP files, or an MCAP file that is not a native recording."""
    if path.is_dir():
        return bool(mcap_files(path))
    return head.startswith(MCAP_MAGIC) and not is_native(path, head)


ROS_MCAP_FORMAT = RecordingFormat("ROS MCAP", (".mcap",), is_ros_mcap, RosMcap, ROS_OPTIONS)

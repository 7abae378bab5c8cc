"""MCAP files with ROS or Foxglove messages, and ROS 2 bags that are folders of such files."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from functools import cached_property
from pathlib import Path

from gridtrack.common.errors import RecordingError
from gridtrack.recordings.format import RecordingFormat
from gridtrack.recordings.formats.native import is_native
from gridtrack.recordings.foxglove_messages import (
    FOXGLOVE,
    foxglove_content,
    foxglove_frame,
    foxglove_scan,
    foxglove_transforms,
    longest_range_of,
)
from gridtrack.recordings.framed_recording import Content, EncodedMessage
from gridtrack.recordings.frames.placing import FramedScan
from gridtrack.recordings.frames.tree import StampedTransform
from gridtrack.recordings.mcap_file import MCAP_MAGIC, McapFile
from gridtrack.recordings.recording import DamageError
from gridtrack.recordings.ros_messages import ros2_name
from gridtrack.recordings.ros_recording import ROS_OPTIONS, RosRecording


class RosMcap(RosRecording):
    """An MCAP file with ROS or Foxglove messages, or a folder of them as ROS 2 records it."""

    def messages(self) -> Iterator[EncodedMessage]:
        """All messages in the order of the file. Raises DamageError where it is cut off or corrupt."""
        for path in mcap_files(self.path) if self.path.is_dir() else [self.path]:
            for schema, channel, received_ns, data in McapFile(path, self.growth).messages():
                yield EncodedMessage(channel.topic, ros2_name(schema.name), received_ns, channel.message_encoding, data)

    def content_of(self, message: EncodedMessage) -> Content | None:
        """What a message holds, from its topic and type."""
        if message.kind.startswith(FOXGLOVE):
            return foxglove_content(message) if message.encoding == "protobuf" else None
        return super().content_of(message)

    def is_read(self, message: EncodedMessage) -> bool:
        """Whether the scans of a topic are read: point clouds only where the options name it."""
        is_foxglove = message.kind.startswith(FOXGLOVE)
        return super().is_read(message) or (is_foxglove and self.options.topic in (None, message.topic))

    def frame_of(self, message: EncodedMessage) -> str:
        """The frame of a scan. Raises DamageError."""
        return foxglove_frame(message) if message.kind.startswith(FOXGLOVE) else super().frame_of(message)

    def transforms_of(self, message: EncodedMessage) -> Iterable[StampedTransform]:
        """The transforms of a message, or its pose; `child` is empty where it does not name one. DamageError."""
        is_foxglove = message.kind.startswith(FOXGLOVE)
        return foxglove_transforms(message, self.notify) if is_foxglove else super().transforms_of(message)

    def scan_of(self, message: EncodedMessage) -> FramedScan:
        """A scan and its frame. Raises DamageError."""
        if not message.kind.startswith(FOXGLOVE):
            return super().scan_of(message)
        longest = self._longest_ranges.get(message.topic, 0.0)
        if not longest:
            raise RecordingError(f"topic '{message.topic}': no range of its scans is finite and above 0")
        self.notify(
            f"topic '{message.topic}': its scans have no limits of their ranges; the longest, {longest:.2f} m, is taken"
            " as the limit"
        )
        return foxglove_scan(message, self.sensor_of(message.topic), longest, self.notify)

    @cached_property
    def _longest_ranges(self) -> dict[str, float]:
        """The longest range on each topic with foxglove.LaserScan, metres, from one pass over the file."""
        longest: dict[str, float] = {}
        try:
            for message in self.messages():
                if message.kind.startswith(FOXGLOVE) and self.content_of(message) == "scan":
                    longest[message.topic] = max(longest.get(message.topic, 0.0), longest_range_of(message))
        except DamageError:  # reported when the scans are read
            pass
        return longest


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


ROS_MCAP_FORMAT = RecordingFormat("ROS or Foxglove MCAP", (".mcap",), is_ros_mcap, RosMcap, ROS_OPTIONS, can_grow=True)

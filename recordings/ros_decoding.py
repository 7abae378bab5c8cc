"""ROS messages decoded by the definitions that rosbags ships. Importing this module needs rosbags."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from typing import Any

from gridtrack.common.errors import RecordingError
from gridtrack.recordings.framed_recording import EncodedMessage
from gridtrack.recordings.recording import DamageError
from gridtrack.recordings.ros_messages import TRANSFORMS

try:
    from rosbags.serde import SerdeError
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore
except ImportError:
    raise RecordingError("reading ROS recordings needs rosbags: pip install 'gridtrack[ros]'") from None


class RosDecoder:
    """Decodes the messages of one recording, never by code made from the definitions in the recording itself."""

    @contextmanager
    def decoded(self, message: EncodedMessage) -> Iterator[Any]:
        """The decoded message. Raises DamageError where decoding it, or using it inside the block, fails."""
        try:
            yield self._decode(message)
        except (SerdeError, struct.error, ValueError, IndexError, UnicodeDecodeError) as error:
            raise DamageError(f"corrupt: a message of {message.topic} cannot be decoded ({error})") from None

    def _decode(self, message: EncodedMessage) -> Any:
        if message.encoding == "ros1":
            return self._ros1.deserialize_ros1(message.data, message.kind)
        if message.encoding == "cdr":
            return self._ros2.deserialize_cdr(message.data, message.kind)
        raise RecordingError(f"'{message.topic}' is encoded as '{message.encoding}'; expected ros1 or cdr")

    @cached_property
    def _ros1(self) -> Any:
        store = get_typestore(Stores.ROS1_NOETIC)
        for kind in TRANSFORMS:  # the packages of transforms are not in this store
            store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", kind))
        return store

    @cached_property
    def _ros2(self) -> Any:
        return get_typestore(Stores.LATEST)

"""Stamps in nanoseconds as Protobuf timestamps, and back."""

from __future__ import annotations

from google.protobuf.timestamp_pb2 import Timestamp


def timestamp_of(stamp_ns: int) -> Timestamp:
    """A stamp as a Protobuf timestamp."""
    return Timestamp(seconds=stamp_ns // 1_000_000_000, nanos=stamp_ns % 1_000_000_000)


def nanoseconds_of(timestamp: Timestamp) -> int:
    """A Protobuf timestamp as a stamp in nanoseconds."""
    return int(timestamp.seconds) * 1_000_000_000 + int(timestamp.nanos)

"""Topics and metadata of a native recording, for its reader and its writer."""

from __future__ import annotations

NATIVE_SCHEMA = "1"
METADATA_NAME, WARNINGS_NAME = "gridtrack", "gridtrack.warnings"
REFERENCE_POSE = "/reference_pose"
DEFAULT_SENSOR = "scan"


def topic_name(kind: str, sensor: str) -> str:
    """The topic of this kind (`/scan`, `/labels`, ...) with the messages of `sensor`."""
    return kind if sensor == DEFAULT_SENSOR else f"{kind}/{sensor}"


def is_topic(topic: str, kind: str) -> bool:
    """Whether `topic` is one of `topic_name(kind, sensor)`."""
    return topic == kind or topic.startswith(f"{kind}/")

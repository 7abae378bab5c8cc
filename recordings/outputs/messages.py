"""The messages of output topics, decoded, with their stamps and the poses of their frames in the world.

Every assumption about them is checked: topics and types exist, stamps are those of the scans, frames are joined to the
world. What cannot be used is left out and counted in `Notes`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from gridtrack.common.errors import RecordingError, did_you_mean
from gridtrack.common.geometry import SE2
from gridtrack.recordings.file_reading import DamageError
from gridtrack.recordings.framed_recording import EncodedMessage
from gridtrack.recordings.frames.trajectory import MAX_TILT_RAD, Trajectory
from gridtrack.recordings.frames.transform import SE3
from gridtrack.recordings.frames.tree import frame_name
from gridtrack.recordings.recording import Recording
from gridtrack.recordings.ros_recording import RosRecording, stamp_ns
from gridtrack.recordings.stream import GridStream

EARLIEST_S, LATEST_S = -1.0, 10.0
"""Limits of the median time from stamps to the reception of their messages, seconds: beyond, the clocks differ."""
MAX_REASONS = 10
"""Limit of the shown reasons."""
MAX_OUTPUT_FRAMES = 20
"""Limit of the frames of outputs: the transforms of each take a pass over the file."""
AHEAD_S = -0.05
"""A median time from stamps to reception below this is that of stamps ahead of their scans, seconds."""


@dataclass
class Notes:
    """What the user should know about the outputs: `lines`, and counts of what was left out by reason."""

    lines: list[str] = field(default_factory=list)
    left_out: Counter[str] = field(default_factory=Counter)

    def note(self, line: str) -> None:
        """Add a line, once."""
        if line not in self.lines:
            self.lines.append(line)

    def all_lines(self) -> list[str]:
        """The lines, and one for each of the most frequent reasons."""
        reasons = self.left_out.most_common(MAX_REASONS)
        return [*self.lines, *(f"{reason}: {count} of them are left out" for reason, count in reasons if count)]


class OutputMessage(NamedTuple):
    """A decoded message. `world_T_frame` is the pose of the frame in its header at its stamp."""

    topic: str
    stamp_ns: int
    received_ns: int
    world_T_frame: SE3
    content: Any


class OutputTopics:
    """Topics of a ROS recording with outputs."""

    def __init__(self, stream: GridStream, kinds: Mapping[str, Collection[str]]) -> None:
        """`kinds`: topic -> types of messages that fit. Raises RecordingError for a topic that is missing or unfit."""
        if not isinstance(stream.recording, RosRecording):
            raise RecordingError(f"{stream.recording.path}: no ROS messages: name the bag with the outputs")
        self.recording = stream.recording
        self._topics = frozenset(kinds)
        self._start_ns, self._end_ns = stream.recorded.start_ns, stream.recorded.end_ns
        self._frames = WorldFrames(stream.recording)
        for topic, fitting in kinds.items():
            _check_topic(stream.recording, topic, fitting)

    def messages(self, notes: Notes) -> Iterator[OutputMessage]:
        """The messages that can be used, in the order of the file. Raises RecordingError for an unknown frame."""
        try:
            for message in self.recording.messages():
                if message.topic in self._topics:
                    yield from self._used(message, notes)
        except DamageError as damage:
            notes.note(f"{damage}; the messages after it are left out")

    def _used(self, message: EncodedMessage, notes: Notes) -> Iterator[OutputMessage]:
        topic = message.topic
        try:
            with self.recording.decoded(message) as content:
                headed = content if hasattr(content, "header") else content.info  # a GridMap of ROS 1
                at_ns, frame = stamp_ns(headed), frame_name(str(headed.header.frame_id))
        except DamageError:
            notes.left_out[f"messages on {topic} that cannot be decoded as {message.kind}"] += 1
            return
        if self.recording.options.stamps == "received":
            at_ns = message.received_ns
        elif not at_ns:
            notes.note(f"{topic}: stamps are zero: the time of recording is the stamp of the forecast")
            at_ns = message.received_ns
        if not self._start_ns <= at_ns < self._end_ns:
            notes.left_out[f"messages on {topic} with a stamp before or after the scans"] += 1
            return
        pose = self._frames.pose(topic, frame, at_ns)
        if pose is None:
            reason = f"messages on {topic} without transforms of '{frame}' within 1 s of their stamps"
            notes.left_out[reason] += 1
            return
        yield OutputMessage(topic, at_ns, message.received_ns, pose, content)


class WorldFrames:
    """The poses of frames in the world frame of a recording's sensors."""

    def __init__(self, recording: RosRecording) -> None:
        self._recording, self._chains = recording, recording.chains
        self._transforms: dict[str, dict[Any, Trajectory]] = {}

    def pose(self, topic: str, frame: str, at_ns: int) -> SE3 | None:
        """The pose of a frame at a stamp; None if its transforms are further away than 1 s.

        Raises RecordingError for a frame that nothing joins to the world, named with the `topic` that has it.
        """
        chain = self._chains.to_frame(frame)
        if chain is None:
            world = next(iter(self._chains.of_topic.values())).world
            raise RecordingError(
                f"{self._recording.path}: {topic} is in frame '{frame}', which no transform joins to '{world}', the"
                " frame of the poses: record /tf and /tf_static with it, or name the poses with --pose-topic"
            )
        if frame not in self._transforms:
            if len(self._transforms) == MAX_OUTPUT_FRAMES:
                raise RecordingError(f"{self._recording.path}: {topic} is in more than {MAX_OUTPUT_FRAMES} frames")
            known = self._recording.transforms_of_links([link.key for link in chain.moving])
            if known is None:
                raise RecordingError(f"{self._recording.path}: too many transforms: name a part of the recording")
            self._transforms[frame] = known
        world_T_frame = SE3()
        for link in chain.links:
            found = self._transforms[frame][link.key].at(at_ns) if link.moves else None
            if link.moves and (found is None or not found.near):
                return None
            world_T_frame = world_T_frame @ link.parent_T_child(found.transform if found else None)
        return world_T_frame


def in_plane(world_T_frame: SE3, pose: Any) -> SE2 | None:
    """The planar pose of a geometry_msgs/Pose in a frame; None if it is not finite, upside down or tilted.

    A rotation of all zeros, which some nodes leave unset, is no rotation.
    """
    at, turn = pose.position, pose.orientation
    w = turn.w if any((turn.x, turn.y, turn.z, turn.w)) else 1.0
    frame_T_pose = SE3.of((at.x, at.y, at.z), (turn.x, turn.y, turn.z, w))
    if frame_T_pose is None:
        return None
    placed = (world_T_frame @ frame_T_pose).placement()
    return None if placed.mirrored or placed.tilt_rad > MAX_TILT_RAD else placed.pose


def available_ns(topic: str, stamps_ns: list[int], received_ns: list[int], notes: Notes) -> list[int]:
    """When forecasts were known: their reception, but not before the stamp; the stamp if the clocks differ."""
    delays_s = (np.array(received_ns, np.int64) - np.array(stamps_ns, np.int64)) / 1e9
    median_s = float(np.median(delays_s))
    if not EARLIEST_S <= median_s <= LATEST_S:
        notes.note(
            f"{topic}: messages were recorded {median_s:.1f} s after their stamps, in another clock: each forecast"
            " counts as known at its stamp"
        )
        return stamps_ns
    if median_s < AHEAD_S:
        notes.note(
            f"{topic}: stamps are {-median_s:.2f} s after the messages: a forecast has the stamp of the last scan that"
            " it used, not of the time that it predicts"
        )
    return [max(stamp, received) for stamp, received in zip(stamps_ns, received_ns, strict=True)]


def _check_topic(recording: Recording, topic: str, fitting: Collection[str]) -> None:
    topics = {name: kind for name, (kind, _) in recording.survey.topics.items()}
    if topic not in topics:
        known = [name for name, kind in topics.items() if kind in fitting]
        raise RecordingError(f"{recording.path}: no message on '{topic}'; {did_you_mean(topic, known)}")
    if topics[topic] not in fitting:
        raise RecordingError(f"{recording.path}: '{topic}' is {topics[topic]}; expected {', '.join(fitting)}")

"""A recording whose scans, transforms and poses name their frames: ROS messages, Foxglove messages."""

from __future__ import annotations

import contextlib
from abc import abstractmethod
from collections.abc import Iterable, Iterator
from functools import cached_property
from typing import Literal, NamedTuple

from gridtrack.common.errors import RecordingError
from gridtrack.common.files import name_from
from gridtrack.common.scan import Scan
from gridtrack.recordings.file_reading import DamageError
from gridtrack.recordings.frames.chains import ChainOptions, Chains
from gridtrack.recordings.frames.choice import chosen_chains
from gridtrack.recordings.frames.trajectory import MAX_WHOLE, AllTransforms, FramedScan, ScansOnChains
from gridtrack.recordings.frames.transform import SE3
from gridtrack.recordings.frames.tree import FrameTree, StampedTransform, frame_name
from gridtrack.recordings.read_options import NO_POSES, Mount
from gridtrack.recordings.recording import Recording, Topics
from gridtrack.recordings.recording_info import RecordingInfo

Content = Literal["scan", "transforms", "pose"]
Recorded = tuple[str, str]
"""What is recorded of a link: its source, and the frame whose place it gives."""
STATIC_TRANSFORMS = "tf_static"


class EncodedMessage(NamedTuple):
    """One message of a file, still encoded (`ros1`, `cdr`, `protobuf`); ROS types as ROS 2 writes them."""

    topic: str
    kind: str
    received_ns: int
    encoding: str
    data: bytes


class FramedRecording(Recording):
    """A recording whose messages name their frames.

    One quick pass over the transforms and poses of the whole file chooses the chain of each sensor: static transforms
    may come anywhere in it. A second one reads those of the links that move, which may be far from their scans in a
    file that is finished. Then the scans are read, each with the pose on its chain.
    """

    @abstractmethod
    def messages(self) -> Iterator[EncodedMessage]:
        """All messages in the order of the file. Raises DamageError where it is cut off or corrupt."""

    @abstractmethod
    def content_of(self, message: EncodedMessage) -> Content | None:
        """What a message holds, from its topic and type."""

    @abstractmethod
    def frame_of(self, message: EncodedMessage) -> str:
        """The frame of a scan. Raises DamageError."""

    @abstractmethod
    def scan_of(self, message: EncodedMessage) -> FramedScan:
        """A scan and its frame. Raises DamageError."""

    @abstractmethod
    def transforms_of(self, message: EncodedMessage) -> Iterable[StampedTransform]:
        """The transforms of a message, or its pose; `child` is empty where it does not name one. DamageError."""

    @cached_property
    def info(self) -> RecordingInfo:
        """The metadata of the recording: its file name as `site`, and where its poses come from."""
        stands = self.options.pose_topic == NO_POSES
        poses = self.chains.describe(self._tree, self._sensors, stands=stands)
        return RecordingInfo(site=name_from(self.name), poses=poses)

    @property
    def pose_problem(self) -> str:
        """Why the poses of the sensors cannot be used, and what to do; empty where they can."""
        return self.chains.problem

    def topic_of(self, sensor: str) -> str:
        """The topic with the scans of `sensor`."""
        return f"/{sensor}"

    def sensor_of(self, topic: str) -> str:
        """The name of the sensor with the scans of `topic`."""
        return topic.strip("/") or "scan"

    @cached_property
    def chains(self) -> Chains:
        """The chain of each topic with scans.

        Raises RecordingError for a pose topic that is not there, ConfigurationError for a mount of no sensor.
        """
        return self._chains_in(self._tree)

    def survey_again(self) -> None:
        """As of every recording; the chains stay, and a warning tells where the whole file leads to other ones."""
        super().survey_again()
        whole = self._chains_in(self._read_tree())
        for topic, chain in self.chains.of_topic.items():
            if str(whole.of_topic.get(topic)) != str(chain):
                self.notify(
                    f"sensor '{self.sensor_of(topic)}': the whole file leads to the frames {whole.of_topic.get(topic)};"
                    f" those of its beginning, {chain}, were used: compare the finished file"
                )

    def _chains_in(self, tree: FrameTree) -> Chains:
        options = ChainOptions(self._sensors, self.options.pose_topic, self.options.mounts, self.import_command)
        try:
            return chosen_chains(tree, options)
        except RecordingError as error:
            raise RecordingError(f"{self.path}: {error}") from None

    @cached_property
    def _sensors(self) -> dict[str, str]:
        return {topic: self.sensor_of(topic) for topic in self._tree.sensors}

    @cached_property
    def _tree(self) -> FrameTree:
        return self._read_tree()

    def _read_tree(self) -> FrameTree:
        tree = FrameTree(growing=self.growth is not None)
        with contextlib.suppress(DamageError):  # reported when the scans are read
            for message in self.messages():
                self._add_to(tree, message)
        return tree

    def _add_to(self, tree: FrameTree, message: EncodedMessage) -> None:
        content, topic = self.content_of(message), message.topic
        try:
            if content == "transforms":
                tree.add_transforms(topic, topic.endswith(STATIC_TRANSFORMS), self.transforms_of(message))
            elif content == "pose":
                tree.add_poses(topic, self.transforms_of(message))
            elif content == "scan" and self.is_read(message) and topic not in tree.sensors:
                tree.sensors[topic] = frame_name(self.frame_of(message))
        except DamageError as damage:
            tree.note(f"{damage}; it is left out")

    def read(self, topics: Topics) -> Iterator[Scan]:
        """The scans in the order of the file; counts the messages in `topics`. DamageError where it is damaged."""
        for fault in (*self._tree.faults, *self.chains.faults):
            self.warn(fault)
        for note in self.chains.notes:
            self.notify(note)
        self._tell_shared_frames()
        scans = ScansOnChains(self.chains.of_topic, self.warn, self._known_transforms)
        try:
            for message in self.messages():
                content = self.content_of(message)
                topics.add(message.topic, message.kind, content == "scan")
                if content == "scan" and self.is_read(message):
                    yield from self._placed(scans, message)
                elif self._known_transforms is None:
                    for moved in self._moving_transforms(message):
                        yield from scans.transform(*moved)
        except DamageError:
            yield from scans.flush()
            raise
        yield from scans.flush()

    def _placed(self, scans: ScansOnChains, message: EncodedMessage) -> Iterator[Scan]:
        """The scans that no longer wait when the one in a message is added."""
        framed = self.scan_of(message)
        if frame_name(framed.frame) == self._tree.sensors.get(message.topic):
            yield from scans.scan(framed)
        else:
            self.warn(f"topic '{message.topic}': scans of another frame than the first are left out")

    def _tell_shared_frames(self) -> None:
        """Tell moving sensors that may be one, whose scans are recorded twice: raw and filtered, for example."""
        moving = {topic: self._tree.sensors[topic] for topic, chain in self.chains.of_topic.items() if chain.moving}
        for frame in dict.fromkeys(moving.values()):
            topics = [topic for topic, other in moving.items() if other == frame]
            if len(topics) > 1:
                self.notify(
                    f"{' and '.join(topics[:3])} have scans of one frame, '{frame}': where they are of one sensor,"
                    f" import one of them with `{self.import_command(['--topic', topics[0]])}`"
                )

    def is_mount_of(self, mount: Mount, topic: str) -> bool:
        """As of every recording; a mount may name the frame of the sensor too."""
        return super().is_mount_of(mount, topic) or mount.sensor == self._tree.sensors.get(topic)

    def is_read(self, message: EncodedMessage) -> bool:
        """Whether the scans of a message's topic are read."""
        return self.options.topic in (None, message.topic)

    @cached_property
    def _moving_links(self) -> set[Recorded]:
        return set(self.chains.moving)

    @cached_property
    def _known_transforms(self) -> dict[Recorded, AllTransforms] | None:
        """All transforms of each link that moves; None where they are read along with the scans.

        They are in a file that grows, and in one with more of them than are kept.
        """
        if self.growth is not None:
            return None
        known, count = {recorded: AllTransforms() for recorded in self._moving_links}, 0
        with contextlib.suppress(DamageError):  # reported when the scans are read
            for message in self.messages() if known else ():
                for recorded, stamp_ns, transform in self._moving_transforms(message):
                    known[recorded].add(stamp_ns, transform)
                    count += 1
                if count > MAX_WHOLE:
                    return None
        return known

    def _moving_transforms(self, message: EncodedMessage) -> Iterator[tuple[Recorded, int, SE3]]:
        """The transforms of links that move: what they are of, stamp, transform."""
        content, topic, moving = self.content_of(message), message.topic, self._moving_links
        of_pose = next((recorded for recorded in moving if recorded[0] == topic), None) if content == "pose" else None
        if not moving or (of_pose is None and content != "transforms"):
            return
        with contextlib.suppress(DamageError):  # one of the tree's faults
            for stamped in self.transforms_of(message):
                recorded = of_pose or self._recorded_of(topic, stamped)
                if recorded in moving and stamped.transform is not None:
                    yield recorded, stamped.stamp_ns, stamped.transform

    def _recorded_of(self, topic: str, stamped: StampedTransform) -> Recorded | None:
        """What a transform on a topic is recorded of; None where it is not used."""
        edge = self._tree.edge_with(topic, stamped)
        return None if edge is None else (edge.topic, frame_name(stamped.child))

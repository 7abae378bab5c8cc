"""A recording with coordinate frames in its scans, transforms and poses: ROS messages, Foxglove messages."""

from __future__ import annotations

import contextlib
from abc import abstractmethod
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import cached_property
from typing import Literal, NamedTuple

from gridtrack.common.errors import RecordingError
from gridtrack.common.files import name_from
from gridtrack.common.scan import Scan
from gridtrack.recordings.file_reading import DamageError
from gridtrack.recordings.frames.chains import ChainOptions, Chains, LinkKey
from gridtrack.recordings.frames.choice import chosen_chains
from gridtrack.recordings.frames.trajectory import MAX_TRANSFORMS, AllTransforms, FramedScan, ScansOnChains
from gridtrack.recordings.frames.transform import SE3
from gridtrack.recordings.frames.tree import FrameTree, StampedTransform, frame_name
from gridtrack.recordings.meaning import with_meaning
from gridtrack.recordings.read_options import NO_POSES, Mount
from gridtrack.recordings.recording import Recording, Topics
from gridtrack.recordings.recording_info import RecordingInfo

Content = Literal["scan", "transforms", "pose"]
STATIC_TRANSFORMS = "tf_static"


class EncodedMessage(NamedTuple):
    """One message of a file, still encoded (`ros1`, `cdr`, `protobuf`). `kind` is its type, in ROS 2's notation."""

    topic: str
    kind: str
    received_ns: int
    encoding: str
    data: bytes


class FramedRecording(Recording):
    """A recording with frame names in its messages. A file is read in three passes:

    1. All transforms and poses, to choose the chain of transforms of each sensor; static ones may come anywhere.
    2. The transforms of the moving links of these chains. A file that grows has no second pass.
    3. The scans, each with the pose on its chain.
    """

    @abstractmethod
    def messages(self) -> Iterator[EncodedMessage]:
        """All messages in the order of the file. Raises DamageError if it is cut off or corrupt."""

    @abstractmethod
    def content_of(self, message: EncodedMessage) -> Content | None:
        """The content of a message, from its topic and type."""

    @abstractmethod
    def frame_of(self, message: EncodedMessage) -> str:
        """The frame of a scan. Raises DamageError."""

    @abstractmethod
    def scan_of(self, message: EncodedMessage) -> FramedScan:
        """A scan and its frame. Raises DamageError."""

    @abstractmethod
    def transforms_of(self, message: EncodedMessage) -> Iterable[StampedTransform]:
        """The transforms of a message, or its pose; `child` is empty if the message does not name it. DamageError."""

    @cached_property
    def info(self) -> RecordingInfo:
        """The metadata of the recording: its file name as `site`, and the source of its poses."""
        is_at_rest = self.options.pose_topic == NO_POSES
        poses = self.chains.describe(self._tree, self._sensors, is_at_rest=is_at_rest)
        return RecordingInfo(site=name_from(self.path), poses=poses)

    @property
    def stamp_remedy(self) -> str:
        """As in every recording."""
        return "take the times of reception with --stamps received"

    @property
    def pose_problem(self) -> str:
        """Why the poses of the sensors cannot be used, and what to do; empty if they can."""
        return self.chains.problem

    def topic_of(self, sensor: str) -> str:
        """The topic with the scans of `sensor`."""
        return f"/{sensor}"

    def sensor_of(self, topic: str) -> str:
        """The name of the sensor with the scans of `topic`."""
        return topic.strip("/") or "scan"

    def is_read(self, message: EncodedMessage) -> bool:
        """Whether the scans of a message's topic are read."""
        return self.options.topic in (None, message.topic)

    def is_mount_of(self, mount: Mount, topic: str) -> bool:
        """As in every recording; a mount may also name the frame of the sensor."""
        return super().is_mount_of(mount, topic) or mount.sensor == self._tree.sensors.get(topic)

    @cached_property
    def chains(self) -> Chains:
        """The chain of each topic with scans.

        Raises RecordingError for an unknown pose topic, ConfigurationError for a mount of an unknown sensor.
        """
        return self._chains_in(self._tree)

    def survey_again(self) -> None:
        """As in every recording. The chains are kept, with a warning if the whole file leads to other ones."""
        super().survey_again()
        whole = self._chains_in(self._read_tree())
        for topic, chain in self.chains.of_topic.items():
            if str(whole.of_topic.get(topic)) != str(chain):
                self.notify(
                    f"sensor '{self.sensor_of(topic)}': its transforms in the whole file are"
                    f" {whole.of_topic.get(topic)}; the comparison used those at the beginning of the file, {chain}:"
                    " compare the finished file"
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
        """The scans in the order of the file; counts the messages in `topics`. Raises DamageError at damage."""
        for fault in (*self._tree.faults, *self.chains.faults):
            self.warn(fault)
        for note in self.chains.notes:
            self.notify(note)
        self._note_shared_frames()
        scans = ScansOnChains(self.chains.of_topic, self.warn, self._known_transforms)
        try:
            for message in self.messages():
                content = self.content_of(message)
                topics.add(message.topic, message.kind, content == "scan")
                if content == "scan" and self.is_read(message):
                    yield from self._placed(scans, message)
                elif self._known_transforms is None:
                    for key, stamp_ns, transform in self._moving_transforms(message):
                        yield from scans.transform(key, stamp_ns, transform)
        except DamageError:
            yield from scans.flush()
            raise
        yield from scans.flush()

    def _placed(self, scans: ScansOnChains, message: EncodedMessage) -> Iterator[Scan]:
        """The scans that no longer wait once the scan in a message is added."""
        framed = self.scan_of(message)
        scan = with_meaning(framed.scan, self.options)
        if self.options.stamps == "received":
            scan = replace(scan, stamp_ns=message.received_ns)
        framed = replace(framed, scan=scan)
        if frame_name(framed.frame) == self._tree.sensors.get(message.topic):
            yield from scans.scan(framed)
        else:
            self.warn(f"topic '{message.topic}': scans in another frame than the first scan are left out")

    def _as_options_say(self, scan: Scan) -> Scan:
        """Done before the scan was placed: a mirrored laser has its angles reversed there."""
        return scan

    def _note_shared_frames(self) -> None:
        """Report moving sensors that may be one, with its scans recorded twice: raw and filtered, for example."""
        moving = {topic: self._tree.sensors[topic] for topic, chain in self.chains.of_topic.items() if chain.moving}
        for frame in dict.fromkeys(moving.values()):
            topics = [topic for topic, other in moving.items() if other == frame]
            if len(topics) > 1:
                self.notify(
                    f"{' and '.join(topics[:3])} have scans in one frame, '{frame}': if they are of one sensor, import"
                    f" one of them with `{self.import_command(['--topic', topics[0]])}`"
                )

    @cached_property
    def _moving_links(self) -> set[LinkKey]:
        return set(self.chains.moving)

    @cached_property
    def _known_transforms(self) -> dict[LinkKey, AllTransforms] | None:
        """All transforms of each moving link; None if they are read together with the scans.

        They are in a file that grows, and in one with more than MAX_TRANSFORMS.
        """
        if self.growth is not None:
            return None
        known, count = {key: AllTransforms() for key in self._moving_links}, 0
        with contextlib.suppress(DamageError):  # reported when the scans are read
            for message in self.messages() if known else ():
                for key, stamp_ns, transform in self._moving_transforms(message):
                    known[key].add(stamp_ns, transform)
                    count += 1
                if count > MAX_TRANSFORMS:
                    return None
        return known

    def _moving_transforms(self, message: EncodedMessage) -> Iterator[tuple[LinkKey, int, SE3]]:
        """The transforms of moving links in a message: key of the link, stamp, transform."""
        content, topic, moving = self.content_of(message), message.topic, self._moving_links
        of_pose = next((key for key in moving if key[0] == topic), None) if content == "pose" else None
        if not moving or (of_pose is None and content != "transforms"):
            return
        with contextlib.suppress(DamageError):  # reported among the faults of the tree
            for stamped in self.transforms_of(message):
                key = of_pose or self._key_of(topic, stamped)
                if key in moving and stamped.transform is not None:
                    yield key, stamped.stamp_ns, stamped.transform

    def _key_of(self, topic: str, stamped: StampedTransform) -> LinkKey | None:
        """The key of a transform's link; None if it is not used."""
        edge = self._tree.edge_with(topic, stamped)
        return None if edge is None else (edge.topic, frame_name(stamped.child))

"""A recording with coordinate frames in its scans, transforms and poses: ROS messages, Foxglove messages."""

from __future__ import annotations

import contextlib
import math
import re
from abc import abstractmethod
from collections.abc import Collection, Iterable, Iterator
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Literal, NamedTuple

from gridtrack.common.errors import RecordingError
from gridtrack.common.files import name_from
from gridtrack.common.geometry import wrap_angle
from gridtrack.common.scan import Scan
from gridtrack.recordings.alternation import TwoLasers
from gridtrack.recordings.file_reading import DamageError
from gridtrack.recordings.frames.chains import ChainOptions, Chains, LinkKey
from gridtrack.recordings.frames.choice import chosen_chains
from gridtrack.recordings.frames.trajectory import MAX_TRANSFORMS, FramedScan, ScansOnChains, Trajectory
from gridtrack.recordings.frames.transform import SE3
from gridtrack.recordings.frames.tree import FrameTree, StampedTransform, frame_name
from gridtrack.recordings.meaning import with_meaning
from gridtrack.recordings.people import CarriedFrame, KnownFrames
from gridtrack.recordings.read_options import NO_POSES, Mount
from gridtrack.recordings.recording import Recording, Topics
from gridtrack.recordings.recording_info import RecordingInfo

Content = Literal["scan", "transforms", "pose"]
STATIC_TRANSFORMS = "tf_static"
LASER_NUMBERS = ("1", "2")
"""Names of two lasers on one topic with one frame: TOPIC@1, TOPIC@2."""
PART = re.compile(r"(.*?)((?:\d{4}(?:-\d\d){5})?)_(\d+)(\.[a-z0-9.]+)")
"""The name of a part of a split recording: prefix, time (ROS 1: of each part), number, suffix."""


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
        return f"take the times of reception, with `{self.import_command(['--stamps', 'received'])}`"

    @property
    def pose_problem(self) -> str:
        """Why the poses of the sensors cannot be used, and the remedy; empty if they can."""
        return self.chains.problem

    def topic_of(self, sensor: str) -> str:
        """The topic with the scans of `sensor`."""
        return f"/{sensor}"

    def sensor_of(self, topic: str) -> str:
        """The name of the sensor with the scans of `topic`."""
        return topic.strip("/") or "scan"

    def is_read(self, message: EncodedMessage) -> bool:
        """Whether scans of a message's topic are read: all, or of one laser only (TOPIC@FRAME, TOPIC@1, TOPIC@2)."""
        topic = self.options.topic
        return topic in (None, message.topic) or topic.startswith(f"{message.topic}@")

    def mount_remedy(self, sensor: str, turn_deg: int) -> str:
        """As in every recording."""
        chain = self.chains.of_topic[self.topic_of(sensor)]
        parent, mount_T_sensor = chain.mount
        found = mount_T_sensor.placement()
        heading_rad = wrap_angle(found.pose.theta + math.radians(turn_deg))
        mount = Mount(
            sensor=sensor,
            parent=parent,
            x=round(found.pose.x, 4),
            y=round(found.pose.y, 4),
            heading_rad=math.radians(round(math.degrees(heading_rad), 2)),
            mirrored=found.mirrored,
        )
        return f"give the mount, as in `{self.import_command(['--mount', str(mount)])}`"

    def coordinate_frames(self, sensors: Iterable[str]) -> KnownFrames:
        """The frames at the ends of the chains, and those that carry a sensor rigidly, of the first sensor on them."""
        known: dict[str, CarriedFrame | None] = {}
        for topic, chain in self.chains.of_topic.items():
            sensor, (parent, parent_T_sensor) = self.sensor_of(topic), chain.mount
            known.setdefault(chain.world, None)
            known.setdefault(parent, CarriedFrame(sensor, parent_T_sensor.placement().pose.inverse()))
            if chain.links:
                known.setdefault(chain.links[-1].child, CarriedFrame(sensor, mirrored=chain.mirrored))
        return known

    def separate_lasers_with(self, sensor: str) -> str:
        """As in every recording."""
        one, other = (f"{self.topic_of(sensor)}@{number}" for number in LASER_NUMBERS)
        return f"import one of them with `{self.import_command(['--topic', one])}`, or --topic {other}"

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
        if self.growth is None:
            tree.separate_lasers()
        tree.sensors = self._chosen_of(tree.sensors)
        moves = bool(tree.edges or tree.poses)
        if self.growth is None and moves and not set(tree.sensors.values()) <= set(tree.edges):
            self._add_first_part(tree)
        return tree

    def _chosen_of(self, sensors: dict[str, str]) -> dict[str, str]:
        """The sensors that the option `topic` names."""
        topic = self.options.topic
        if topic is None:
            return sensors
        whole, _, number = topic.rpartition("@")
        if topic not in sensors and whole in sensors and number in LASER_NUMBERS:
            return {topic: sensors[whole]}
        return {topic: sensors[topic]} if topic in sensors else {}

    def _add_first_part(self, tree: FrameTree) -> None:
        """Add the static transforms of a split recording: they are recorded once, in its first part."""
        part = PART.fullmatch(self.path.name)
        if part is None or int(part[3]) == 0:
            return
        if (first := _first_part(self.path, part)) is None:
            self.notify(
                f"part {part[3]} of a split recording, without the place of its sensors: put the first part beside it,"
                " which has the static transforms, or name the whole folder"
            )
            return
        with contextlib.suppress(DamageError):
            for message in type(self)(first, self.options).messages():
                if message.topic.endswith(STATIC_TRANSFORMS):
                    self._add_to(tree, message)
        self.notify(f"its static transforms are from {first.name}")

    def _add_to(self, tree: FrameTree, message: EncodedMessage) -> None:
        content, topic = self.content_of(message), message.topic
        try:
            if content == "transforms":
                tree.add_transforms(topic, topic.endswith(STATIC_TRANSFORMS), self.transforms_of(message))
            elif content == "pose":
                tree.add_poses(topic, self.transforms_of(message))
            elif content == "scan" and self.is_read(message):
                tree.add_scan(topic, self.frame_of(message))
        except DamageError as damage:
            tree.note(f"{damage}; it is left out")

    def read(self, topics: Topics) -> Iterator[Scan]:
        """The scans in the order of the file; counts the messages in `topics`. Raises DamageError at damage."""
        for fault in (*self._tree.faults, *self.chains.faults):
            self.warn(fault)
        for note in self.chains.notes:
            self.notify(note)
        self._note_shared_frames()
        self._note_lasers_on_topics()
        two_lasers = TwoLasers()
        scans = ScansOnChains(self.chains.of_topic, self.warn, self._known_transforms)
        try:
            for message in self.messages():
                content = self.content_of(message)
                topics.add(message.topic, message.kind, content == "scan")
                if content == "scan" and self.is_read(message):
                    yield from self._placed(scans, message, two_lasers)
                elif self._known_transforms is None:
                    for key, stamp_ns, transform in self._transforms_in(message, self._moving_links):
                        yield from scans.transform(key, stamp_ns, transform)
        except DamageError:
            yield from scans.flush()
            raise
        yield from scans.flush()

    def _placed(self, scans: ScansOnChains, message: EncodedMessage, two_lasers: TwoLasers) -> Iterator[Scan]:
        """The scans that no longer wait once the scan in a message is added."""
        framed = self.scan_of(message)
        topic = self._laser_of(message.topic, framed, two_lasers)
        if topic is None:
            scans.count(f"scans on {message.topic} in another frame than the first scan are left out")
        elif topic in self._tree.sensors:
            scan = replace(with_meaning(framed.scan, self.options), sensor=self.sensor_of(topic))
            stamp_ns = self._stamp_of(scan, message)
            yield from scans.scan(replace(framed, topic=topic, scan=replace(scan, stamp_ns=stamp_ns)))

    def _stamp_of(self, scan: Scan, message: EncodedMessage) -> int:
        """The stamp of the first beam, ns, as the options say. Raises RecordingError without the times of beams."""
        if self.options.stamps == "received":
            return message.received_ns
        if self.options.stamps != "end":
            return scan.stamp_ns
        if not scan.time_increment_s:
            raise RecordingError(f"--stamps end: scans on {message.topic} have no time between beams")
        return scan.stamp_ns - round(scan.time_increment_s * (scan.ranges.size - 1) * 1e9)

    def _laser_of(self, topic: str, framed: FramedScan, two_lasers: TwoLasers) -> str | None:
        """The name of the laser of a scan: TOPIC, TOPIC@FRAME, or TOPIC@1 if the option asks for it."""
        frame, asked = frame_name(framed.frame), self.options.topic
        if frame != next(iter(self._tree.scan_frames.get(topic, ())), None):
            laser = f"{topic}@{frame}"
            return laser if laser in self._tree.lasers else None
        if asked in self._tree.sensors and asked in [f"{topic}@{number}" for number in LASER_NUMBERS]:
            return f"{topic}@{two_lasers.number_of(framed.scan)}"
        return topic

    def _note_lasers_on_topics(self) -> None:
        """Report the topics with the scans of several lasers."""
        for topic in self._tree.scan_frames if self.options.topic is None else ():
            lasers = {name: frame for name, frame in self._tree.lasers.items() if name.startswith(f"{topic}@")}
            if lasers:
                frames = ", ".join((self._tree.sensors[topic], *lasers.values()))
                self.notify(
                    f"{topic} has scans in several frames, {frames}: read as several lasers; one alone with --topic"
                    f" {topic} or --topic {next(iter(lasers))}"
                )

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
    def _known_transforms(self) -> dict[LinkKey, Trajectory] | None:
        """All transforms of each moving link; None if they are read together with the scans.

        They are in a file that grows, and in one with more than MAX_TRANSFORMS.
        """
        return None if self.growth is not None else self.transforms_of_links(self._moving_links)

    def transforms_of_links(self, keys: Iterable[LinkKey]) -> dict[LinkKey, Trajectory] | None:
        """All transforms of links that move; None if there are more than MAX_TRANSFORMS."""
        known, count = {key: Trajectory(whole=True) for key in keys}, 0
        with contextlib.suppress(DamageError):  # reported when the scans are read
            for message in self.messages() if known else ():
                for key, stamp_ns, transform in self._transforms_in(message, known):
                    known[key].add(stamp_ns, transform)
                    count += 1
                if count > MAX_TRANSFORMS:
                    return None
        return known

    def _transforms_in(self, message: EncodedMessage, links: Collection[LinkKey]) -> Iterator[tuple[LinkKey, int, SE3]]:
        """The transforms of moving links in a message: key of the link, stamp, transform."""
        content, topic = self.content_of(message), message.topic
        of_pose = next((key for key in links if key[0] == topic), None) if content == "pose" else None
        if not links or (of_pose is None and content != "transforms"):
            return
        with contextlib.suppress(DamageError):  # reported among the faults of the tree
            for stamped in self.transforms_of(message):
                key = of_pose or self._key_of(topic, stamped)
                if key is not None and key in links and stamped.transform is not None:
                    yield key, stamped.stamp_ns, stamped.transform

    def _key_of(self, topic: str, stamped: StampedTransform) -> LinkKey | None:
        """The key of a transform's link; None if it is not used."""
        edge = self._tree.edge_with(topic, stamped)
        return None if edge is None else (edge.topic, frame_name(stamped.child))


def _first_part(path: Path, part: re.Match[str]) -> Path | None:
    """The first part of the recording that has `path` as a later part; None if it is not beside it."""
    beside = [found for file in path.parent.iterdir() if (found := PART.fullmatch(file.name))]
    firsts = [one[0] for one in beside if (one[1], one[3].strip("0"), one[4]) == (part[1], "", part[4])]
    return max((path.with_name(name) for name in firsts if name < path.name), default=None)

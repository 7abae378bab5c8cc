"""Chains of transforms from a world frame down to each sensor."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import takewhile
from typing import NamedTuple

from gridtrack.common.errors import ConfigurationError, RecordingError, did_you_mean
from gridtrack.common.files import is_label
from gridtrack.recordings.frames.transform import SE3
from gridtrack.recordings.frames.tree import BODY_FRAMES, Edge, FrameTree, PoseTopic, frame_name, is_world, last_part
from gridtrack.recordings.read_options import NO_POSES, Mount
from gridtrack.recordings.recording_info import NO_MOTION

LinkKey = tuple[str, str]
"""The source of a link's transforms (a topic or an option), and the child frame in them."""
SHOWN_FRAMES = 8


@dataclass(frozen=True, slots=True)
class ChainOptions:
    """The sensors, and the options of the user about their poses."""

    sensors: dict[str, str]
    """Topic with scans -> name of the sensor."""
    pose_topic: str | None
    mounts: tuple[Mount, ...]
    command: Callable[[Iterable[str]], str]
    """The command that imports the recording with additional options, given as words."""

    @property
    def at_rest(self) -> bool:
        """Whether the user states that the sensors are at rest."""
        return self.pose_topic == NO_POSES


class Link(NamedTuple):
    """The transform `parent_T_child` from `source`, a topic or an option.

    `first` is the transform at its first stamp, and for all times unless the link `moves`. For an `is_inverse` link the
    recording has `child_T_parent`.
    """

    child: str
    parent: str
    source: str
    first: SE3
    moves: bool = False
    is_inverse: bool = False

    @property
    def key(self) -> LinkKey:
        """The source of the transforms, and the child frame in them."""
        return self.source, self.parent if self.is_inverse else self.child

    def inverse(self) -> Link:
        """The link with parent and child exchanged."""
        return Link(self.parent, self.child, self.source, self.first.inverse(), self.moves, not self.is_inverse)

    def parent_T_child(self, recorded: SE3 | None) -> SE3:
        """`parent_T_child` from a transform of the recording; the first one if None."""
        if recorded is None or not self.moves:
            return self.first
        return recorded.inverse() if self.is_inverse else recorded


@dataclass(frozen=True, slots=True)
class Chain:
    """The links from the world frame (first) to the sensor. Without links the sensor defines the world frame."""

    world: str
    links: tuple[Link, ...] = ()

    @property
    def moving(self) -> tuple[Link, ...]:
        """The links that move."""
        return tuple(link for link in self.links if link.moves)

    @property
    def mount(self) -> tuple[str, SE3]:
        """The lowest frame that moves (the world frame if none does), and the pose of the sensor on it."""
        parent, pose = self.world, SE3()
        for link in self.links:
            parent, pose = (link.child, SE3()) if link.moves else (parent, pose @ link.first)
        return parent, pose

    @property
    def mirrored(self) -> bool:
        """Whether the sensor is upside down by the links that do not move."""
        return sum(link.first.placement().mirrored for link in self.links if not link.moves) % 2 == 1

    def __str__(self) -> str:
        frames = [self.world, *(link.child for link in self.links)]
        if len(frames) > SHOWN_FRAMES:
            frames = [*frames[:3], "...", *frames[-3:]]
        return " -> ".join(frames) + (" (mirrored)" if self.mirrored else "")


@dataclass
class Chains:
    """The chain of each topic with scans.

    `problem`: why they cannot be used, and the remedy; empty if they can. `faults` in the transforms of the chains, and
    `notes` about the chains have one line each. `forest` has all frames of the recording.
    """

    of_topic: dict[str, Chain] = field(default_factory=dict)
    problem: str = ""
    notes: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()
    forest: Forest = field(default_factory=lambda: Forest())  # noqa: PLW0108  defined below

    @property
    def moving(self) -> dict[LinkKey, Link]:
        """Every moving link by its key."""
        return {link.key: link for chain in self.of_topic.values() for link in chain.moving}

    def to_frame(self, frame: str) -> Chain | None:
        """The chain from the world frame of the sensors to any frame, below or above it; None if nothing joins them."""
        world = next(iter(self.of_topic.values())).world
        links = self.forest.between(world, frame)
        return None if links is None else Chain(world, links)

    def describe(self, tree: FrameTree, sensors: Mapping[str, str], *, is_at_rest: bool) -> str:
        """One line: the chains, their topics, and the longest gap; empty if the chains cannot be used.

        `sensors` are the names of the sensors by topic; `is_at_rest`: the user states it.
        """
        linked = {topic: chain for topic, chain in self.of_topic.items() if chain.links}
        if not self.of_topic or self.problem:
            return ""
        at_rest = "at rest" if is_at_rest else NO_MOTION
        if not linked:
            return "at rest" if tree.poses else at_rest
        one = len(self.of_topic) == 1
        texts = [str(chain) if one else f"{sensors[topic]}: {chain}" for topic, chain in linked.items()]
        sources = dict.fromkeys(link.source for chain in linked.values() for link in chain.links)
        text = f"{'; '.join(texts)}; from {', '.join(sources)}"
        if gaps := [_longest_gap_ns(link, tree) for link in self.moving.values()]:
            return f"{text}; longest gap {max(gaps) / 1e9:.2f} s"
        shows_rest = any(_is_tracked(link, tree) for chain in linked.values() for link in chain.links)
        return f"{text}; {'at rest' if shows_rest else at_rest}"


def _longest_gap_ns(link: Link, tree: FrameTree) -> int:
    source, frame = link.key
    edge = tree.edge(source, frame)
    motion = tree.poses[source].motion if edge is None else edge.motion
    return motion.longest_gap_ns


def _is_tracked(link: Link, tree: FrameTree) -> bool:
    """Whether the source of a link gives its transform repeatedly, not once for all times."""
    source, frame = link.key
    edge = tree.edge(source, frame)
    return source in tree.poses or (edge is not None and not edge.is_static)


class Forest:
    """Trees of frames: each frame has at most one link to a parent."""

    def __init__(self, links: Iterable[Link] = ()) -> None:
        self._links = {link.child: link for link in links}

    def __contains__(self, child: str) -> bool:
        """Whether a frame has a parent."""
        return child in self._links

    @property
    def links(self) -> list[Link]:
        """All links."""
        return list(self._links.values())

    @property
    def frames(self) -> list[str]:
        """All frames, children before parents in each link."""
        return list(dict.fromkeys(frame for link in self.links for frame in (link.child, link.parent)))

    def put(self, link: Link) -> None:
        """Add a link; it replaces the link of its child."""
        self._links[link.child] = link

    def path(self, frame: str) -> list[str]:
        """The frames from `frame` upwards; in a cycle the last one occurs twice."""
        path, seen = [frame], {frame}
        while (link := self._links.get(path[-1])) is not None:
            path.append(link.parent)
            if link.parent in seen:
                break
            seen.add(link.parent)
        return path

    def rigid_path(self, frame: str) -> list[str]:
        """The frames from `frame` upwards as far as it does not move in them."""
        path = [frame]
        for above in self.path(frame)[1:]:
            if self._links[path[-1]].moves:
                break
            path.append(above)
        return path

    def top(self, frame: str) -> str:
        """The root of the tree with `frame`."""
        return self.path(frame)[-1]

    def moves(self, frame: str) -> bool:
        """Whether a link above a frame moves."""
        return self.moving_above(frame) is not None

    def moving_above(self, frame: str) -> Link | None:
        """The lowest moving link above a frame."""
        above = (self._links[one] for one in self.path(frame) if one in self)
        return next((link for link in above if link.moves), None)

    def chain(self, world: str, sensor: str) -> Chain:
        """The links from `world` down to the frame `sensor` below it."""
        path = self.path(sensor)
        below = path[: path.index(world)]
        return Chain(world, tuple(self._links[child] for child in reversed(below)))

    def between(self, start: str, end: str) -> tuple[Link, ...] | None:
        """The links from `start` up to the frame that both have in common, and down to `end`; None without one."""
        above = self.path(start)
        meeting = next((frame for frame in self.path(end) if frame in above), None)
        if meeting is None:
            return None
        upwards = (self._links[child].inverse() for child in above[: above.index(meeting)])
        return (*upwards, *self.chain(meeting, end).links)

    def make_root(self, frame: str) -> None:
        """Make a frame the root of its tree by inverting the links above it."""
        for link in [self._links.pop(child) for child in self.path(frame)[:-1]]:
            self.put(link.inverse())

    def join(self, link: Link) -> None:
        """Add a link without making a cycle, even if its child has a parent.

        If the child is above the parent, the parent becomes the root first; if it is in another tree, the child does.
        """
        if link.child in self.path(link.parent)[1:]:
            self.make_root(link.parent)
        elif self.top(link.child) != self.top(link.parent):
            self.make_root(link.child)
        self.put(link)


def in_common(paths: Sequence[Sequence[str]]) -> list[str]:
    """The frames that all paths contain, in the order of the first path."""
    others = [set(path) for path in paths[1:]]
    return [frame for frame in (paths[0] if paths else ()) if all(frame in other for other in others)]


class FrameLinks:
    """The frames above each sensor as a forest: the transforms first, then poses and mounts."""

    def __init__(self, tree: FrameTree, options: ChainOptions) -> None:
        self._tree, self._options = tree, options
        self._starts = {topic: _start(tree.sensors[topic], name) for topic, name in options.sensors.items()}
        first = next(iter(options.sensors))
        edges = {child: tree.edge_beside(first, child) for child in tree.edges}
        self.forest = Forest(_link(child, edge) for child, edge in edges.items() if self._may_use(edge))

    @property
    def starts(self) -> Mapping[str, str]:
        """The frame of each topic with scans: the end of its chain."""
        return self._starts

    def add_named_poses(self) -> None:
        """Add the poses of a child that has no parent, if one topic alone has poses of it."""
        poses = self._tree.poses.values()
        for pose in poses if self._options.pose_topic is None else ():
            rivals = [other for other in poses if other.child == pose.child]
            if pose.child and pose.child not in self.forest and len(rivals) == 1:
                self.join(pose, pose.child)

    def add_mounts(self) -> None:
        """Add the mounts that the user gives. Raises ConfigurationError for an unknown sensor."""
        sensors = self._options.sensors
        topics = {name: topic for topic, name in sensors.items()} | {topic: topic for topic in sensors}
        for mount in self._options.mounts:
            frame = frame_name(mount.sensor)
            if mount.sensor in topics:
                topic = topics[mount.sensor]
                frame = self._starts[topic] = sensors[topic]
            elif frame not in self._starts.values():
                known = did_you_mean(mount.sensor, {*sensors.values(), *self._starts.values()})
                raise ConfigurationError(f"--mount {mount}: no sensor '{mount.sensor}'; {known}")
            parent = frame_name(mount.parent) or self._body()
            self.forest.put(Link(frame, parent, "--mount", SE3.in_plane(mount.parent_T_sensor, mount.mirrored)))

    def add_pose_topic(self) -> PoseTopic | None:
        """Add, and return, the topic with poses that the user names. Raises RecordingError if it does not exist."""
        poses, topic = self._tree.poses, self._options.pose_topic
        if topic is None or self._options.at_rest:
            return None
        pose = poses.get(topic)
        if pose is None:
            raise RecordingError(f"no topic '{topic}' with poses; {did_you_mean(topic, poses)}")
        if (child := pose.child or self.carrier()) is not None:
            self.join(pose, child)
        return pose

    def join(self, pose: PoseTopic, child: str) -> None:
        """Link `child` to the frame of a topic's poses."""
        moves = not pose.motion.constant
        self.forest.join(Link(child, parent_of(pose), pose.topic, pose.motion.first, moves))

    def cycle(self) -> Sequence[str] | None:
        """The frames of a cycle above a sensor."""
        for path in self._paths():
            if path[-1] in path[:-1]:
                return path[path.index(path[-1]) :]
        return None

    def common(self) -> list[str]:
        """The frames that the paths of all sensors have in common, from the sensors upwards."""
        return in_common(self._paths())

    def carrier(self) -> str | None:
        """The topmost frame in which no sensor moves; None if they have none in common."""
        common = in_common([self._carried(start) for start in self._starts.values()])
        return common[-1] if common else None

    def chains(self, world: str) -> dict[str, Chain]:
        """The chain of each topic from `world` down to its sensor."""
        return {
            topic: Chain(world, tuple(self._beside(topic, link) for link in self.forest.chain(world, start).links))
            for topic, start in self._starts.items()
        }

    def _may_use(self, edge: Edge) -> bool:
        return not edge.moves or not self._options.at_rest

    def _beside(self, scans: str, link: Link) -> Link:
        """The link from the topic in the namespace of the scans, if several topics have it."""
        source, frame = link.key
        if self._tree.edge(source, frame) is None:
            return link
        edge = self._tree.edge_beside(scans, frame)
        if edge.topic == source or not self._may_use(edge):
            return link
        return _link(frame, edge).inverse() if link.is_inverse else _link(frame, edge)

    def _paths(self) -> list[list[str]]:
        return [self.forest.path(start) for start in self._starts.values()]

    def _carried(self, start: str) -> list[str]:
        """The frames from a sensor upwards as far as it does not move in them, up to a world frame (excluded)."""
        first, *above = self.forest.rigid_path(start)
        return [first, *takewhile(lambda frame: not is_world(frame), above)]

    def _body(self) -> str:
        """The parent of a mount that names none: the child of the pose topic given, else the robot's moving body.

        If no body moves: the child of the only poses that name one, else a body at rest.
        """
        pose = self._tree.poses.get(self._options.pose_topic or "")
        if pose is not None and pose.child:
            return pose.child
        bodies = [frame for body in BODY_FRAMES for frame in self.forest.frames if last_part(frame).endswith(body)]
        moving = [frame for frame in bodies if self.forest.moves(frame)]
        children = dict.fromkeys(pose.child for pose in self._tree.poses.values() if pose.child)
        candidates = moving or (list(children) if len(children) == 1 else []) or bodies
        alike = [frame for frame in candidates if last_part(frame) == last_part(candidates[0])]
        return candidates[0] if len(alike) == 1 else BODY_FRAMES[0]


def parent_of(pose: PoseTopic) -> str:
    """The frame of a topic's poses; the topic itself if its messages do not name one."""
    return pose.frame if pose.frame not in ("", pose.child) else pose.topic


def _link(child: str, edge: Edge) -> Link:
    return Link(child, edge.parent, edge.topic, edge.motion.first, edge.moves)


def _start(frame: str, sensor: str) -> str:
    """The frame of a sensor; its own name if its scans have no printable one."""
    return frame if is_label(frame) else sensor

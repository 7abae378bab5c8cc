"""Chains of transforms from a world frame down to each sensor, and what the user says about them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from gridtrack.recordings.frames.transform import SE3
from gridtrack.recordings.frames.tree import FrameTree
from gridtrack.recordings.mounts import Mount
from gridtrack.recordings.read_options import NO_POSES

SHOWN_FRAMES = 8
TAKEN_TO_STAND = "taken to stand still (of a robot that drives: recording import --ego-motion kiss-icp)"


@dataclass(frozen=True, slots=True)
class ChainOptions:
    """What the user says about the sensors."""

    sensors: dict[str, str]
    """The topics with scans, and the names of their sensors."""
    pose_topic: str | None
    mounts: tuple[Mount, ...]
    command: Callable[[Iterable[str]], str]
    """The command that imports the recording with more options, given as words."""

    @property
    def stand(self) -> bool:
        """Whether the user says that the sensors stand still."""
        return self.pose_topic == NO_POSES


class Link(NamedTuple):
    """The place of `child` in `parent`, from `source`: a topic, or an option.

    `first` is the place at its first stamp, and for all times unless it `moves`. Of an `is_inverse` link the recording
    has the place of the parent in the child.
    """

    child: str
    parent: str
    source: str
    first: SE3
    moves: bool = False
    is_inverse: bool = False

    @property
    def recorded(self) -> tuple[str, str]:
        """The source, and the frame whose place it gives."""
        return self.source, self.parent if self.is_inverse else self.child

    def inverse(self) -> Link:
        """The place of the parent in the child."""
        return Link(self.parent, self.child, self.source, self.first.inverse(), self.moves, not self.is_inverse)

    def place(self, recorded: SE3 | None) -> SE3:
        """The place of the child in the parent, from a transform of the recording; the first one without any."""
        if recorded is None or not self.moves:
            return self.first
        return recorded.inverse() if self.is_inverse else recorded


@dataclass(frozen=True, slots=True)
class Chain:
    """The links from the world frame, first, to the sensor. Without links the sensor defines the world frame."""

    world: str
    links: tuple[Link, ...] = ()

    @property
    def moving(self) -> tuple[Link, ...]:
        """The links that move."""
        return tuple(link for link in self.links if link.moves)

    @property
    def mirrored(self) -> bool:
        """Whether the links that do not move turn the sensor upside down."""
        return sum(link.first.placement().mirrored for link in self.links if not link.moves) % 2 == 1

    def __str__(self) -> str:
        frames = [self.world, *(link.child for link in self.links)]
        if len(frames) > SHOWN_FRAMES:
            frames = [*frames[:3], "...", *frames[-3:]]
        return " -> ".join(frames) + (" (mirrored)" if self.mirrored else "")


@dataclass
class Chains:
    """The chain of each topic with scans; `problem`: why they cannot be used, and what to do, empty where they can.

    `faults` are those of the transforms that the chains are from, `notes` what to know about the chains; a line each.
    """

    of_topic: dict[str, Chain] = field(default_factory=dict)
    problem: str = ""
    notes: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()

    @property
    def moving(self) -> dict[tuple[str, str], Link]:
        """Every link that moves, by what is `recorded` of it."""
        return {link.recorded: link for chain in self.of_topic.values() for link in chain.moving}

    def describe(self, tree: FrameTree, sensors: Mapping[str, str], *, stands: bool) -> str:
        """One line: the chains, the topics that they are from, and the longest gap; empty where they cannot be used.

        `sensors` are the names of the sensors, by topic; `stands`: the user says that they stand still.
        """
        linked = {topic: chain for topic, chain in self.of_topic.items() if chain.links}
        if not self.of_topic or self.problem:
            return ""
        at_rest = "at rest" if stands else f"no motion recorded: {TAKEN_TO_STAND}"
        if not linked:
            return "at rest" if tree.poses else at_rest
        one = len(self.of_topic) == 1
        texts = [str(chain) if one else f"{sensors[topic]}: {chain}" for topic, chain in linked.items()]
        sources = dict.fromkeys(link.source for chain in linked.values() for link in chain.links)
        text = f"{'; '.join(texts)}; from {', '.join(sources)}"
        if gaps := [_longest_gap_ns(link, tree) for link in self.moving.values()]:
            return f"{text}; longest gap {max(gaps) / 1e9:.2f} s"
        told = any(_tells_motion(link, tree) for chain in linked.values() for link in chain.links)
        return f"{text}; {'at rest' if told else at_rest}"


def _longest_gap_ns(link: Link, tree: FrameTree) -> int:
    source, frame = link.recorded
    edge = tree.edge(source, frame)
    motion = tree.poses[source].motion if edge is None else edge.motion
    return motion.longest_gap_ns


def _tells_motion(link: Link, tree: FrameTree) -> bool:
    """Whether the source of a link says where the frame is at any time, and not once for all times."""
    source, frame = link.recorded
    edge = tree.edge(source, frame)
    return source in tree.poses or (edge is not None and not edge.is_static)

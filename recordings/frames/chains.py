"""Chains of transforms from a world frame down to each sensor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from gridtrack.recordings.frames.transform import SE3
from gridtrack.recordings.frames.tree import FrameTree

SHOWN_FRAMES = 8


class Link(NamedTuple):
    """The place of `child` in `parent`: `constant`, or None where it moves. `source`: a topic, or an option."""

    child: str
    parent: str
    source: str
    constant: SE3 | None


@dataclass(frozen=True, slots=True)
class Chain:
    """The links from the world frame, first, to the sensor. Without links the sensor defines the world frame."""

    world: str
    links: tuple[Link, ...] = ()

    @property
    def moving(self) -> tuple[Link, ...]:
        """The links that move."""
        return tuple(link for link in self.links if link.constant is None)

    @property
    def mirrored(self) -> bool:
        """Whether the links that do not move turn the sensor upside down."""
        return sum(link.constant.placement().mirrored for link in self.links if link.constant) % 2 == 1

    def __str__(self) -> str:
        frames = [self.world, *(link.child for link in self.links)]
        if len(frames) > SHOWN_FRAMES:
            frames = [*frames[:3], "...", *frames[-3:]]
        return " -> ".join(frames) + (" (mirrored)" if self.mirrored else "")


@dataclass
class Chains:
    """The chain of each topic with scans; `problem`: why they cannot be used, and what to do, empty where they can."""

    of_topic: dict[str, Chain] = field(default_factory=dict)
    problem: str = ""

    @property
    def moving(self) -> dict[str, Link]:
        """Every link that moves, by its child."""
        return {link.child: link for chain in self.of_topic.values() for link in chain.moving}

    def describe(self, tree: FrameTree, sensors: Mapping[str, str]) -> str:
        """One line: the chains, the topics that they are from, and the longest gap; empty where there is no chain.

        `sensors` are the names of the sensors, by topic.
        """
        linked = {topic: chain for topic, chain in self.of_topic.items() if chain.links}
        if not linked or self.problem:
            return ""
        one = len(self.of_topic) == 1
        texts = [str(chain) if one else f"{sensors[topic]}: {chain}" for topic, chain in linked.items()]
        sources = dict.fromkeys(link.source for chain in linked.values() for link in chain.links)
        text = f"{'; '.join(texts)}; from {', '.join(sources)}"
        gaps = [_longest_gap_ns(link, tree) for link in self.moving.values()]
        return f"{text}; longest gap {max(gaps) / 1e9:.2f} s" if gaps else f"{text}; at rest"


def _longest_gap_ns(link: Link, tree: FrameTree) -> int:
    motion = tree.poses[link.source].motion if link.source in tree.poses else tree.edges[link.child].motion
    return motion.longest_gap_ns

"""What to know about chains that can be used: one line each."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from gridtrack.recordings.frames.chains import Chain, ChainOptions
from gridtrack.recordings.frames.far_stamps import FAR_JUMP_NS
from gridtrack.recordings.frames.forest import Forest
from gridtrack.recordings.frames.problems import MAX_SHOWN, poses_from_scans, shown
from gridtrack.recordings.frames.tree import Edge, FrameTree


def motion_above(options: ChainOptions, forest: Forest, world: str, chains: Mapping[str, Chain]) -> Iterator[str]:
    """A world frame in which no sensor moves, below one in which it moves."""
    above = forest.moving_above(world)
    if above is not None and not any(chain.moving for chain in chains.values()):
        yield (
            f"the sensors stand still in '{world}', which moves in '{above.parent}' by the transforms on"
            f" {above.source}: where they drive, take {poses_from_scans(options)}"
        )


def several_topics(options: ChainOptions, tree: FrameTree, chains: Mapping[str, Chain]) -> Iterator[str]:
    """Frames of a sensor's chain whose place several topics tell, each another one, of which one is used."""
    for topic, chain in chains.items():
        frames: dict[tuple[str, tuple[str, ...]], list[str]] = {}
        for source, frame in (link.recorded for link in chain.links):
            if tree.edge(source, frame) is not None and (rivals := tree.rivals(frame)):
                frames.setdefault((source, rivals), []).append(frame)
        for (used, topics), of in frames.items():
            named = " and ".join(f"'{frame}'" for frame in of[:MAX_SHOWN])
            yield (
                f"transforms of frame {named} are on several topics, {shown(topics)}, as of two robots: sensor"
                f" '{options.sensors[topic]}' has those on {used}"
            )


def seldom_told(tree: FrameTree, chains: Mapping[str, Chain]) -> Iterator[str]:
    """Frames of the chains that are taken to rest, whose place transforms tell seldom and not for all times."""
    resting = dict.fromkeys((link.recorded, link.parent, link.child) for c in chains.values() for link in c.links)
    for (source, frame), parent, child in resting:
        edge = tree.edge(source, frame)
        if edge is not None and not edge.is_static and not edge.moves and (how := _how_seldom(edge)):
            yield (
                f"the place of frame '{child}' in '{parent}' is taken to be the same at all times, and {how} on"
                f" {source}: where it moves there, as a joint that pans or tilts, record it at least once a second"
            )


def _how_seldom(edge: Edge) -> str:
    """How transforms that agree tell a place too seldom; empty where they come often."""
    motion = edge.motion
    gap_ns, last = motion.after_gap or (0, motion.first)
    if not last.is_same(motion.first):
        return f"changes after a gap of {gap_ns / 1e9:.1f} s"
    longest_ns = gap_ns if motion.number == 1 else motion.longest_gap_ns
    if longest_ns > FAR_JUMP_NS:
        return f"comes seldom, with a gap of {longest_ns / 1e9:.1f} s,"
    is_once = motion.number == 1 and edge.topic.rpartition("/")[2] == "tf"
    return "comes once" if is_once else ""

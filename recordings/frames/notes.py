"""What to know about chains that can be used: one line each."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from gridtrack.recordings.frames.chains import Chain, ChainOptions
from gridtrack.recordings.frames.forest import Forest
from gridtrack.recordings.frames.problems import MAX_SHOWN, poses_from_scans, shown
from gridtrack.recordings.frames.tree import FrameTree


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

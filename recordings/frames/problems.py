"""Messages about chains: why poses cannot be used, with the remedy, and notes about usable poses."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from gridtrack.recordings.frames.chains import Chain, ChainOptions, Forest, Link
from gridtrack.recordings.frames.tree import FAR_JUMP_NS, Edge, FrameTree, PoseTopic

MAX_SHOWN = 5
EXAMPLE_POSE = "0,0,0deg"
IF_AT_REST = "or, if the robot stands still, import the recording with --pose-topic none"


def frames_in_a_cycle(options: ChainOptions, frames: Sequence[str], pose_topics: Sequence[str]) -> str:
    """Frames that are their own ancestors; `pose_topics` may have the poses instead."""
    text = f"frames in a cycle ({shown(frames, ' -> ')}): use {poses_from_scans(options)}"
    if pose_topics:
        mount = ["--mount", f"{next(iter(options.sensors.values()))}={EXAMPLE_POSE}"]
        command = options.command([*mount, "--pose-topic", pose_topics[0]])
        text += f"; or the poses on {shown(pose_topics)}, with the mount of the sensor, as in `{command}`"
    return f"{text}; {IF_AT_REST}"


def unknown_mounts(options: ChainOptions, names: Sequence[str], moves: bool) -> str:
    """Sensors without a common frame; `names` are the sensors without any transform, `moves`: the robot moves."""
    mounts = {name: ["--mount", f"{name}={EXAMPLE_POSE}"] for name in names[:MAX_SHOWN]}
    (topic, first), *_ = options.sensors.items()
    one = options.command(["--topic", topic, *(mounts.get(first, []) if moves else [])])
    others = [f"--topic {other}" for other in options.sensors if other != topic]
    together = options.command(word for words in mounts.values() for word in words)
    return (
        f"several sensors ({shown(list(options.sensors.values()))}) with unknown mounts, so that their scans cannot"
        f" share a grid: import one of them with `{one}`, or {shown(others)}; or all of them with `{together}`, with"
        f" their x, y (metres) and heading on the robot in place of {EXAMPLE_POSE}"
    )


def unknown_mount(options: ChainOptions, pose: PoseTopic, sensor: str) -> str:
    """Poses of a robot without the mount of its sensor."""
    owner = f"'{pose.child}'" if pose.child else "the robot"
    command = options.command(["--mount", f"{sensor}={EXAMPLE_POSE}"])
    return (
        f"{pose.topic} has the poses of {owner}, and the mount of sensor '{sensor}' on it is not recorded: give its x,"
        f" y (metres) and heading in place of {EXAMPLE_POSE} in `{command}`"
    )


def ambiguous_poses(
    options: ChainOptions,
    poses: Sequence[PoseTopic],
    links: Sequence[Link],
    sensor: str,
    frame: str,
    *,
    is_mounted: bool,
) -> str:
    """Topics with poses that may be another object's, not the robot's; `links` do not lead to the sensor."""
    transforms = f"{_unconnected(links, sensor, frame)}; " if links else ""
    mount = [] if is_mounted else ["--mount", f"{sensor}={EXAMPLE_POSE}"]
    command = options.command(["--pose-topic", poses[0].topic, *mount])
    mounted = f", with the mount of the sensor in place of {EXAMPLE_POSE}" if mount else ""
    topics = shown([pose.topic for pose in poses])
    question = f"whether {topics} has" if len(poses) == 1 else f"which of {topics} has"
    return (
        f"{transforms}it is not recorded {question} the poses of the robot with sensor '{sensor}': name the topic, as"
        f" in `{command}`{mounted}; {IF_AT_REST}"
    )


def unconnected_sensor(options: ChainOptions, links: Sequence[Link], sensor: str, frame: str) -> str:
    """Moving transforms in another tree than the sensor's."""
    command = options.command(["--mount", f"{sensor}={links[0].child}:{EXAMPLE_POSE}"])
    return (
        f"{_unconnected(links, sensor, frame)}: give the frame on which the sensor is mounted, and its x, y (metres)"
        f" and heading there, as in `{command}`; {IF_AT_REST}"
    )


def unusable_poses(options: ChainOptions, topic: str, frame: str) -> str:
    """Transforms or poses that would have the motion of the sensors, but contain no numbers."""
    return (
        f"all poses of frame '{frame}' on {topic} are not finite or have no rotation: use {poses_from_scans(options)};"
        f" {IF_AT_REST}"
    )


def unused_motion(options: ChainOptions, child: str, second: Edge) -> str:
    """Transforms to a second parent, which alone contain the motion of the sensors."""
    return (
        f"the motion of the sensors is in the transforms on {second.topic} ({second.parent} -> {child}), which are not"
        f" used because '{child}' has another parent: use {poses_from_scans(options)}; {IF_AT_REST}"
    )


def motion_above(options: ChainOptions, forest: Forest, world: str, chains: Mapping[str, Chain]) -> Iterator[str]:
    """A world frame in which no sensor moves, and which moves in a frame above."""
    above = forest.moving_above(world)
    if above is not None and not any(chain.moving for chain in chains.values()):
        yield (
            f"the sensors are at rest in '{world}', which moves in '{above.parent}' by the transforms on"
            f" {above.source}: if they drive, use {poses_from_scans(options)}"
        )


def several_topics(options: ChainOptions, tree: FrameTree, chains: Mapping[str, Chain]) -> Iterator[str]:
    """Frames of a sensor's chain with different transforms on several topics; one is used."""
    for topic, chain in chains.items():
        frames: dict[tuple[str, tuple[str, ...]], list[str]] = {}
        for source, frame in (link.key for link in chain.links):
            if tree.edge(source, frame) is not None and (rivals := tree.rivals(frame)):
                frames.setdefault((source, rivals), []).append(frame)
        for (used, topics), same in frames.items():
            named = " and ".join(f"'{frame}'" for frame in same[:MAX_SHOWN])
            yield (
                f"transforms of frame {named} are on several topics, {shown(topics)}, perhaps of two robots: sensor"
                f" '{options.sensors[topic]}' uses {used}"
            )


def rare_transforms(tree: FrameTree, chains: Mapping[str, Chain]) -> Iterator[str]:
    """Frames of the chains that are assumed to be at rest, with rare transforms that are not static."""
    resting = dict.fromkeys((link.key, link.parent, link.child) for c in chains.values() for link in c.links)
    for (source, frame), parent, child in resting:
        edge = tree.edge(source, frame)
        if edge is not None and not edge.is_static and not edge.moves and (reason := _why_rare(edge)):
            yield (
                f"frame '{child}' is assumed to be at rest in '{parent}', but its transform on {source} {reason}: if it"
                " moves, such as a joint that pans or tilts, record it at least once a second"
            )


def _why_rare(edge: Edge) -> str:
    """How a constant transform comes too rarely; empty if it is frequent."""
    motion = edge.motion
    gap_ns, last = motion.after_gap or (0, motion.first)
    if not last.is_same(motion.first):
        return f"changes after a gap of {gap_ns / 1e9:.1f} s"
    longest_ns = gap_ns if motion.number == 1 else motion.longest_gap_ns
    if longest_ns > FAR_JUMP_NS:
        return f"has a gap of {longest_ns / 1e9:.1f} s"
    is_once = motion.number == 1 and edge.topic.rpartition("/")[2] == "tf"
    return "is recorded once" if is_once else ""


def poses_from_scans(options: ChainOptions) -> str:
    """Poses that need no transforms: from the scans of one sensor."""
    topic = [] if len(options.sensors) == 1 else ["--topic", next(iter(options.sensors))]
    return f"poses from the scans, with `{options.command([*topic, '--ego-motion', 'kiss-icp'])}`"


def shown(names: Sequence[str], separator: str = ", ") -> str:
    """The first names, and the number of the others."""
    more = f"{separator}{len(names) - MAX_SHOWN} more" if len(names) > MAX_SHOWN else ""
    return separator.join(names[:MAX_SHOWN]) + more


def _unconnected(links: Sequence[Link], sensor: str, frame: str) -> str:
    moving = shown([f"{link.parent} -> {link.child}" for link in links])
    return f"transforms on {links[0].source} ({moving}) do not lead to frame '{frame}' of sensor '{sensor}'"

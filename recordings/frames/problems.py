"""Messages about chains: why poses cannot be used, and what to know where they can."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from gridtrack.recordings.frames.chains import Chain, ChainOptions, Forest, Link
from gridtrack.recordings.frames.tree import FAR_JUMP_NS, Edge, FrameTree, PoseTopic

MAX_SHOWN = 5
EXAMPLE_PLACE = "0,0,0deg"
AT_REST = "or import it with --pose-topic none where it stands still"


def frames_in_a_cycle(options: ChainOptions, frames: Sequence[str], pose_topics: Sequence[str]) -> str:
    """Frames that are their own ancestors; `pose_topics` may tell where they are."""
    text = f"frames in a cycle ({shown(frames, ' -> ')}): take {poses_from_scans(options)}"
    if pose_topics:
        mount = ["--mount", f"{next(iter(options.sensors.values()))}={EXAMPLE_PLACE}"]
        command = options.command([*mount, "--pose-topic", pose_topics[0]])
        text += f"; or those on {shown(pose_topics)}, with the place of the sensor there, as in `{command}`"
    return f"{text}; {AT_REST}"


def mounts_not_known(options: ChainOptions, names: Sequence[str], moves: bool) -> str:
    """Sensors without a frame in common; `names` are those without any place, `moves`: what carries them does."""
    mounts = {name: ["--mount", f"{name}={EXAMPLE_PLACE}"] for name in names[:MAX_SHOWN]}
    (topic, first), *_ = options.sensors.items()
    one = options.command(["--topic", topic, *(mounts.get(first, []) if moves else [])])
    others = [f"--topic {other}" for other in options.sensors if other != topic]
    together = options.command(word for words in mounts.values() for word in words)
    return (
        f"several sensors ({shown(list(options.sensors.values()))}), and how they are mounted is not known, so that"
        f" their scans cannot share a grid: import one of them with `{one}`, or {shown(others)}; or all with"
        f" `{together}`, with their places on the robot (x and y in metres, and heading) in place of {EXAMPLE_PLACE}"
    )


def mount_not_known(options: ChainOptions, pose: PoseTopic, sensor: str) -> str:
    """Poses of what carries a sensor whose place on it is not recorded."""
    of = f"of '{pose.child}'" if pose.child else "of what carries it"
    command = options.command(["--mount", f"{sensor}={EXAMPLE_PLACE}"])
    return (
        f"the poses on {pose.topic} are those {of}, and where sensor '{sensor}' is mounted on it is not recorded: give"
        f" its x and y (metres) and heading there, in place of {EXAMPLE_PLACE} in `{command}`"
    )


def poses_not_known(
    options: ChainOptions,
    poses: Sequence[PoseTopic],
    links: Sequence[Link],
    sensor: str,
    frame: str,
    *,
    is_mounted: bool,
) -> str:
    """Topics with poses of which none is known to be that of what carries the sensor; `links` do not reach it."""
    transforms = f"{_not_reached(links, sensor, frame)}; " if links else ""
    mount = [] if is_mounted else ["--mount", f"{sensor}={EXAMPLE_PLACE}"]
    command = options.command(["--pose-topic", poses[0].topic, *mount])
    mounted = f", with its place there in place of {EXAMPLE_PLACE}" if mount else ""
    which = "whether the poses on" if len(poses) == 1 else "which of the poses on"
    verb = "are" if len(poses) == 1 else "are, if any,"
    return (
        f"{transforms}it is not known {which} {shown([pose.topic for pose in poses])} {verb} those of what carries"
        f" sensor '{sensor}': name the topic that has them, as in `{command}`{mounted}; {AT_REST}"
    )


def sensor_not_reached(options: ChainOptions, links: Sequence[Link], sensor: str, frame: str) -> str:
    """Transforms that move, in another tree than that of the sensor."""
    command = options.command(["--mount", f"{sensor}={links[0].child}:{EXAMPLE_PLACE}"])
    return (
        f"{_not_reached(links, sensor, frame)}: give the frame that it is mounted on, and its x and y (metres) and"
        f" heading there, as in `{command}`; {AT_REST}"
    )


def motion_not_used(options: ChainOptions, child: str, second: Edge) -> str:
    """Transforms of a frame of the sensors in a second parent, which alone tell the motion."""
    return (
        f"transforms on {second.topic} ({second.parent} -> {child}) tell how the sensors move, and '{child}' has"
        f" another parent in the transforms, so that they are not used: take {poses_from_scans(options)}; {AT_REST}"
    )


def poses_from_scans(options: ChainOptions) -> str:
    """Poses that need no transforms: from the scans of one sensor."""
    topic = [] if len(options.sensors) == 1 else ["--topic", next(iter(options.sensors))]
    return f"the poses from the scans, with `{options.command([*topic, '--ego-motion', 'kiss-icp'])}`"


def shown(names: Sequence[str], separator: str = ", ") -> str:
    """The names, all but the first few left out."""
    more = f"{separator}{len(names) - MAX_SHOWN} more" if len(names) > MAX_SHOWN else ""
    return separator.join(names[:MAX_SHOWN]) + more


def _not_reached(links: Sequence[Link], sensor: str, frame: str) -> str:
    moving = shown([f"{link.parent} -> {link.child}" for link in links])
    return f"transforms on {links[0].source} ({moving}) do not reach frame '{frame}' of sensor '{sensor}'"


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

"""Why the poses of a recording cannot be used: one line each, with the command to type."""

from __future__ import annotations

from collections.abc import Sequence

from gridtrack.recordings.frames.chains import ChainOptions, Link
from gridtrack.recordings.frames.tree import Edge, PoseTopic

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

"""The link of every frame to its parent, from what a recording holds and what the options say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import takewhile

from gridtrack.common.errors import ConfigurationError, RecordingError, did_you_mean
from gridtrack.common.names import is_label
from gridtrack.recordings.frames.chains import Chain, ChainOptions, Link
from gridtrack.recordings.frames.forest import Forest, in_common
from gridtrack.recordings.frames.naming import BODY_FRAMES, is_world, last_part
from gridtrack.recordings.frames.transform import SE3
from gridtrack.recordings.frames.tree import Edge, FrameTree, PoseTopic, frame_name


class FrameLinks:
    """The frames above each sensor as a forest: the transforms first, then what is added to them."""

    def __init__(self, tree: FrameTree, options: ChainOptions) -> None:
        self._tree, self._options = tree, options
        self._starts = {topic: _start(tree.sensors[topic], name) for topic, name in options.sensors.items()}
        first = next(iter(options.sensors))
        edges = {child: tree.edge_beside(first, child) for child in tree.edges}
        self.forest = Forest(_link(child, edge) for child, edge in edges.items() if self._may_use(edge))

    @property
    def starts(self) -> Mapping[str, str]:
        """The frame of each topic with scans: where its chain ends."""
        return self._starts

    def add_named_poses(self) -> None:
        """The poses that name a child without a parent, of one topic for each child."""
        poses = self._tree.poses.values()
        for pose in poses if self._options.pose_topic is None else ():
            rivals = [other for other in poses if other.child == pose.child]
            if pose.child and pose.child not in self.forest and len(rivals) == 1:
                self.join(pose, pose.child)

    def add_mounts(self) -> None:
        """The mounts that the user gives. Raises ConfigurationError for one of no sensor."""
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
        """The topic with poses that the user names. Raises RecordingError where it is not there."""
        poses, topic = self._tree.poses, self._options.pose_topic
        if topic is None or self._options.stand:
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
        """The frames that the paths of all sensors have in common, from the sensors on."""
        return in_common(self._paths())

    def carrier(self) -> str | None:
        """The topmost frame that no sensor moves in; for a sensor without a mount its own. None for several such."""
        common = in_common([self._carried(start) for start in self._starts.values()])
        return common[-1] if common else None

    def chains(self, world: str) -> dict[str, Chain]:
        """The chain of each topic from `world` down to its sensor."""
        return {
            topic: Chain(world, tuple(self._beside(topic, link) for link in self.forest.chain(world, start).links))
            for topic, start in self._starts.items()
        }

    def _may_use(self, edge: Edge) -> bool:
        return not edge.moves or not self._options.stand

    def _beside(self, scans: str, link: Link) -> Link:
        """A link by the transforms on the topic beside that of the scans, where several topics have it."""
        source, frame = link.recorded
        if self._tree.edge(source, frame) is None:
            return link
        edge = self._tree.edge_beside(scans, frame)
        if edge.topic == source or not self._may_use(edge):
            return link
        return _link(frame, edge).inverse() if link.is_inverse else _link(frame, edge)

    def _paths(self) -> list[list[str]]:
        return [self.forest.path(start) for start in self._starts.values()]

    def _carried(self, start: str) -> list[str]:
        """The frames from a sensor up that it does not move in, world frames left out."""
        first, *above = self.forest.rigid_path(start)
        return [first, *takewhile(lambda frame: not is_world(frame), above)]

    def _body(self) -> str:
        """The frame that a mount without a parent is on: that of the poses named, else the robot's body, if it moves.

        Where no body moves, the child of the only poses that name one, else a body at rest.
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
    """The frame of a topic's poses; the topic itself where its messages do not name one."""
    return pose.frame if pose.frame not in ("", pose.child) else pose.topic


def _link(child: str, edge: Edge) -> Link:
    return Link(child, edge.parent, edge.topic, edge.motion.first, edge.moves)


def _start(frame: str, sensor: str) -> str:
    """The frame of a sensor; its own name where its scans have none that can be shown."""
    return frame if is_label(frame) else sensor

"""The choice of the chain of each sensor, from what a recording holds and what the options say.

The first of these that tells the place of a frame is used: the options `--mount` and `--pose-topic`; the transforms
(`/tf`, `/tf_static`); a topic with poses that names the frame as its child (nav_msgs/Odometry), where it is the only
one. Poses that do not name their frame (geometry_msgs/PoseStamped) are those of what carries the sensors, and are used
where nothing else in the recording moves. Links are followed upwards, and where no world frame is found so, both ways:
some robots record the place of `odom` on the robot, or the pose of a camera that is mounted on it. Of the transforms of
a link that come on several topics, as of several robots, each sensor has those beside its scans.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import takewhile

from gridtrack.common.errors import ConfigurationError, RecordingError, did_you_mean
from gridtrack.common.names import is_label
from gridtrack.recordings.frames.chains import Chain, Chains, Link
from gridtrack.recordings.frames.forest import Forest, in_common
from gridtrack.recordings.frames.problems import (
    ChainOptions,
    frames_in_a_cycle,
    motion_above,
    motion_not_used,
    mount_not_known,
    mounts_not_known,
    poses_not_known,
    sensor_not_reached,
    several_topics,
)
from gridtrack.recordings.frames.transform import SE3
from gridtrack.recordings.frames.tree import Edge, FrameTree, PoseTopic, frame_name

WORLD_WORDS = ("odom", "map")
"""In the names of frames that do not move, by REP 105; `odom` first, since it is continuous."""
BODY_FRAMES = ("base_link", "base_footprint")
"""Frames of a robot's body, by REP 105."""
NO_POSES = "none"
"""The pose topic of a recording whose sensors stand still."""
MAX_POSE_GAP_NS = 1_000_000_000


def chosen_chains(tree: FrameTree, options: ChainOptions) -> Chains:
    """The chain of each sensor.

    Raises RecordingError for a pose topic that is not there, ConfigurationError for a mount of no sensor.
    """
    if not options.sensors:
        return Chains()
    links = _Links(tree, options)
    chains = _chosen(links, tree, options)
    chains.faults = tuple(links.on_several_topics(chains.of_topic))
    return chains


def _chosen(links: _Links, tree: FrameTree, options: ChainOptions) -> Chains:
    """The chain of each sensor, as `chosen_chains` says."""
    links.add_named_poses()
    links.add_mounts()
    given = links.add_pose_topic()
    if (looped := links.cycle()) is not None:
        matters = options.pose_topic != NO_POSES or len(options.sensors) > 1
        return links.at_rest(frames_in_a_cycle(options, looped, list(tree.poses)) if matters else "")
    if not links.common():
        return links.at_rest(links.why_not_together())
    if given is not None:
        return links.on_poses(given)
    world = links.world_frame() or links.world_frame_below()
    if world is not None:
        return Chains(links.chains(world), note=links.motion_above(world))
    return links.without_world_frame()


class _Links:
    """The link of every frame to its parent, with the options applied."""

    def __init__(self, tree: FrameTree, options: ChainOptions) -> None:
        self._tree, self._options = tree, options
        self._starts = {topic: _start(tree.sensors[topic], name) for topic, name in options.sensors.items()}
        first = next(iter(options.sensors))
        edges = {child: tree.edge_beside(first, child) for child in tree.edges}
        self._forest = Forest(_link(child, edge) for child, edge in edges.items() if self._may_use(edge))

    def add_named_poses(self) -> None:
        """The poses that name a child without a parent, of one topic for each child."""
        poses = self._tree.poses.values()
        for pose in poses if self._options.pose_topic is None else ():
            rivals = [other for other in poses if other.child == pose.child]
            if pose.child and pose.child not in self._forest and len(rivals) == 1:
                self._join(pose, pose.child)

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
            self._forest.put(Link(frame, parent, "--mount", SE3.in_plane(mount.parent_T_sensor, mount.mirrored)))

    def add_pose_topic(self) -> PoseTopic | None:
        """The topic with poses that the user names. Raises RecordingError where it is not there."""
        poses, topic = self._tree.poses, self._options.pose_topic
        if topic in (None, NO_POSES):
            return None
        pose = poses.get(topic or "")
        if pose is None:
            raise RecordingError(f"no topic '{topic}' with poses; {did_you_mean(topic or '', poses)}")
        if (child := pose.child or self._carrier()) is not None:
            self._join(pose, child)
        return pose

    def cycle(self) -> Sequence[str] | None:
        """The frames of a cycle above a sensor."""
        for path in self._paths():
            if path[-1] in path[:-1]:
                return path[path.index(path[-1]) :]
        return None

    def common(self) -> list[str]:
        """The frames that the paths of all sensors have in common, from the sensors on."""
        return in_common(self._paths())

    def world_frame(self) -> str | None:
        """The frame in common that does not move: `odom`, else `map`, else the topmost, unless that is a robot's.

        `odom` and `map` are not, where they move and the sensors stand still in them for all times: SLAM without wheel
        odometry gives the motion so, above a static `odom`.
        """
        common = self.common()
        for word in WORLD_WORDS:
            for frame in common:
                if _has_word(frame, word) and not self._is_carried(frame):
                    return frame
        top = common[-1]
        moves = any(link.moves for chain in self.chains(top).values() for link in chain.links)
        is_body = _is_body(top) or any(pose.child == top for pose in self._tree.poses.values())
        return top if moves and not is_body else None

    def world_frame_below(self) -> str | None:
        """A world frame whose place on the robot is recorded, and moves: it becomes the top of the tree."""
        top = self.common()[-1]
        below = [one for one in self._forest.frames if self._forest.top(one) == top and self._forest.moves(one)]
        for word in WORLD_WORDS:
            for frame in below:
                if _has_word(frame, word):
                    self._forest.turn(frame)
                    return frame
        return None

    def chains(self, world: str) -> dict[str, Chain]:
        """The chain of each topic from `world` down to its sensor."""
        return {
            topic: Chain(world, tuple(self._beside(topic, link) for link in self._forest.chain(world, start).links))
            for topic, start in self._starts.items()
        }

    def motion_above(self, world: str) -> str:
        """A note where no sensor moves in the world frame, and that frame does in one above it; else empty."""
        above = self._forest.moving_above(world)
        if above is None or any(chain.moving for chain in self.chains(world).values()):
            return ""
        return motion_above(self._options, world, above)

    def on_several_topics(self, chains: Mapping[str, Chain]) -> Iterator[str]:
        """One line for each sensor and the topics that tell the place of frames in its chain, each another one."""
        for topic, chain in chains.items():
            frames: dict[tuple[str, tuple[str, ...]], list[str]] = {}
            for source, frame in (link.recorded for link in chain.links):
                if self._tree.edge(source, frame) is not None and (rivals := self._tree.rivals(frame)):
                    frames.setdefault((source, rivals), []).append(frame)
            for (used, topics), of in frames.items():
                yield several_topics(of, topics, self._options.sensors[topic], used)

    def on_poses(self, pose: PoseTopic) -> Chains:
        """The chains from the frame of a topic's poses; with a problem where a sensor's mount is not known."""
        carrier, problem = self._carrier(), ""
        if self._parent(pose) not in self.common():
            if carrier is None:
                return self.at_rest(self.why_not_together())
            self._forest.put(Link(carrier, pose.child, pose.topic, SE3()))
            problem = mount_not_known(self._options, pose, self._name_of(carrier))
        elif carrier is not None and not pose.child and carrier in self._starts.values():
            problem = "" if _is_body(carrier) else mount_not_known(self._options, pose, self._name_of(carrier))
        chains = self.chains(self._parent(pose))
        return Chains(chains, problem if any(chain.moving for chain in chains.values()) else "")

    def without_world_frame(self) -> Chains:
        """The chains where no transforms lead to a world frame: from the only poses there are, else at rest."""
        frames, poses = self._frames_not_reached(), self._poses_not_used()
        if len(poses) == 1 and not frames and (poses[0].child or _is_dense(poses[0])):
            if (child := poses[0].child or self._carrier()) is not None:
                self._join(poses[0], child)
            return self.on_poses(poses[0])
        topic, start = next(iter(self._starts.items()))
        name = self._options.sensors[topic]
        if poses:
            mounted = start in self._forest
            return self.at_rest(poses_not_known(self._options, poses, frames, name, start, is_mounted=mounted))
        if frames:
            return self.at_rest(sensor_not_reached(self._options, frames, name, start))
        unused = self._motion_not_used()
        return self.at_rest(motion_not_used(self._options, *unused) if unused else "")

    def at_rest(self, problem: str) -> Chains:
        """The sensors at rest in what carries them, each at its origin where that is not known."""
        common = [] if self.cycle() else self.common()
        if common:
            return Chains(self.chains(common[-1]), problem)
        return Chains({topic: Chain(start) for topic, start in self._starts.items()}, problem)

    def why_not_together(self) -> str:
        """The problem of sensors without a frame in common."""
        sensors = self._options.sensors
        alone = [name for topic, name in sensors.items() if self._starts[topic] not in self._forest]
        moves = any(link.moves for link in self._forest.links) or bool(self._poses_not_used())
        return mounts_not_known(self._options, alone or list(sensors.values()), moves)

    def _join(self, pose: PoseTopic, child: str) -> None:
        """Link `child` to the frame of a topic's poses."""
        moves = not pose.motion.constant
        self._forest.join(Link(child, self._parent(pose), pose.topic, pose.motion.first, moves))

    @staticmethod
    def _parent(pose: PoseTopic) -> str:
        """The frame of a topic's poses; the topic itself where its messages do not name one."""
        return pose.frame if pose.frame not in ("", pose.child) else pose.topic

    def _may_use(self, edge: Edge) -> bool:
        return not edge.moves or self._options.pose_topic != NO_POSES

    def _beside(self, scans: str, link: Link) -> Link:
        """A link by the transforms on the topic beside that of the scans, where several topics have it."""
        source, frame = link.recorded
        if self._tree.edge(source, frame) is None:
            return link
        edge = self._tree.edge_beside(scans, frame)
        if edge.topic == source or not self._may_use(edge):
            return link
        return _link(frame, edge).inverse() if link.is_inverse else _link(frame, edge)

    def _is_carried(self, frame: str) -> bool:
        """Whether a frame moves in one above it, and all links down to the sensors are the same for all times."""
        if not self._forest.moves(frame):
            return False
        recorded = {link.recorded for chain in self.chains(frame).values() for link in chain.links}
        edges = [self._tree.edge(*one) for one in recorded if one[0] not in self._tree.poses]
        return len(edges) == len(recorded) and all(edge is None or edge.is_static for edge in edges)

    def _paths(self) -> list[list[str]]:
        return [self._forest.path(start) for start in self._starts.values()]

    def _carried(self, start: str) -> list[str]:
        """The frames from a sensor up that it does not move in, world frames left out."""
        first, *above = self._forest.rigid_path(start)
        return [first, *takewhile(lambda frame: not _is_world(frame), above)]

    def _carrier(self) -> str | None:
        """The topmost frame that no sensor moves in; for a sensor without a mount its own. None for several such."""
        common = in_common([self._carried(start) for start in self._starts.values()])
        return common[-1] if common else None

    def _body(self) -> str:
        """The frame that a mount without a parent is on: that of the poses named, else the robot's body, if it moves.

        Where no body moves, the child of the only poses that name one, else a body at rest.
        """
        pose = self._tree.poses.get(self._options.pose_topic or "")
        if pose is not None and pose.child:
            return pose.child
        bodies = [frame for body in BODY_FRAMES for frame in self._forest.frames if _last_part(frame).endswith(body)]
        moving = [frame for frame in bodies if self._forest.moves(frame)]
        children = dict.fromkeys(pose.child for pose in self._tree.poses.values() if pose.child)
        candidates = moving or (list(children) if len(children) == 1 else []) or bodies
        alike = [frame for frame in candidates if _last_part(frame) == _last_part(candidates[0])]
        return candidates[0] if len(alike) == 1 else BODY_FRAMES[0]

    def _name_of(self, start: str) -> str:
        """The sensor whose frame is `start`, else the first one."""
        names = {self._starts[topic]: name for topic, name in self._options.sensors.items()}
        return names.get(start, next(iter(names.values())))

    def _frames_not_reached(self) -> list[Link]:
        """The links of transforms that move, and that are not in the tree of the sensors."""
        top = self.common()[-1]
        moving = [link for link in self._forest.links if link.moves and link.source not in self._tree.poses]
        return [link for link in moving if self._forest.top(link.child) != top]

    def _poses_not_used(self) -> list[PoseTopic]:
        """The topics whose poses move, and are not of frames whose place transforms tell in the frame of the poses."""
        if self._options.pose_topic == NO_POSES:
            return []
        return [pose for pose in self._tree.poses.values() if not pose.motion.constant and not self._is_told(pose)]

    def _is_told(self, pose: PoseTopic) -> bool:
        forest = self._forest
        return pose.child in self._tree.edges and forest.top(pose.child) == forest.top(self._parent(pose))

    def _motion_not_used(self) -> tuple[str, Edge] | None:
        """A frame of the sensors' tree that moves in a second parent, while nothing else of the tree does."""
        top = self.common()[-1]
        seconds = self._tree.second_parents.items() if self._options.pose_topic != NO_POSES else ()
        return next(((child, edge) for child, edge in seconds if edge.moves and self._forest.top(child) == top), None)


def _link(child: str, edge: Edge) -> Link:
    return Link(child, edge.parent, edge.topic, edge.motion.first, edge.moves)


def _is_dense(pose: PoseTopic) -> bool:
    """Whether poses come often enough for those of a sensor: a goal or a localisation does not."""
    return pose.motion.longest_gap_ns <= MAX_POSE_GAP_NS


def _start(frame: str, sensor: str) -> str:
    """The frame of a sensor; its own name where its scans have none that can be shown."""
    return frame if is_label(frame) else sensor


def _last_part(frame: str) -> str:
    """`odom` of `robot1/odom`."""
    return frame.rpartition("/")[2]


def _has_word(frame: str, word: str) -> bool:
    """Whether a frame's name is `odom`, or has it as a word, as in `robot1/odom`, `odom_combined` and `tb_odom`."""
    return word in _last_part(frame).lower().split("_")


def _is_world(frame: str) -> bool:
    return any(_has_word(frame, word) for word in WORLD_WORDS)


def _is_body(frame: str) -> bool:
    """Whether a frame is a robot's body, as `base_link`, `robot1/base_link` and `tb_base_link`."""
    return _last_part(frame).endswith(BODY_FRAMES)

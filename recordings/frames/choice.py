"""The choice of the chain of each sensor, from what a recording holds and what the options say.

The first of these that tells the place of a frame is used: the options `--mount` and `--pose-topic`; the transforms
(`/tf`, `/tf_static`); a topic with poses that names the frame as its child (nav_msgs/Odometry), where it is the only
one. Poses that do not name their frame (geometry_msgs/PoseStamped) are those of what carries the sensors, and are used
where nothing else in the recording moves.
"""

from __future__ import annotations

from collections.abc import Sequence

from gridtrack.common.errors import ConfigurationError, RecordingError, did_you_mean
from gridtrack.common.names import is_label
from gridtrack.recordings.frames.chains import Chain, Chains, Link
from gridtrack.recordings.frames.problems import (
    ChainOptions,
    frames_in_a_cycle,
    mount_not_known,
    mounts_not_known,
    poses_not_known,
    sensor_not_reached,
)
from gridtrack.recordings.frames.transform import SE3
from gridtrack.recordings.frames.tree import FrameTree, PoseTopic, frame_name

WORLD_FRAMES = ("odom", "map")
"""Frames that do not move, by REP 105; `odom` first, since it is continuous."""
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
    links.add_named_poses()
    links.add_mounts()
    given = links.add_pose_topic()
    if (looped := links.cycle()) is not None:
        return links.at_rest(frames_in_a_cycle(options, looped))
    if not links.common():
        return links.at_rest(links.why_not_together())
    if given is not None:
        return links.on_poses(given)
    world = links.world_frame()
    if world is not None:
        return Chains(links.chains(world))
    return links.without_world_frame()


class _Links:
    """The link of every frame to its parent, with the options applied."""

    def __init__(self, tree: FrameTree, options: ChainOptions) -> None:
        self._tree, self._options = tree, options
        self._starts = {topic: _start(tree.sensors[topic], name) for topic, name in options.sensors.items()}
        self._links: dict[str, Link] = {}
        for child, edge in tree.edges.items():
            if not edge.moves:
                self._link(child, edge.parent, edge.topic, edge.motion.first)
            elif options.pose_topic != NO_POSES:
                self._link(child, edge.parent, edge.topic, None)

    def add_named_poses(self) -> None:
        """The poses that name a child without a parent, of one topic for each child."""
        poses = self._tree.poses.values()
        for pose in poses if self._options.pose_topic is None else ():
            rivals = [other for other in poses if other.child == pose.child]
            if pose.child and pose.child not in self._links and len(rivals) == 1:
                self._link_pose(pose, pose.child)

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
            self._link(frame, parent, "--mount", SE3.in_plane(mount.parent_T_sensor, mount.mirrored))

    def add_pose_topic(self) -> PoseTopic | None:
        """The topic with poses that the user names. Raises RecordingError where it is not there."""
        poses, topic = self._tree.poses, self._options.pose_topic
        if topic in (None, NO_POSES):
            return None
        pose = poses.get(topic or "")
        if pose is None:
            raise RecordingError(f"no topic '{topic}' with poses; {did_you_mean(topic or '', poses)}")
        if (child := pose.child or self._carrier()) is not None:
            self._link_pose(pose, child)
        return pose

    def cycle(self) -> Sequence[str] | None:
        """The frames of a cycle above a sensor."""
        for path in self._paths():
            if path[-1] in path[:-1]:
                return path[path.index(path[-1]) :]
        return None

    def common(self) -> list[str]:
        """The frames that the paths of all sensors have in common, from the sensors on."""
        return _common(self._paths())

    def world_frame(self) -> str | None:
        """The frame in common that does not move: `odom`, else `map`, else the topmost, unless that is a robot's."""
        common = self.common()
        for wanted in WORLD_FRAMES:
            for frame in common:
                if _last_part(frame) == wanted:
                    return frame
        top = common[-1]
        moves = any(link.constant is None for link in self._links_below(top))
        is_body = _last_part(top) in BODY_FRAMES or any(pose.child == top for pose in self._tree.poses.values())
        return top if moves and not is_body else None

    def chains(self, world: str) -> dict[str, Chain]:
        """The chain of each topic from `world` down to its sensor."""
        made = {}
        for topic, start in self._starts.items():
            path = self._path(start)
            below = path[: path.index(world)]
            made[topic] = Chain(world, tuple(self._links[child] for child in reversed(below)))
        return made

    def on_poses(self, pose: PoseTopic) -> Chains:
        """The chains from the frame of a topic's poses; with a problem where a sensor's mount is not known."""
        carrier, problem = self._carrier(), ""
        if self._parent(pose) not in self.common():
            if carrier is None:
                return self.at_rest(self.why_not_together())
            self._link(carrier, pose.child, pose.topic, SE3())
            problem = mount_not_known(self._options, pose, self._name_of(carrier))
        elif carrier is not None and not pose.child and carrier in self._starts.values():
            is_body = _last_part(carrier) in BODY_FRAMES
            problem = "" if is_body else mount_not_known(self._options, pose, self._name_of(carrier))
        chains = self.chains(self._parent(pose))
        return Chains(chains, problem if any(chain.moving for chain in chains.values()) else "")

    def without_world_frame(self) -> Chains:
        """The chains where no transforms lead to a world frame: from the only poses there are, else at rest."""
        frames, poses = self._frames_not_reached(), self._poses_not_used()
        if len(poses) == 1 and not frames and (poses[0].child or _is_dense(poses[0])):
            if (child := poses[0].child or self._carrier()) is not None:
                self._link_pose(poses[0], child)
            return self.on_poses(poses[0])
        topic, start = next(iter(self._starts.items()))
        name = self._options.sensors[topic]
        if poses:
            mounted = len(self._path(start)) > 1
            return self.at_rest(poses_not_known(self._options, poses, frames, name, start, is_mounted=mounted))
        return self.at_rest(sensor_not_reached(self._options, frames, name, start) if frames else "")

    def at_rest(self, problem: str) -> Chains:
        """The sensors at rest in what carries them, each at its origin where that is not known."""
        common = [] if self.cycle() else self.common()
        if common:
            return Chains(self.chains(common[-1]), problem)
        return Chains({topic: Chain(start) for topic, start in self._starts.items()}, problem)

    def why_not_together(self) -> str:
        """The problem of sensors without a frame in common."""
        sensors = self._options.sensors
        alone = [name for topic, name in sensors.items() if len(self._path(self._starts[topic])) == 1]
        moves = any(link.constant is None for link in self._links.values()) or bool(self._poses_not_used())
        return mounts_not_known(self._options, alone or list(sensors.values()), moves)

    def _link(self, child: str, parent: str, source: str, constant: SE3 | None) -> None:
        self._links[child] = Link(child, parent, source, constant)

    def _link_pose(self, pose: PoseTopic, child: str) -> None:
        self._link(child, self._parent(pose), pose.topic, pose.motion.first if pose.motion.constant else None)

    @staticmethod
    def _parent(pose: PoseTopic) -> str:
        """The frame of a topic's poses; the topic itself where its messages do not name one."""
        return pose.frame if pose.frame not in ("", pose.child) else pose.topic

    def _path(self, start: str) -> list[str]:
        """The frames from a sensor up; in a cycle the last is one of those before it."""
        path, seen = [start], {start}
        while (link := self._links.get(path[-1])) is not None:
            path.append(link.parent)
            if link.parent in seen:
                break
            seen.add(link.parent)
        return path

    def _paths(self) -> list[list[str]]:
        return [self._path(start) for start in self._starts.values()]

    def _rigid_path(self, start: str) -> list[str]:
        """The frames from a sensor up to the topmost one that it does not move in, world frames left out."""
        path = [start]
        for frame in self._path(start)[1:]:
            if self._links[path[-1]].constant is None or _last_part(frame) in WORLD_FRAMES:
                break
            path.append(frame)
        return path

    def _carrier(self) -> str | None:
        """The topmost frame that no sensor moves in; for a sensor without a mount its own. None for several such."""
        common = _common([self._rigid_path(start) for start in self._starts.values()])
        return common[-1] if common else None

    def _body(self) -> str:
        """The frame that a mount without a parent is on: that of the poses named, else the robot's body, if it moves.

        Where no body moves, the child of the only poses that name one, else a body at rest.
        """
        pose = self._tree.poses.get(self._options.pose_topic or "")
        if pose is not None and pose.child:
            return pose.child
        frames = dict.fromkeys(frame for link in self._links.values() for frame in (link.child, link.parent))
        bodies = [frame for body in BODY_FRAMES for frame in frames if _last_part(frame) == body]
        moving = [frame for frame in bodies if self._moves(frame)]
        children = dict.fromkeys(pose.child for pose in self._tree.poses.values() if pose.child)
        candidates = moving or (list(children) if len(children) == 1 else []) or bodies
        alike = [frame for frame in candidates if _last_part(frame) == _last_part(candidates[0])]
        return candidates[0] if len(alike) == 1 else BODY_FRAMES[0]

    def _moves(self, frame: str) -> bool:
        """Whether a link above a frame moves."""
        return any((link := self._links.get(above)) and link.constant is None for above in self._path(frame))

    def _name_of(self, start: str) -> str:
        """The sensor whose frame is `start`, else the first one."""
        names = {self._starts[topic]: name for topic, name in self._options.sensors.items()}
        return names.get(start, next(iter(names.values())))

    def _links_below(self, frame: str) -> list[Link]:
        """The links between `frame` and the sensors."""
        return [link for chain in self.chains(frame).values() for link in chain.links]

    def _frames_not_reached(self) -> list[Link]:
        """The links of transforms that move, and that are not in the tree of the sensors."""
        top = self.common()[-1]
        moving = [link for link in self._links.values() if link.constant is None and link.child in self._tree.edges]
        return [link for link in moving if self._path(link.child)[-1] != top]

    def _poses_not_used(self) -> list[PoseTopic]:
        """The topics whose poses move, and are those of a frame without a place in the transforms."""
        if self._options.pose_topic == NO_POSES:
            return []
        poses = self._tree.poses.values()
        return [pose for pose in poses if not pose.motion.constant and pose.child not in self._tree.edges]


def _is_dense(pose: PoseTopic) -> bool:
    """Whether poses come often enough for those of a sensor: a goal or a localisation does not."""
    return pose.motion.longest_gap_ns <= MAX_POSE_GAP_NS


def _common(paths: Sequence[Sequence[str]]) -> list[str]:
    """The frames of the first path that all the others hold, in its order."""
    others = [set(path) for path in paths[1:]]
    return [frame for frame in (paths[0] if paths else ()) if all(frame in other for other in others)]


def _start(frame: str, sensor: str) -> str:
    """The frame of a sensor; its own name where its scans have none that can be shown."""
    return frame if is_label(frame) else sensor


def _last_part(frame: str) -> str:
    """`odom` of `robot1/odom`."""
    return frame.rpartition("/")[2]

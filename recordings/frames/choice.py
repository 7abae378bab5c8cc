"""The choice of the chain of each sensor, from what a recording holds and what the options say.

The first of these that tells the place of a frame is used: the options `--mount` and `--pose-topic`; the transforms
(`/tf`, `/tf_static`); a topic with poses that names the frame as its child (nav_msgs/Odometry), where it is the only
one. Poses that do not name their frame (geometry_msgs/PoseStamped) are those of what carries the sensors, and are used
where nothing else in the recording moves. Links are followed upwards, and where no world frame is found so, both ways:
some robots record the place of `odom` on the robot, or the pose of a camera that is mounted on it. Of the transforms of
a link that come on several topics, as of several robots, each sensor has those beside its scans.
"""

from __future__ import annotations

from gridtrack.recordings.frames import problems
from gridtrack.recordings.frames.chains import Chain, ChainOptions, Chains, FrameLinks, Link, parent_of
from gridtrack.recordings.frames.transform import SE3
from gridtrack.recordings.frames.tree import WORLD_WORDS, Edge, FrameTree, PoseTopic, has_word, is_body

MAX_POSE_GAP_NS = 1_000_000_000


def chosen_chains(tree: FrameTree, options: ChainOptions) -> Chains:
    """The chain of each sensor.

    Raises RecordingError for a pose topic that is not there, ConfigurationError for a mount of no sensor.
    """
    if not options.sensors:
        return Chains()
    chains = _Choice(tree, options).chains()
    if not chains.problem and not options.stand:
        chains.notes += tuple(problems.seldom_told(tree, chains.of_topic))
    chains.faults = tuple(problems.several_topics(options, tree, chains.of_topic))
    return chains


class _Choice:
    """The links of the frames, and which of them lead to the sensors."""

    def __init__(self, tree: FrameTree, options: ChainOptions) -> None:
        self._tree, self._options = tree, options
        self._links = FrameLinks(tree, options)

    def chains(self) -> Chains:
        """The chain of each sensor, as `chosen_chains` says."""
        links, options = self._links, self._options
        links.add_named_poses()
        links.add_mounts()
        given = links.add_pose_topic()
        if (looped := links.cycle()) is not None:
            matters = not options.stand or len(options.sensors) > 1
            return self._at_rest(problems.frames_in_a_cycle(options, looped, list(self._tree.poses)) if matters else "")
        if not links.common():
            return self._at_rest(self._why_not_together())
        if given is not None:
            return self._on_poses(given)
        world = self._world_frame() or self._world_frame_below()
        if world is None:
            return self._without_world_frame()
        chains = links.chains(world)
        return Chains(chains, notes=tuple(problems.motion_above(options, links.forest, world, chains)))

    def _world_frame(self) -> str | None:
        """The frame in common that does not move: `odom`, else `map`, else the topmost, unless that is a robot's.

        `odom` and `map` are not, where they move and the sensors stand still in them for all times: SLAM without wheel
        odometry gives the motion so, above a static `odom`.
        """
        common = self._links.common()
        for word in WORLD_WORDS:
            for frame in common:
                if has_word(frame, word) and not self._is_carried(frame):
                    return frame
        top = common[-1]
        moves = any(chain.moving for chain in self._links.chains(top).values())
        is_robots = is_body(top) or any(pose.child == top for pose in self._tree.poses.values())
        return top if moves and not is_robots else None

    def _world_frame_below(self) -> str | None:
        """A world frame whose place on the robot is recorded, and moves: it becomes the top of the tree."""
        top, forest = self._links.common()[-1], self._links.forest
        below = [one for one in forest.frames if forest.top(one) == top and forest.moves(one)]
        for word in WORLD_WORDS:
            for frame in below:
                if has_word(frame, word):
                    forest.turn(frame)
                    return frame
        return None

    def _is_carried(self, frame: str) -> bool:
        """Whether a frame moves in one above it, and all links down to the sensors are the same for all times."""
        if not self._links.forest.moves(frame):
            return False
        recorded = {link.recorded for chain in self._links.chains(frame).values() for link in chain.links}
        edges = [self._tree.edge(*one) for one in recorded if one[0] not in self._tree.poses]
        return len(edges) == len(recorded) and all(edge is None or edge.is_static for edge in edges)

    def _on_poses(self, pose: PoseTopic) -> Chains:
        """The chains from the frame of a topic's poses; with a problem where a sensor's mount is not known."""
        carrier, problem = self._links.carrier(), ""
        if parent_of(pose) not in self._links.common():
            if carrier is None:
                return self._at_rest(self._why_not_together())
            self._links.forest.put(Link(carrier, pose.child, pose.topic, SE3()))
            problem = problems.mount_not_known(self._options, pose, self._name_of(carrier))
        elif carrier is not None and not pose.child and carrier in self._links.starts.values():
            problem = "" if is_body(carrier) else problems.mount_not_known(self._options, pose, self._name_of(carrier))
        chains = self._links.chains(parent_of(pose))
        return Chains(chains, problem if any(chain.moving for chain in chains.values()) else "")

    def _without_world_frame(self) -> Chains:
        """The chains where no transforms lead to a world frame: from the only poses there are, else at rest."""
        options, frames, poses = self._options, self._frames_not_reached(), self._poses_not_used()
        if len(poses) == 1 and not frames and (poses[0].child or _is_dense(poses[0])):
            if (child := poses[0].child or self._links.carrier()) is not None:
                self._links.join(poses[0], child)
            return self._on_poses(poses[0])
        topic, start = next(iter(self._links.starts.items()))
        name = options.sensors[topic]
        if poses:
            mounted = start in self._links.forest
            return self._at_rest(problems.poses_not_known(options, poses, frames, name, start, is_mounted=mounted))
        if frames:
            return self._at_rest(problems.sensor_not_reached(options, frames, name, start))
        unused = self._motion_not_used()
        return self._at_rest(problems.motion_not_used(options, *unused) if unused else "")

    def _at_rest(self, problem: str) -> Chains:
        """The sensors at rest in what carries them, each at its origin where that is not known."""
        common = [] if self._links.cycle() else self._links.common()
        if common:
            return Chains(self._links.chains(common[-1]), problem)
        return Chains({topic: Chain(start) for topic, start in self._links.starts.items()}, problem)

    def _why_not_together(self) -> str:
        """The problem of sensors without a frame in common."""
        sensors, forest = self._options.sensors, self._links.forest
        alone = [name for topic, name in sensors.items() if self._links.starts[topic] not in forest]
        moves = any(link.moves for link in forest.links) or bool(self._poses_not_used())
        return problems.mounts_not_known(self._options, alone or list(sensors.values()), moves)

    def _name_of(self, start: str) -> str:
        """The sensor whose frame is `start`, else the first one."""
        names = {self._links.starts[topic]: name for topic, name in self._options.sensors.items()}
        return names.get(start, next(iter(names.values())))

    def _frames_not_reached(self) -> list[Link]:
        """The links of transforms that move, and that are not in the tree of the sensors."""
        top, forest = self._links.common()[-1], self._links.forest
        moving = [link for link in forest.links if link.moves and link.source not in self._tree.poses]
        return [link for link in moving if forest.top(link.child) != top]

    def _poses_not_used(self) -> list[PoseTopic]:
        """The topics whose poses move, and are not of frames whose place transforms tell in the frame of the poses."""
        if self._options.stand:
            return []
        return [pose for pose in self._tree.poses.values() if not pose.motion.constant and not self._is_told(pose)]

    def _is_told(self, pose: PoseTopic) -> bool:
        forest = self._links.forest
        return pose.child in self._tree.edges and forest.top(pose.child) == forest.top(parent_of(pose))

    def _motion_not_used(self) -> tuple[str, Edge] | None:
        """A frame of the sensors' tree that moves in a second parent, while nothing else of the tree does."""
        top, forest = self._links.common()[-1], self._links.forest
        seconds = self._tree.second_parents.items() if not self._options.stand else ()
        return next(((child, edge) for child, edge in seconds if edge.moves and forest.top(child) == top), None)


def _is_dense(pose: PoseTopic) -> bool:
    """Whether poses come often enough for those of a sensor: a goal or a localisation does not."""
    return pose.motion.longest_gap_ns <= MAX_POSE_GAP_NS

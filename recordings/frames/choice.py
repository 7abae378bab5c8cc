"""The choice of the chain of each sensor, from the transforms and poses of a recording and the options.

The transform of a frame comes from the first of these sources:

1. the options `--mount` and `--pose-topic`;
2. the transforms (`/tf`, `/tf_static`);
3. the only topic with poses of this child frame (nav_msgs/Odometry).

Poses without a child frame (geometry_msgs/PoseStamped) are assumed to be of the robot that carries the sensors, and are
used if nothing else in the recording moves. Links are followed upwards; if this leads to no world frame, also
downwards: some robots record the transform of `odom` in the robot, or the pose of a camera mounted on it. If several
topics have the same link (several robots), each sensor uses the one in the namespace of its scans.
"""

from __future__ import annotations

from gridtrack.recordings.frames import problems
from gridtrack.recordings.frames.chains import Chain, ChainOptions, Chains, Forest, FrameLinks, Link, parent_of
from gridtrack.recordings.frames.transform import SE3
from gridtrack.recordings.frames.tree import WORLD_WORDS, Edge, FrameTree, PoseTopic, has_word, is_body, is_world

MAX_POSE_GAP_NS = 1_000_000_000


def chosen_chains(tree: FrameTree, options: ChainOptions) -> Chains:
    """The chain of each sensor.

    Raises RecordingError for an unknown pose topic, ConfigurationError for a mount of an unknown sensor.
    """
    if not options.sensors:
        return Chains()
    choice = _Choice(tree, options)
    chains = choice.chains()
    chains.forest = choice.forest
    if not chains.problem and not options.at_rest:
        chains.notes += tuple(problems.rare_transforms(tree, chains.of_topic))
    chains.faults = tuple(problems.several_topics(options, tree, chains.of_topic))
    return chains


class _Choice:
    """The links between frames, and the choice of the links that lead to the sensors."""

    def __init__(self, tree: FrameTree, options: ChainOptions) -> None:
        self._tree, self._options = tree, options
        self._links = FrameLinks(tree, options)

    @property
    def forest(self) -> Forest:
        """All links between frames."""
        return self._links.forest

    def chains(self) -> Chains:
        """The chain of each sensor."""
        links, options = self._links, self._options
        links.add_named_poses()
        links.add_mounts()
        given = links.add_pose_topic()
        if (cycle := links.cycle()) is not None:
            matters = not options.at_rest or len(options.sensors) > 1
            return self._at_rest(problems.frames_in_a_cycle(options, cycle, list(self._tree.poses)) if matters else "")
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
        """The world frame that the sensors have in common: `odom`, else `map`, else the topmost if not a robot's.

        Not an `odom` or `map` that moves while the sensors are at rest in it: SLAM without wheel odometry records the
        motion above a static `odom`.
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
        """A world frame with a recorded moving transform in the robot; it becomes the root of the tree."""
        top, forest = self._links.common()[-1], self._links.forest
        below = [one for one in forest.frames if forest.top(one) == top and forest.moves(one)]
        for word in WORLD_WORDS:
            for frame in below:
                if has_word(frame, word):
                    forest.make_root(frame)
                    return frame
        return None

    def _is_carried(self, frame: str) -> bool:
        """Whether a frame moves in a frame above it, and all links from it to the sensors are static."""
        if not self._links.forest.moves(frame):
            return False
        keys = {link.key for chain in self._links.chains(frame).values() for link in chain.links}
        edges = [self._tree.edge(*key) for key in keys if key[0] not in self._tree.poses]
        return len(edges) == len(keys) and all(edge is None or edge.is_static for edge in edges)

    def _on_poses(self, pose: PoseTopic) -> Chains:
        """The chains from the frame of a topic's poses; with a problem if a sensor's mount is not known."""
        carrier, problem = self._links.carrier(), ""
        if parent_of(pose) not in self._links.common():
            if carrier is None:
                return self._at_rest(self._why_not_together())
            self._links.forest.put(Link(carrier, pose.child, pose.topic, SE3()))
            problem = problems.unknown_mount(self._options, pose, self._name_of(carrier))
        elif carrier is not None and not pose.child and carrier in self._links.starts.values():
            problem = "" if is_body(carrier) else problems.unknown_mount(self._options, pose, self._name_of(carrier))
        chains = self._links.chains(parent_of(pose))
        return Chains(chains, problem if any(chain.moving for chain in chains.values()) else "")

    def _without_world_frame(self) -> Chains:
        """The chains if no transforms lead to a world frame: from the only poses, else at rest."""
        options, frames, poses = self._options, self._unconnected_links(), self._unused_poses()
        if len(poses) == 1 and not frames and (poses[0].child or _is_dense(poses[0])):
            if (child := poses[0].child or self._links.carrier()) is not None:
                self._links.join(poses[0], child)
            return self._on_poses(poses[0])
        topic, start = next(iter(self._links.starts.items()))
        name = options.sensors[topic]
        if (lost := self._lost_motion()) is not None:
            return self._at_rest(problems.unusable_poses(options, *lost))
        if poses:
            mounted = start in self._links.forest
            return self._at_rest(problems.ambiguous_poses(options, poses, frames, name, start, is_mounted=mounted))
        if frames:
            return self._at_rest(problems.unconnected_sensor(options, frames, name, start))
        unused = self._unused_motion()
        return self._at_rest(problems.unused_motion(options, *unused) if unused else "")

    def _at_rest(self, problem: str) -> Chains:
        """The sensors at rest in the topmost common frame, each at the origin if there is none."""
        common = [] if self._links.cycle() else self._links.common()
        if common:
            return Chains(self._links.chains(common[-1]), problem)
        return Chains({topic: Chain(start) for topic, start in self._links.starts.items()}, problem)

    def _why_not_together(self) -> str:
        """The problem of sensors without a frame in common."""
        sensors, forest = self._options.sensors, self._links.forest
        alone = [name for topic, name in sensors.items() if self._links.starts[topic] not in forest]
        moves = any(link.moves for link in forest.links) or bool(self._unused_poses())
        return problems.unknown_mounts(self._options, alone or list(sensors.values()), moves)

    def _name_of(self, start: str) -> str:
        """The sensor with the frame `start`, else the first one."""
        names = {self._links.starts[topic]: name for topic, name in self._options.sensors.items()}
        return names.get(start, next(iter(names.values())))

    def _unconnected_links(self) -> list[Link]:
        """The moving links of transforms outside the tree of the sensors."""
        top, forest = self._links.common()[-1], self._links.forest
        moving = [link for link in forest.links if link.moves and link.source not in self._tree.poses]
        return [link for link in moving if forest.top(link.child) != top]

    def _unused_poses(self) -> list[PoseTopic]:
        """The topics with moving poses, except poses that transforms already give."""
        if self._options.at_rest:
            return []
        poses = self._tree.poses.values()
        return [pose for pose in poses if not pose.motion.constant and not self._is_in_transforms(pose)]

    def _is_in_transforms(self, pose: PoseTopic) -> bool:
        forest = self._links.forest
        return pose.child in self._tree.edges and forest.top(pose.child) == forest.top(parent_of(pose))

    def _lost_motion(self) -> tuple[str, str] | None:
        """Topic and child frame of unusable transforms or poses above the sensors."""
        common = self._links.common()
        for child, (topic, parent) in self._tree.unusable.items() if not self._options.at_rest else ():
            is_above = child in common or (parent in common and is_world(child)) or not child
            if is_above and child not in self._tree.edges and topic not in self._tree.poses:
                return topic, child or parent
        return None

    def _unused_motion(self) -> tuple[str, Edge] | None:
        """A frame in the sensors' tree that moves in its second parent only."""
        top, forest = self._links.common()[-1], self._links.forest
        seconds = self._tree.second_parents.items() if not self._options.at_rest else ()
        return next(((child, edge) for child, edge in seconds if edge.moves and forest.top(child) == top), None)


def _is_dense(pose: PoseTopic) -> bool:
    """Whether poses are frequent enough for a sensor's; goals and localisation results are rarer."""
    return pose.motion.longest_gap_ns <= MAX_POSE_GAP_NS

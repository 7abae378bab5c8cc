"""The tree of coordinate frames of a recording, and its topics with poses."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Literal, NamedTuple

from gridtrack.common.files import LABEL_RULE, is_label
from gridtrack.recordings.frames.transform import SE3

WORLD_WORDS = ("odom", "map")
"""Words in the names of world frames; `odom` first, since it is continuous."""
BODY_FRAMES = ("base_link", "base_footprint")
"""Frames of a robot's body."""
FAR_JUMP_NS = 10_000_000_000
USUAL_GAPS = 2
"""Of rare stamps, the next one may be this many times as far away as the last one was."""
MAX_TREE_FRAMES = 1000
"""Limit of the frames of a recording; a robot with two arms has a hundred."""
MAX_POSE_TOPICS, MAX_FAULTS = 100, 20
MAX_FRAMES_ON_TOPIC, LASER_SHARE = 8, 0.1
"""Limit of the frames of scans on one topic, and the least share of its scans for the frame of a laser."""
Judgement = Literal["near", "held", "confirmed", "restarted"]
"""`held`: far from the newest stamp. `confirmed`: close to the held stamp, or as far after it as that is after the
stamps before, so that both are correct. `restarted`: both are correct, and the stamps before are not comparable,
because they are later, or a single one.
"""


def frame_name(name: str) -> str:
    """A frame's name without the slash that ROS 1 may write before it."""
    return name.removeprefix("/")


def last_part(frame: str) -> str:
    """`odom` of `robot1/odom`."""
    return frame.rpartition("/")[2]


def has_word(frame: str, word: str) -> bool:
    """Whether a frame's name contains a word such as `odom`: `robot1/odom`, `odom_combined`, `tb_odom`."""
    return word in last_part(frame).lower().split("_")


def is_world(frame: str) -> bool:
    """Whether a frame's name is a world frame's."""
    return any(has_word(frame, word) for word in WORLD_WORDS)


def is_body(frame: str) -> bool:
    """Whether a frame is a robot's body: `base_link`, `robot1/base_link`, `tb_base_link`."""
    return last_part(frame).endswith(BODY_FRAMES)


class FarStamps:
    """Judges the stamps of one topic or frame in the order of the file."""

    def __init__(self) -> None:
        self.last_ns = 0
        """The newest stamp that is near others, or the only one."""
        self._judged = 0
        self._held_ns: int | None = None
        self._near_ns = FAR_JUMP_NS
        """A stamp that is later by at most this is near. Larger if all stamps are rare."""

    def judge(self, stamp_ns: int) -> Judgement:
        """Whether a stamp is near the stamps before it."""
        held_ns, self._held_ns = self._held_ns, None
        if self._judged == 0 or -FAR_JUMP_NS <= stamp_ns - self.last_ns <= self._near_ns:
            self.last_ns = max(self.last_ns, stamp_ns) if self._judged else stamp_ns
            self._judged += 1
            return "near"
        if held_ns is None or not (abs(stamp_ns - held_ns) <= FAR_JUMP_NS or self.last_ns < held_ns < stamp_ns):
            self._held_ns = stamp_ns
            return "held"
        goes_on = self.last_ns < held_ns < stamp_ns - FAR_JUMP_NS
        restarts = held_ns < self.last_ns or (self._judged == 1 and not goes_on)
        self._near_ns = USUAL_GAPS * max(held_ns - self.last_ns, stamp_ns - held_ns) if goes_on else FAR_JUMP_NS
        self.last_ns, self._judged = max(held_ns, stamp_ns), self._judged + 2
        return "restarted" if restarts else "confirmed"


class StampedTransform(NamedTuple):
    """`parent_T_child` at a stamp; None if the numbers of the message are not a transform."""

    stamp_ns: int
    parent: str
    child: str
    transform: SE3 | None


class FrameMotion:
    """Statistics of the transforms of a frame, or the poses of a topic, from one pass over them."""

    def __init__(self, first_ns: int, first: SE3, *, may_move: bool = False) -> None:
        """`may_move`: they count as moving even if they have been constant so far."""
        self.first = first
        self.constant = not may_move
        self.longest_gap_ns = 0
        self.contradicts = False
        """Whether two transforms with the same stamp differ."""
        self.number = 1
        """The number of transforms with stamps near others."""
        self._last = first_ns, first
        self._held: tuple[int, SE3] | None = None
        self._far = FarStamps()
        self._far.judge(first_ns)

    @property
    def after_gap(self) -> tuple[int, SE3] | None:
        """The last transform, left out because its stamp is far after the others: distance (ns) and transform."""
        if self._held is None or self._held[0] < self._far.last_ns:
            return None
        return self._held[0] - self._far.last_ns, self._held[1]

    def add(self, stamp_ns: int, transform: SE3) -> None:
        """Add the next transform in the order of the file; one with a stamp far from the others does not count."""
        last_ns, last = self._last
        self._last = stamp_ns, transform
        self.contradicts |= stamp_ns == last_ns and not transform.is_same(last)
        before_ns = self._far.last_ns
        judgement = self._far.judge(stamp_ns)
        held, self._held = self._held, (stamp_ns, transform) if judgement == "held" else None
        if judgement == "held":
            return
        added = [(stamp_ns, transform)] if judgement == "near" or held is None else [held, (stamp_ns, transform)]
        if judgement == "restarted":
            self.first = added[0][1] if self.number == 1 else self.first
        else:
            stamps_ns = [before_ns, *(one_ns for one_ns, _ in added)]
            self.longest_gap_ns = max(self.longest_gap_ns, *(after - one for one, after in pairwise(stamps_ns)))
        self.number += len(added)
        self.constant = self.constant and all(one.is_same(self.first) for _, one in added)


@dataclass(slots=True)
class Edge:
    """The transforms of a frame in its parent, from one topic, or from one static topic and another one.

    `topic` is the first of these topics; `is_static`: one transform holds for all times.
    """

    parent: str
    topic: str
    is_static: bool
    motion: FrameMotion
    topics: dict[bool, str] = field(default_factory=dict)
    """The topic with static transforms (True) and the other topic (False)."""

    def accepts(self, topic: str, is_static: bool) -> bool:
        """Whether transforms of a topic belong to this edge; the first topic of each kind does."""
        return self.topics.setdefault(is_static, topic) == topic

    @property
    def moves(self) -> bool:
        """Whether the frame moves in its parent."""
        return not (self.is_static or self.motion.constant)


@dataclass(frozen=True, slots=True)
class PoseTopic:
    """A topic with poses of `child` in `frame`; `child` is empty if the messages do not name it."""

    topic: str
    frame: str
    child: str
    motion: FrameMotion


@dataclass
class FrameTree:
    """Frames with their parents, topics with poses, and the frame of each topic with scans, from one pass over a file.

    The first parent of a frame is kept; `second_parents` has the first of its other parents. `edges` have the
    transforms from the first topic of a frame, `other_topics` those from other topics (robots with the same frame
    names). `faults` holds one line for each kind of fault and frame. In a `growing` file only static transforms count
    as constant.
    """

    growing: bool = False
    edges: dict[str, Edge] = field(default_factory=dict)
    other_topics: dict[str, list[Edge]] = field(default_factory=dict)
    second_parents: dict[str, Edge] = field(default_factory=dict)
    poses: dict[str, PoseTopic] = field(default_factory=dict)
    sensors: dict[str, str] = field(default_factory=dict)
    """Topic of the scans -> frame of the sensor, as its first scan names it; it may be empty. The scans of another
    laser on the topic have the name TOPIC@FRAME instead."""
    scan_frames: dict[str, dict[str, int]] = field(default_factory=dict)
    """Topic -> frame -> number of scans."""
    lasers: dict[str, str] = field(default_factory=dict)
    """TOPIC@FRAME of each further laser on a topic -> frame."""
    faults: dict[str, None] = field(default_factory=dict)
    unusable: dict[str, tuple[str, str]] = field(default_factory=dict)
    """Child of transforms or poses that are not finite or have no rotation -> topic and parent of the first."""

    def add_transforms(self, topic: str, is_static: bool, transforms: Iterable[StampedTransform]) -> None:
        """Add the transforms of a message."""
        for stamped in transforms:
            child, parent = frame_name(stamped.child), frame_name(stamped.parent)
            fault = self._fault(topic, parent, child, stamped.transform)
            if fault or stamped.transform is None:
                self.note(fault)
                if stamped.transform is None and len(self.unusable) < MAX_TREE_FRAMES:
                    self.unusable.setdefault(child, (topic, parent))
                continue
            known = self._known(topic, is_static, parent, child)
            if known is None:
                may_move = self.growing and not is_static
                motion = FrameMotion(stamped.stamp_ns, stamped.transform, may_move=may_move)
                self._put(child, Edge(parent, topic, is_static, motion, {is_static: topic}))
            elif known.parent == parent:
                self._add_to(known, child, stamped.stamp_ns, stamped.transform, is_static=is_static)

    def add_scan(self, topic: str, frame: str) -> None:
        """Count a scan on a topic in a frame; the first frame is its sensor's."""
        frame = frame_name(frame)
        self.sensors.setdefault(topic, frame)
        counts = self.scan_frames.setdefault(topic, {})
        if frame in counts or len(counts) < MAX_FRAMES_ON_TOPIC:
            counts[frame] = counts.get(frame, 0) + 1

    def separate_lasers(self) -> None:
        """Make a sensor of each frame that many scans on a topic have."""
        for topic, counts in self.scan_frames.items():
            for frame, number in counts.items():
                if frame != self.sensors[topic] and number >= LASER_SHARE * sum(counts.values()):
                    self.lasers[f"{topic}@{frame}"] = frame
        self.sensors |= self.lasers

    def add_poses(self, topic: str, poses: Iterable[StampedTransform]) -> None:
        """Add the poses of a message."""
        for pose in poses:
            if pose.transform is None:
                self.note(f"poses on {topic} that are not finite or have no rotation are left out")
                if len(self.unusable) < MAX_TREE_FRAMES:
                    self.unusable.setdefault(_label_or_empty(pose.child), (topic, _label_or_empty(pose.parent)))
            elif topic in self.poses:
                self.poses[topic].motion.add(pose.stamp_ns, pose.transform)
            elif len(self.poses) == MAX_POSE_TOPICS:
                self.note(f"more than {MAX_POSE_TOPICS} topics with poses: the others are not used")
            else:
                parent, child = (_label_or_empty(name) for name in (pose.parent, pose.child))
                child = "" if child == parent else child  # some drivers name their frame twice
                motion = FrameMotion(pose.stamp_ns, pose.transform, may_move=self.growing)
                self.poses[topic] = PoseTopic(topic, parent, child, motion)

    def edges_of(self, child: str) -> list[Edge]:
        """The edges of a frame to its first parent, the one from the first topic first."""
        return [self.edges[child], *self.other_topics.get(child, ())] if child in self.edges else []

    def edge(self, topic: str, child: str) -> Edge | None:
        """The edge of a frame with `topic` as its first topic."""
        return next((edge for edge in self.edges_of(child) if edge.topic == topic), None)

    def edge_with(self, topic: str, stamped: StampedTransform) -> Edge | None:
        """The edge that a transform on a topic belongs to; None for one that is not kept (to a second parent)."""
        parent, edges = frame_name(stamped.parent), self.edges_of(frame_name(stamped.child))
        return next((edge for edge in edges if edge.parent == parent and topic in edge.topics.values()), None)

    def edge_beside(self, scans: str, child: str) -> Edge:
        """The edge of a frame that has one: from the topic with the namespace of the topic `scans`, else the first.

        The innermost such namespace counts: `/robot1/tf` for `/robot1/scan`.
        """
        return max(self.edges_of(child), key=lambda edge: _depth_beside(edge.topic, scans))

    def rivals(self, child: str) -> tuple[str, ...]:
        """The topics with different transforms of a frame; none if they agree for all times."""
        edges = self.edges_of(child)
        agree = all(edge.is_static and edge.motion.first.is_same(edges[0].motion.first) for edge in edges)
        return () if agree or len(edges) < 2 else tuple(edge.topic for edge in edges)

    def note(self, fault: str) -> None:
        """Add a fault, once; at most MAX_FAULTS of them."""
        if len(self.faults) < MAX_FAULTS:
            self.faults[fault] = None
        elif fault not in self.faults:
            self.faults["more faults in the transforms"] = None

    def _fault(self, topic: str, parent: str, child: str, transform: SE3 | None) -> str:
        """Why a transform cannot be used; empty if it can."""
        bad_names = [name for name in (parent, child) if not is_label(name)]
        if bad_names:
            return f"transforms on {topic} with a frame named {bad_names[0][:40]!r} are left out: {LABEL_RULE}"
        if transform is None:
            return f"transforms on {topic} of frame '{child}' that are not finite or have no rotation are left out"
        if parent == child:
            return f"transforms on {topic} of frame '{child}' to itself are left out"
        if child not in self.edges and len(self.edges) == MAX_TREE_FRAMES:
            return f"more than {MAX_TREE_FRAMES} frames on {topic}: the others are not used"
        return ""

    def _known(self, topic: str, is_static: bool, parent: str, child: str) -> Edge | None:
        """The edge that a transform belongs to, or the one that precludes its own; None if it needs a new one."""
        first = self.edges.get(child)
        if first is not None and first.parent != parent:
            self.note(_two_parents(child, first, parent, topic))
            return self.second_parents.get(child)
        return next((edge for edge in self.edges_of(child) if edge.accepts(topic, is_static)), None)

    def _put(self, child: str, edge: Edge) -> None:
        """Keep a new edge."""
        first = self.edges.setdefault(child, edge)
        if first.parent != edge.parent:
            self.second_parents[child] = edge
        elif first is not edge and sum(map(len, self.other_topics.values())) == MAX_TREE_FRAMES:
            self.note(f"frames on several topics more than {MAX_TREE_FRAMES} times: those on {edge.topic} are not used")
        elif first is not edge:
            self.other_topics.setdefault(child, []).append(edge)

    def _add_to(self, edge: Edge, child: str, stamp_ns: int, transform: SE3, *, is_static: bool) -> None:
        """Add a transform of a known frame."""
        edge.is_static &= is_static
        edge.motion.add(stamp_ns, transform)
        if edge.motion.contradicts:
            self.note(f"transforms on {edge.topic} of frame '{child}' differ at one stamp: two sources may send them")
        if edge.is_static and not edge.motion.constant:
            self.note(f"static transforms on {edge.topic} of frame '{child}' change: the first is used")


def _two_parents(child: str, first: Edge, parent: str, topic: str) -> str:
    return (
        f"frame '{child}' has two parents, '{first.parent}' on {first.topic} and '{parent}' on {topic}: the first is"
        " used; if that is wrong, give the sensor's mount with --mount, or its poses with --pose-topic"
    )


def _depth_beside(topic: str, scans: str) -> int:
    """The length of a topic's namespace if it contains the topic `scans`, else 0."""
    namespace = topic.rpartition("/")[0] + "/"
    return len(namespace) if scans.startswith(namespace) else 0


def _label_or_empty(name: str) -> str:
    """A frame's name, empty if it is not printable."""
    return frame_name(name) if is_label(frame_name(name)) else ""

"""Transforms of moving frames by stamp, and the poses of scans from them."""

from __future__ import annotations

import bisect
import math
from array import array
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.errors import RecordingError
from gridtrack.common.scan import Scan
from gridtrack.recordings.frames.chains import Chain, LinkKey
from gridtrack.recordings.frames.transform import SE3, interpolated
from gridtrack.recordings.frames.tree import FarStamps
from gridtrack.recordings.stamp_order import MAX_STAMP_NS

MAX_GAP_NS = 1_000_000_000
MAX_KEPT = 100_000
MAX_TRANSFORMS = 5_000_000
"""Limit of the transforms of a finished file in memory, 64 bytes each: 14 hours of one link at 100 Hz."""
MAX_PARTS = 100
"""Times that the clock of one frame may be set back in a finished file."""
MAX_TILT_RAD = math.radians(15.0)
"""Limit of the tilt of a scan plane: at 15 degrees it is 2.6 m off at a distance of 10 m."""
MAX_WAITING = 1000
KEPT_NS = 3_000_000_000
"""Transforms are kept for scans that are written late."""


class Found(NamedTuple):
    """A transform at a stamp.

    `near`: the transforms before and after the stamp are less than MAX_GAP_NS apart, or a single one that near to it.
    `is_first`: it is the first transform, and the stamp is before it.
    """

    transform: SE3
    near: bool
    is_first: bool = False


class Trajectory:
    """Transforms of one frame, added in the order of the file; one with a stamp far from the others is left out.

    `whole`: all those of a finished file, so that no scan waits. If the clock was set back, the transforms of a time
    are then the first ones in the file; so are the scans (StampFilter). Else they are read together with the scans, and
    those of the last few seconds are kept.
    """

    def __init__(self, *, whole: bool) -> None:
        self._whole = whole
        self._parts = [_Packed()]
        self._sorted = True
        self._far = FarStamps()
        self._held: tuple[int, SE3] | None = None
        self.first_ns: int | None = None
        self.left_out = 0

    def __len__(self) -> int:
        return len(self._in_order().stamps)

    @property
    def last_ns(self) -> int:
        """The newest stamp."""
        return self._far.last_ns

    def add(self, stamp_ns: int, transform: SE3) -> None:
        """Add a transform; one with a stamp that no scan can have is left out, and it replaces one with its stamp.

        If its stamp is far from the stamps before, the next one decides whether it is used.
        """
        if not 0 <= stamp_ns < MAX_STAMP_NS:
            self.left_out += 1
            return
        judgement = self._far.judge(stamp_ns)
        held, self._held = self._held, None
        self.left_out += held is not None and judgement != "confirmed"
        if judgement == "held":
            self._held = (stamp_ns, transform)
            return
        if judgement == "restarted":
            self._restart()
        added = [(stamp_ns, transform)] if judgement == "near" or held is None else [held, (stamp_ns, transform)]
        for one_ns, one in added:
            self.first_ns = one_ns if self.first_ns is None else min(self.first_ns, one_ns)
            newest = self._parts[-1]
            self._sorted = self._sorted and len(self._parts) == 1 and (not newest.stamps or one_ns > newest.stamps[-1])
            newest.append(one_ns, one)
        if not self._whole and len(self._parts[-1].stamps) > 2 * MAX_KEPT:
            self.drop_before(-1)

    def covers(self, stamp_ns: int) -> bool:
        """Whether a scan at a stamp needs no later transforms; a single one may have a wrong stamp."""
        return self._whole or (len(self) > 1 and self.last_ns >= stamp_ns)

    def at(self, stamp_ns: int) -> Found | None:
        """The transform at a stamp, interpolated; None without any.

        In a gap of more than MAX_GAP_NS it is the last one before, and before the first one it is the first.
        """
        transforms = self._in_order()
        stamps = transforms.stamps
        if not stamps:
            return None
        index = bisect.bisect_left(stamps, stamp_ns)
        if index == len(stamps):
            return Found(transforms[-1], stamp_ns - stamps[-1] <= MAX_GAP_NS)
        after_ns = stamps[index]
        if index == 0 or after_ns == stamp_ns:
            return Found(transforms[index], after_ns - stamp_ns <= MAX_GAP_NS, after_ns > stamp_ns)
        before_ns = stamps[index - 1]
        if after_ns - before_ns > MAX_GAP_NS:
            return Found(transforms[index - 1], stamp_ns - before_ns <= MAX_GAP_NS)
        share = (stamp_ns - before_ns) / (after_ns - before_ns)
        return Found(interpolated(transforms[index - 1], transforms[index], share), True)

    def drop_before(self, stamp_ns: int) -> None:
        """Drop all before a stamp except the last of them, and all but the newest MAX_KEPT; none if it is `whole`."""
        if not self._whole:
            kept = self._in_order()
            kept.drop(max(bisect.bisect_right(kept.stamps, stamp_ns) - 1, len(kept.stamps) - MAX_KEPT, 0))

    def _restart(self) -> None:
        """Begin again: the clock was set back, or the only transform so far had a wrong stamp."""
        if not self._whole or len(self._parts[-1].stamps) == 1:
            self._parts[-1] = _Packed()
        elif len(self._parts) < MAX_PARTS:
            self._parts.append(_Packed())
            self._sorted = False

    def _in_order(self) -> _Packed:
        """All transforms in the order of their stamps."""
        if not self._sorted:
            self._parts, self._sorted = [_merged(self._parts)], True
        return self._parts[0]


class _Packed:
    """Stamps and transforms as arrays of numbers, 64 bytes each."""

    def __init__(self, stamps: bytes = b"", numbers: bytes = b"") -> None:
        """`stamps`: (n,) int64, nanoseconds; `numbers`: (n, 7) float64, translations and quaternions."""
        self.stamps, self._numbers = array("q", stamps), array("d", numbers)

    def __getitem__(self, index: int, /) -> SE3:
        start = 7 * (index % len(self.stamps))
        x, y, z, qx, qy, qz, qw = self._numbers[start : start + 7]
        return SE3((x, y, z), (qx, qy, qz, qw))

    @property
    def numbers(self) -> NDArray[np.float64]:
        """Translations and quaternions (n, 7)."""
        return np.frombuffer(self._numbers, np.float64).reshape(-1, 7)

    def append(self, stamp_ns: int, transform: SE3) -> None:
        self.stamps.append(stamp_ns)
        self._numbers.extend((*transform.translation, *transform.rotation))

    def drop(self, count: int) -> None:
        """Drop the first ones."""
        del self.stamps[:count], self._numbers[: 7 * count]


def _merged(parts: Sequence[_Packed]) -> _Packed:
    """All transforms in the order of their stamps; each part adds the times that the parts before it do not cover."""
    stamps, numbers = np.empty(0, np.int64), np.empty((0, 7))
    for part in parts:
        own = np.frombuffer(part.stamps, np.int64)
        order = np.argsort(own, kind="stable")
        is_last = np.append(own[order][1:] != own[order][:-1], True)[: len(own)]  # of equal stamps
        rows = order[is_last]
        rows = rows[~_within(stamps, own[rows])]
        stamps, numbers = np.concatenate([stamps, own[rows]]), np.concatenate([numbers, part.numbers[rows]])
        order = np.argsort(stamps, kind="stable")
        stamps, numbers = stamps[order], numbers[order]
    return _Packed(stamps.tobytes(), numbers.tobytes())


def _within(stamps: NDArray[np.int64], others: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which of `others` (m,) are one of the sorted `stamps` (n,), or between two of them without a gap."""
    after = np.searchsorted(stamps, others)
    inside = (after > 0) & (after < len(stamps))
    inside[inside] = np.diff(stamps)[after[inside] - 1] <= MAX_GAP_NS
    within: NDArray[np.bool_] = inside | np.isin(others, stamps)
    return within


class ClocksApartError(RecordingError):
    """Scans and poses have different clocks."""


@dataclass(frozen=True, slots=True)
class FramedScan:
    """A scan before it has a pose: its topic, its frame, and the pose of its sensor in that frame."""

    topic: str
    frame: str
    scan: Scan
    frame_T_sensor: SE3 | None = None


class ScansOnChains:
    """Gives each scan its pose on its chain. Scans wait until the transforms after them are read.

    A scan waits for the scans of one second at most, and one more. If transforms are more than a second apart, or away
    from the scan, it gets the last ones before it (at the beginning of the file the first ones), and `warn` receives a
    line at the end.
    """

    def __init__(
        self,
        chains: Mapping[str, Chain],
        warn: Callable[[str], None],
        known: Mapping[LinkKey, Trajectory] | None = None,
    ) -> None:
        """`chains` by topic; `known`: all transforms of every moving link, None if they are added with the scans."""
        self._chains, self._warn = chains, warn
        moving = {link.key for chain in chains.values() for link in chain.moving}
        self._trajectories = {key: Trajectory(whole=False) for key in moving} if known is None else known
        self._waiting: deque[FramedScan] = deque()
        self._last_two_ns: dict[str, tuple[int, int]] = {}
        """The last two stamps of each topic: one of them may be damaged."""
        self._between_ns: tuple[int, int] | None = None
        self._faults: dict[str, int] = {}

    def scan(self, framed: FramedScan) -> Iterator[Scan]:
        """Add the next scan; yields the scans that no longer wait."""
        stamp_ns = framed.scan.stamp_ns
        _, before_ns = self._last_two_ns.get(framed.topic, (stamp_ns, stamp_ns))
        self._last_two_ns[framed.topic] = before_ns, stamp_ns
        first_ns, last_ns = self._between_ns or (stamp_ns, stamp_ns)
        self._between_ns = min(first_ns, stamp_ns), max(last_ns, stamp_ns)
        self._waiting.append(framed)
        yield from self._released()

    def transform(self, key: LinkKey, stamp_ns: int, transform: SE3) -> Iterator[Scan]:
        """Add the next recorded transform of a moving link; yields the scans that no longer wait."""
        self._trajectories[key].add(stamp_ns, transform)
        yield from self._released()

    def flush(self) -> Iterator[Scan]:
        """Yields the scans that still wait, and reports the faults. Raises ClocksApartError."""
        while self._waiting:
            yield from self._placed(self._waiting.popleft())
        self._check_clocks()
        for (source, frame), trajectory in self._trajectories.items():
            if trajectory.left_out:
                left_out = f"transforms of '{frame}' on {source} with a stamp far from the others are left out"
                self._faults[left_out] = trajectory.left_out
        for fault, count in self._faults.items():
            self._warn(f"{fault}: {count} of them")

    def _released(self) -> Iterator[Scan]:
        released = False
        while self._waiting and (self._is_due(self._waiting[0]) or len(self._waiting) > MAX_WAITING):
            released = True
            yield from self._placed(self._waiting.popleft())
        if released or not self._waiting:
            for trajectory in self._trajectories.values():
                trajectory.drop_before(min(trajectory.last_ns, self._newest_ns) - KEPT_NS)

    @property
    def _newest_ns(self) -> int:
        """The newest stamp that two scans of a topic have reached, else 0."""
        return max(map(min, self._last_two_ns.values()), default=0)

    def _is_due(self, framed: FramedScan) -> bool:
        stamp_ns = framed.scan.stamp_ns
        late = self._newest_ns - stamp_ns > MAX_GAP_NS
        # the two scans after it have earlier stamps: its stamp is damaged, and no transforms may come for it
        damaged = max(self._last_two_ns[framed.topic]) < stamp_ns
        moving = self._chains[framed.topic].moving
        return late or damaged or all(self._trajectories[link.key].covers(stamp_ns) for link in moving)

    def _placed(self, framed: FramedScan) -> Iterator[Scan]:
        """The scan with its pose in the plane; none if it is tilted too much."""
        scan, chain = framed.scan, self._chains[framed.topic]
        placement = self._world_T_sensor(framed, chain).placement()
        if placement.tilt_rad > MAX_TILT_RAD:
            limit = f"{math.degrees(MAX_TILT_RAD):g} deg"
            self.count(
                f"scans of sensor '{scan.sensor}' tilted by more than {limit} are left out (if its transforms are"
                " wrong, give its pose with --mount)"
            )
            return
        if placement.mirrored:
            scan = _turned_over(scan)
        yield replace(scan, world_T_sensor=placement.pose)

    def _world_T_sensor(self, framed: FramedScan, chain: Chain) -> SE3:
        world_T_frame = SE3()
        for link in chain.links:
            found = self._trajectories[link.key].at(framed.scan.stamp_ns) if link.moves else None
            if link.moves and (found is None or not found.near):
                is_first = found is None or found.is_first
                self.count(
                    f"scans of sensor '{framed.scan.sensor}' without poses on {link.source} ({link.parent} ->"
                    f" {link.child}) within 1 s get the {'first one after' if is_first else 'last one before'} them"
                )
            world_T_frame = world_T_frame @ link.parent_T_child(found.transform if found else None)
        return world_T_frame if framed.frame_T_sensor is None else world_T_frame @ framed.frame_T_sensor

    def count(self, fault: str) -> None:
        """Count a fault of a scan, reported at the end."""
        self._faults[fault] = self._faults.get(fault, 0) + 1

    def _check_clocks(self) -> None:
        """Raise ClocksApartError if all stamps of a link's transforms are long before or after all scans."""
        for (source, _), trajectory in self._trajectories.items():
            if trajectory.first_ns is None or self._between_ns is None:
                continue
            first_ns, last_ns = self._between_ns
            before_ns, after_ns = first_ns - trajectory.last_ns, trajectory.first_ns - last_ns
            if max(before_ns, after_ns) > MAX_GAP_NS:
                apart = f"{before_ns / 1e9:.1f} s before" if before_ns > 0 else f"{after_ns / 1e9:.1f} s after"
                raise ClocksApartError(
                    f"no pose on {source} at the time of a scan: their stamps are {apart} the scans: record poses and"
                    " scans with one clock, or import this recording with --ego-motion kiss-icp, or, if the robot"
                    " stands still, with --pose-topic none"
                )


def _turned_over(scan: Scan) -> Scan:
    """The scan of a sensor that is upside down: seen from above, its angles run clockwise."""
    last = None if scan.last_angle is None else -scan.last_angle
    return replace(scan, angle_min=-scan.angle_min, angle_increment=-scan.angle_increment, last_angle=last)

"""Scans placed on their chains; where the transforms are not known, each waits until those around it are read."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

from gridtrack.common.errors import RecordingError
from gridtrack.common.scan import Scan
from gridtrack.recordings.frames.chains import Chain
from gridtrack.recordings.frames.trajectory import MAX_GAP_NS, AllTransforms, NewestTransforms, Trajectory
from gridtrack.recordings.frames.transform import SE3

MAX_TILT_RAD = math.radians(15.0)
"""A scan plane that is tilted more is no plan of what stands around: at 15 deg it is 2.6 m off at 10 m."""
MAX_WAITING = 1000
KEPT_NS = 3_000_000_000
"""Transforms are kept for scans that are written later than others."""


class ClocksApartError(RecordingError):
    """Scans and poses have two clocks."""


@dataclass(frozen=True, slots=True)
class FramedScan:
    """A scan before it has a pose: its topic, its frame, and the pose of its sensor in that frame."""

    topic: str
    frame: str
    scan: Scan
    frame_T_sensor: SE3 | None = None


class ScansOnChains:
    """Gives each scan its pose on its chain; delays scans until the transforms after them are read, if they are not.

    A scan waits for a second of scans at most, and for one scan more. Where transforms are more than a second apart, or
    from the scan, it has the last ones before it (the first ones at the beginning of the file), and `warn` receives a
    line at the end.
    """

    def __init__(
        self,
        chains: Mapping[str, Chain],
        warn: Callable[[str], None],
        known: Mapping[tuple[str, str], AllTransforms] | None = None,
    ) -> None:
        """`chains` by topic; `known`: all transforms of every moving link, None where they are added with the scans."""
        self._chains, self._warn = chains, warn
        moving = {link.recorded for chain in chains.values() for link in chain.moving}
        self._trajectories: Mapping[tuple[str, str], Trajectory] = (
            {recorded: NewestTransforms() for recorded in moving} if known is None else known
        )
        self._waiting: deque[FramedScan] = deque()
        self._last_two_ns: dict[str, tuple[int, int]] = {}
        """Stamps of the last two scans of each topic: one of them may be damaged."""
        self._between_ns: tuple[int, int] | None = None
        self._faults: dict[str, int] = {}

    def scan(self, framed: FramedScan) -> Iterator[Scan]:
        """Add the next scan, and yield the scans that no longer wait."""
        stamp_ns = framed.scan.stamp_ns
        _, before_ns = self._last_two_ns.get(framed.topic, (stamp_ns, stamp_ns))
        self._last_two_ns[framed.topic] = before_ns, stamp_ns
        first_ns, last_ns = self._between_ns or (stamp_ns, stamp_ns)
        self._between_ns = min(first_ns, stamp_ns), max(last_ns, stamp_ns)
        self._waiting.append(framed)
        yield from self._released()

    def transform(self, recorded: tuple[str, str], stamp_ns: int, transform: SE3) -> Iterator[Scan]:
        """Add the next transform that is recorded of a moving link, and yield the scans that no longer wait."""
        self._trajectories[recorded].add(stamp_ns, transform)
        yield from self._released()

    def flush(self) -> Iterator[Scan]:
        """Yield the scans that still wait, and report. Raises ClocksApartError."""
        while self._waiting:
            yield from self._placed(self._waiting.popleft())
        self._check_clocks()
        for (source, frame), trajectory in self._trajectories.items():
            if trajectory.left_out:
                left_out = f"transforms of '{frame}' on {source} whose stamp is far from the others are left out"
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
        """The newest stamp that two scans of a topic have reached, 0 without any."""
        return max(map(min, self._last_two_ns.values()), default=0)

    def _is_due(self, framed: FramedScan) -> bool:
        stamp_ns = framed.scan.stamp_ns
        late = self._newest_ns - stamp_ns > MAX_GAP_NS
        # two scans after it are stamped before it: its stamp is damaged, and its transforms need not come
        damaged = max(self._last_two_ns[framed.topic]) < stamp_ns
        moving = self._chain(framed).moving
        return late or damaged or all(self._trajectories[link.recorded].covers(stamp_ns) for link in moving)

    def _chain(self, framed: FramedScan) -> Chain:
        return self._chains[framed.topic]

    def _placed(self, framed: FramedScan) -> Iterator[Scan]:
        """The scan at its place in the plane; none where it is tilted too much."""
        scan, chain = framed.scan, self._chain(framed)
        placement = self._world_T_sensor(framed, chain).placement()
        if placement.tilt_rad > MAX_TILT_RAD:
            limit = f"{math.degrees(MAX_TILT_RAD):g} deg"
            self._count(
                f"scans of sensor '{scan.sensor}' tilted by more than {limit} are left out (where its transforms"
                " are wrong, --mount gives its place)"
            )
            return
        if placement.mirrored:
            scan = _turned_over(scan)
        yield replace(scan, world_T_sensor=placement.pose)

    def _world_T_sensor(self, framed: FramedScan, chain: Chain) -> SE3:
        world_T_frame = SE3()
        for link in chain.links:
            found = self._trajectories[link.recorded].at(framed.scan.stamp_ns) if link.moves else None
            if link.moves and (found is None or not found.near):
                is_first = found is None or found.is_first
                self._count(
                    f"scans of sensor '{framed.scan.sensor}' without poses on {link.source} ({link.parent} ->"
                    f" {link.child}) within 1 s have the {'first after' if is_first else 'last before'} them"
                )
            world_T_frame = world_T_frame @ link.place(found.transform if found else None)
        return world_T_frame if framed.frame_T_sensor is None else world_T_frame @ framed.frame_T_sensor

    def _count(self, fault: str) -> None:
        self._faults[fault] = self._faults.get(fault, 0) + 1

    def _check_clocks(self) -> None:
        """Raise ClocksApartError where all transforms of a link are stamped long before or after all scans."""
        for (source, _), trajectory in self._trajectories.items():
            if trajectory.first_ns is None or self._between_ns is None:
                continue
            first_ns, last_ns = self._between_ns
            before_ns, after_ns = first_ns - trajectory.last_ns, trajectory.first_ns - last_ns
            if max(before_ns, after_ns) > MAX_GAP_NS:
                apart = f"{before_ns / 1e9:.1f} s before" if before_ns > 0 else f"{after_ns / 1e9:.1f} s after"
                raise ClocksApartError(
                    f"no pose on {source} at the time of a scan: they are stamped {apart} the scans: record poses and"
                    " scans with one clock, or import this recording with --ego-motion kiss-icp, or with --pose-topic"
                    " none where it stands still"
                )


def _turned_over(scan: Scan) -> Scan:
    """The scan of a sensor that is upside down, as seen from above: its angles run clockwise."""
    return replace(scan, angle_min=-scan.angle_min, angle_increment=-scan.angle_increment)

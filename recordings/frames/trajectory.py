"""The transforms of one moving frame by stamp, for a few seconds, interpolated at the stamp of a scan."""

from __future__ import annotations

import bisect
from typing import NamedTuple

from gridtrack.recordings.frames.far_stamps import FarStamps
from gridtrack.recordings.frames.transform import SE3, interpolated

MAX_GAP_NS = 1_000_000_000
MAX_KEPT = 100_000


class Found(NamedTuple):
    """A transform at a stamp; `near`: transforms less than MAX_GAP_NS apart lie around it, or one so near beside it.

    `is_first`: it is the first one, and the stamp is before it.
    """

    transform: SE3
    near: bool
    is_first: bool = False


class Trajectory:
    """Transforms of one frame in the order of their stamps; older ones are dropped."""

    def __init__(self) -> None:
        self._stamps: list[int] = []
        self._transforms: list[SE3] = []
        self._far = FarStamps()
        self._held: tuple[int, SE3] | None = None
        self.first_ns: int | None = None

    @property
    def last_ns(self) -> int:
        """The newest stamp."""
        return self._far.last_ns

    def add(self, stamp_ns: int, transform: SE3) -> bool:
        """Add a transform; False where one was left out because its stamp is far from those before and after it."""
        judgement = self._far.judge(stamp_ns)
        held, self._held = self._held, None
        if judgement == "held":
            self._held = (stamp_ns, transform)
            return held is None
        if judgement == "restarted":
            self._stamps, self._transforms = [], []
        if judgement != "near" and held is not None:
            self._insert(*held)
        self._insert(stamp_ns, transform)
        return judgement == "confirmed" or held is None

    def __len__(self) -> int:
        return len(self._stamps)

    def covers(self, stamp_ns: int) -> bool:
        """Whether there is a transform at or after a stamp. A single one may have a wrong stamp."""
        return len(self) > 1 and self.last_ns >= stamp_ns

    def at(self, stamp_ns: int) -> Found | None:
        """The transform at a stamp, None without any.

        In a gap of more than MAX_GAP_NS it is the last one before; before the first it is the first.
        """
        if not self._stamps:
            return None
        index = bisect.bisect_left(self._stamps, stamp_ns)
        if index == len(self._stamps):
            return Found(self._transforms[-1], stamp_ns - self._stamps[-1] <= MAX_GAP_NS)
        after_ns = self._stamps[index]
        if index == 0 or after_ns == stamp_ns:
            return Found(self._transforms[index], after_ns - stamp_ns <= MAX_GAP_NS, after_ns > stamp_ns)
        before_ns = self._stamps[index - 1]
        if after_ns - before_ns > MAX_GAP_NS:
            return Found(self._transforms[index - 1], False)
        share = (stamp_ns - before_ns) / (after_ns - before_ns)
        return Found(interpolated(self._transforms[index - 1], self._transforms[index], share), True)

    def drop_before(self, stamp_ns: int) -> None:
        """Forget the transforms before a stamp but the last of them, and all but the newest MAX_KEPT."""
        keep_from = max(bisect.bisect_right(self._stamps, stamp_ns) - 1, len(self._stamps) - MAX_KEPT)
        if keep_from > 0:
            del self._stamps[:keep_from], self._transforms[:keep_from]

    def _insert(self, stamp_ns: int, transform: SE3) -> None:
        self.first_ns = stamp_ns if self.first_ns is None else min(self.first_ns, stamp_ns)
        index = bisect.bisect_left(self._stamps, stamp_ns)
        if index < len(self._stamps) and self._stamps[index] == stamp_ns:
            self._transforms[index] = transform
        else:
            self._stamps.insert(index, stamp_ns)
            self._transforms.insert(index, transform)
        if len(self._stamps) > 2 * MAX_KEPT:
            self.drop_before(-1)

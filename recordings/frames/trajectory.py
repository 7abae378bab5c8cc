"""The transforms of one moving frame by stamp, interpolated at the stamp of a scan: of a few seconds, or of a file."""

from __future__ import annotations

import bisect
from abc import ABC, abstractmethod
from array import array
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from gridtrack.recordings.frames.far_stamps import FarStamps
from gridtrack.recordings.frames.transform import SE3, interpolated
from gridtrack.recordings.order import MAX_STAMP_NS

MAX_GAP_NS = 1_000_000_000
MAX_KEPT = 100_000
MAX_WHOLE = 5_000_000
"""Transforms of all moving links of a finished file that are kept, 64 bytes each: 14 hours of one link at 100 Hz."""
MAX_PARTS = 100
"""Times that the clock of one frame may be set back in a finished file."""


class Found(NamedTuple):
    """A transform at a stamp; `near`: transforms less than MAX_GAP_NS apart lie around it, or one so near beside it.

    `is_first`: it is the first one, and the stamp is before it.
    """

    transform: SE3
    near: bool
    is_first: bool = False


class Trajectory(ABC):
    """Transforms of one frame, added in the order of the file; those with a stamp far from the others are left out."""

    def __init__(self) -> None:
        self._far = FarStamps()
        self._held: tuple[int, SE3] | None = None
        self.first_ns: int | None = None
        self.left_out = 0

    @property
    def last_ns(self) -> int:
        """The newest stamp."""
        return self._far.last_ns

    def add(self, stamp_ns: int, transform: SE3) -> None:
        """Add a transform; one whose stamp is far from those before it waits for the next one."""
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
            self._insert(one_ns, one)

    @abstractmethod
    def __len__(self) -> int:
        """The number of transforms."""

    @abstractmethod
    def covers(self, stamp_ns: int) -> bool:
        """Whether a scan at a stamp waits for no more transforms."""

    @abstractmethod
    def at(self, stamp_ns: int) -> Found | None:
        """The transform at a stamp, None without any.

        In a gap of more than MAX_GAP_NS it is the last one before; before the first it is the first.
        """

    @abstractmethod
    def drop_before(self, stamp_ns: int) -> None:
        """Forget the transforms before a stamp that no scan needs, if that saves memory."""

    @abstractmethod
    def _insert(self, stamp_ns: int, transform: SE3) -> None:
        """Put a transform at its stamp, in place of the one there."""

    @abstractmethod
    def _restart(self) -> None:
        """The transforms that come are stamped long before those so far, or the only one so far was wrong."""


class NewestTransforms(Trajectory):
    """Transforms of a few seconds, read along with the scans; older ones are dropped."""

    def __init__(self) -> None:
        super().__init__()
        self._stamps: list[int] = []
        self._transforms: list[SE3] = []

    def __len__(self) -> int:
        return len(self._stamps)

    def covers(self, stamp_ns: int) -> bool:
        """Whether there is a transform at or after a stamp. A single one may have a wrong stamp."""
        return len(self) > 1 and self.last_ns >= stamp_ns

    def at(self, stamp_ns: int) -> Found | None:
        """As of every trajectory."""
        return _found(self._stamps, self._transforms, stamp_ns)

    def drop_before(self, stamp_ns: int) -> None:
        """Forget the transforms before a stamp but the last of them, and all but the newest MAX_KEPT."""
        keep_from = max(bisect.bisect_right(self._stamps, stamp_ns) - 1, len(self._stamps) - MAX_KEPT)
        if keep_from > 0:
            del self._stamps[:keep_from], self._transforms[:keep_from]

    def _insert(self, stamp_ns: int, transform: SE3) -> None:
        index = bisect.bisect_left(self._stamps, stamp_ns)
        if index < len(self._stamps) and self._stamps[index] == stamp_ns:
            self._transforms[index] = transform
        else:
            self._stamps.insert(index, stamp_ns)
            self._transforms.insert(index, transform)
        if len(self._stamps) > 2 * MAX_KEPT:
            self.drop_before(-1)

    def _restart(self) -> None:
        self._stamps, self._transforms = [], []


class AllTransforms(Trajectory):
    """All transforms of a finished file, in 64 bytes each, so that no scan waits for those that come later.

    Where the clock was set back, the transforms of a time are those that came first: so are the scans (StampFilter).
    """

    def __init__(self) -> None:
        super().__init__()
        self._parts = [_Packed()]
        self._sorted = True

    def __len__(self) -> int:
        return len(self._whole().stamps)

    def add(self, stamp_ns: int, transform: SE3) -> None:
        """As of every trajectory; stamps that no scan has are left out."""
        if 0 <= stamp_ns < MAX_STAMP_NS:
            super().add(stamp_ns, transform)
        else:
            self.left_out += 1

    def covers(self, stamp_ns: int) -> bool:
        """Always: no more transforms come."""
        return True

    def at(self, stamp_ns: int) -> Found | None:
        """As of every trajectory."""
        whole = self._whole()
        return _found(whole.stamps, whole, stamp_ns)

    def drop_before(self, stamp_ns: int) -> None:
        """Forget nothing: the scans may be read again."""

    def _insert(self, stamp_ns: int, transform: SE3) -> None:
        self._parts[-1].append(stamp_ns, transform)
        self._sorted = False

    def _restart(self) -> None:
        if len(self._parts[-1].stamps) == 1:
            self._parts[-1] = _Packed()
        elif len(self._parts) < MAX_PARTS:
            self._parts.append(_Packed())

    def _whole(self) -> _Packed:
        """All transforms in the order of their stamps."""
        if not self._sorted:
            self._parts, self._sorted = [_merged(self._parts)], True
        return self._parts[0]


class _Transforms(Protocol):
    def __getitem__(self, index: int, /) -> SE3: ...


class _Packed:
    """Stamps and transforms as numbers."""

    def __init__(self, stamps: bytes = b"", numbers: bytes = b"") -> None:
        """`stamps`: n int64, nanoseconds; `numbers`: n x 7 float64, the translations and the quaternions."""
        self.stamps, self._numbers = array("q", stamps), array("d", numbers)

    def __getitem__(self, index: int, /) -> SE3:
        start = 7 * (index % len(self.stamps))
        x, y, z, qx, qy, qz, qw = self._numbers[start : start + 7]
        return SE3((x, y, z), (qx, qy, qz, qw))

    @property
    def numbers(self) -> NDArray[np.float64]:
        """(n, 7)."""
        return np.frombuffer(self._numbers, np.float64).reshape(-1, 7)

    def append(self, stamp_ns: int, transform: SE3) -> None:
        self.stamps.append(stamp_ns)
        self._numbers.extend((*transform.translation, *transform.rotation))


def _merged(parts: Sequence[_Packed]) -> _Packed:
    """All transforms in the order of their stamps, without those of a part at times that the parts before it have."""
    stamps, numbers = np.empty(0, np.int64), np.empty((0, 7))
    for part in parts:
        own = np.frombuffer(part.stamps, np.int64)
        order = np.argsort(own, kind="stable")
        is_last = np.append(own[order][1:] != own[order][:-1], True)[: len(own)]  # of those with one stamp
        rows = order[is_last]
        rows = rows[~_within(stamps, own[rows])]
        stamps, numbers = np.concatenate([stamps, own[rows]]), np.concatenate([numbers, part.numbers[rows]])
        order = np.argsort(stamps, kind="stable")
        stamps, numbers = stamps[order], numbers[order]
    return _Packed(stamps.tobytes(), numbers.tobytes())


def _within(stamps: NDArray[np.int64], others: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which of `others` (m,) are one of `stamps` (n,), in order, or between two of them without a gap."""
    after = np.searchsorted(stamps, others)
    inside = (after > 0) & (after < len(stamps))
    inside[inside] = np.diff(stamps)[after[inside] - 1] <= MAX_GAP_NS
    within: NDArray[np.bool_] = inside | np.isin(others, stamps)
    return within


def _found(stamps: Sequence[int], transforms: _Transforms, stamp_ns: int) -> Found | None:
    """The transform at a stamp, as `Trajectory.at` says; `stamps` are in order."""
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

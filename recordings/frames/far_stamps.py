"""Stamps of transforms that are far from those before and after them: damaged, and not used."""

from __future__ import annotations

from typing import Literal

FAR_JUMP_NS = 10_000_000_000
USUAL_GAPS = 2
"""Stamps that come seldom may be so many times as far apart as those before them."""

Judgement = Literal["near", "held", "confirmed", "restarted"]
"""`held`: far from the newest stamp. `confirmed`: near the one held before, or as far after it as that is after those
before, so that both are correct; `restarted`: they are, and those before them are not, because they are later, or only
one.
"""


class FarStamps:
    """Judges the stamps of one topic or frame in the order of the file."""

    def __init__(self) -> None:
        self.last_ns = 0
        """The newest stamp that is near others, or the only one."""
        self._judged = 0
        self._held_ns: int | None = None
        self._near_ns = FAR_JUMP_NS
        """A stamp that is later by no more is near: longer where all come seldom."""

    def judge(self, stamp_ns: int) -> Judgement:
        """Whether a stamp is near those before it."""
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

"""Stamps of transforms that are far from those before and after them: damaged, and not used."""

from __future__ import annotations

from typing import Literal

FAR_JUMP_NS = 10_000_000_000


Judgement = Literal["near", "held", "confirmed", "restarted"]
"""`held`: far from the newest stamp. `confirmed`: near the one held before, so that both are correct; `restarted`: they
are, and those before them are not, because they are later, or only one.
"""


class FarStamps:
    """Judges the stamps of one topic or frame in the order of the file."""

    def __init__(self) -> None:
        self.last_ns = 0
        """The newest stamp that is near others, or the only one."""
        self._judged = 0
        self._held_ns: int | None = None

    def judge(self, stamp_ns: int) -> Judgement:
        """Whether a stamp is near those before it."""
        held_ns, self._held_ns = self._held_ns, None
        if self._judged == 0 or abs(stamp_ns - self.last_ns) <= FAR_JUMP_NS:
            self.last_ns = max(self.last_ns, stamp_ns) if self._judged else stamp_ns
            self._judged += 1
            return "near"
        if held_ns is None or abs(stamp_ns - held_ns) > FAR_JUMP_NS:
            self._held_ns = stamp_ns
            return "held"
        restarts = held_ns < self.last_ns or self._judged == 1
        self.last_ns, self._judged = max(held_ns, stamp_ns), self._judged + 2
        return "restarted" if restarts else "confirmed"

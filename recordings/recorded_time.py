"""The time that a recording covers: the same under every name, cut and format of its file."""

from __future__ import annotations

from dataclasses import dataclass, replace

WALL_CLOCK_FROM_NS = 946_684_800 * 1_000_000_000
"""The year 2000: later stamps are times of the day; a simulation, or a clock that starts with its sensor, is before."""


@dataclass(frozen=True, slots=True)
class RecordedTime:
    """Time at one `site`: stamps from `start_ns` on, `end_ns` excluded, first recorded in the file `source_sha256`."""

    source_sha256: str
    site: str
    start_ns: int
    end_ns: int

    def overlaps(self, other: RecordedTime) -> bool:
        """Whether both hold a moment in common."""
        return self.common(other) is not None

    def common(self, other: RecordedTime) -> RecordedTime | None:
        """The part of this time that `other` holds too, or None.

        Stamps are compared where both come from one source, and at one site where they are times of the day: a file
        that another program cut has another hash, and two lasers of one site see the same traffic.
        """
        on_wall_clock = min(self.start_ns, other.start_ns) >= WALL_CLOCK_FROM_NS
        comparable = self.source_sha256 == other.source_sha256 or (self.site == other.site and on_wall_clock)
        start_ns, end_ns = max(self.start_ns, other.start_ns), min(self.end_ns, other.end_ns)
        return replace(self, start_ns=start_ns, end_ns=end_ns) if comparable and start_ns < end_ns else None

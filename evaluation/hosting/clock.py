"""Whose clock counts: a tracker reports the time of its calls, and the round trip of each call bounds it."""

from __future__ import annotations

from typing import Literal

Clock = Literal["tracker", "host"]
"""`tracker`: the time that it reports, without the transport of messages; `host`: the round trip of each call."""

CLOCK_FACTOR, TRANSPORT_MS = 2.0, 5.0
"""A round trip takes at most CLOCK_FACTOR times the reported time and TRANSPORT_MS; else the report is not believed."""


def clock_that_counts(own_ms: float, round_trip_ms: float) -> Clock:
    """The clock that counts for calls of these typical durations."""
    return "tracker" if round_trip_ms <= CLOCK_FACTOR * own_ms + TRANSPORT_MS else "host"

"""The durations of a tracker's calls: by its own clock, and as round trips."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.referee.deadline import Clock

CLOCK_FACTOR, TRANSPORT_MS = 2.0, 5.0
"""A reported time counts if the round trip takes at most CLOCK_FACTOR times as long, and TRANSPORT_MS more."""


def clock_that_counts(own_ms: float, round_trip_ms: float) -> Clock:
    """The clock that counts for calls of these typical durations."""
    return "tracker" if round_trip_ms <= CLOCK_FACTOR * own_ms + TRANSPORT_MS else "host"


class Call(NamedTuple):
    """Durations of one call, ms: by the tracker's own clock, at most the round trip; and the round trip."""

    own_ms: float
    round_trip_ms: float


@dataclass(slots=True)
class Timings:
    """The calls so far, in their order."""

    updates: list[Call] = field(default_factory=list)
    forecasts: list[Call] = field(default_factory=list)

    @property
    def clock(self) -> Clock:
        """The clock that counts, by the medians of updates and of forecasts."""
        clocks = {clock_that_counts(*np.median(calls, axis=0)) for calls in (self.updates, self.forecasts) if calls}
        return "host" if "host" in clocks else "tracker"

    def counted_ms(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Durations (n,) of updates and of forecasts by the clock that counts, ms."""
        column = ("tracker", "host").index(self.clock)
        updates, forecasts = (np.reshape(calls, (-1, 2))[:, column] for calls in (self.updates, self.forecasts))
        return updates, forecasts

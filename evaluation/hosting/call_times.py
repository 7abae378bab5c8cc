"""Durations of the calls of a tracker, by its own clock and as round trips."""

from __future__ import annotations

from dataclasses import dataclass, field

from gridtrack.evaluation.hosting.clock import Clock, clock_that_counts
from gridtrack.evaluation.hosting.latency import Latencies


@dataclass(frozen=True, slots=True)
class Call:
    """Durations of one call, ms: by the tracker's own clock, at most the round trip; processor time; round trip."""

    own_ms: float
    cpu_ms: float
    round_trip_ms: float


@dataclass(slots=True)
class Timings:
    """Durations of the calls so far, in bounded memory."""

    update: Latencies = field(default_factory=Latencies)
    predict: Latencies = field(default_factory=Latencies)
    update_round_trip: Latencies = field(default_factory=Latencies)
    predict_round_trip: Latencies = field(default_factory=Latencies)

    def add_update(self, call: Call) -> None:
        """Count an update."""
        self.update.add(call.own_ms)
        self.update_round_trip.add(call.round_trip_ms)

    def add_predict(self, call: Call) -> None:
        """Count a forecast."""
        self.predict.add(call.own_ms)
        self.predict_round_trip.add(call.round_trip_ms)

    @property
    def clock(self) -> Clock:
        """The clock that counts, by the medians of updates and of forecasts."""
        pairs = ((self.update, self.update_round_trip), (self.predict, self.predict_round_trip))
        clocks = {
            clock_that_counts(own.percentile(50), round_trip.percentile(50)) for own, round_trip in pairs if len(own)
        }
        return "host" if "host" in clocks else "tracker"

    def counted(self) -> tuple[Latencies, Latencies]:
        """Updates and forecasts by the clock that counts."""
        if self.clock == "tracker":
            return self.update, self.predict
        return self.update_round_trip, self.predict_round_trip

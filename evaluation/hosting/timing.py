"""The duration of a tracker's calls: by its own clock and as round trips, as percentiles in bounded memory."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.referee.deadline import Clock

CLOCK_FACTOR, TRANSPORT_MS = 2.0, 5.0
"""A reported time counts if the round trip takes at most CLOCK_FACTOR times as long, and TRANSPORT_MS more."""

LOWEST_MS, HIGHEST_MS, GROWTH = 1e-3, 1e6, 1.02
LATENCY_BINS = math.ceil(math.log(HIGHEST_MS / LOWEST_MS) / math.log(GROWTH)) + 1
TWENTIETHS = range(0, 101, 5)
"""Percentiles in steps of a twentieth of the calls."""


def clock_that_counts(own_ms: float, round_trip_ms: float) -> Clock:
    """The clock that counts for calls of these typical durations."""
    return "tracker" if round_trip_ms <= CLOCK_FACTOR * own_ms + TRANSPORT_MS else "host"


@dataclass(slots=True)
class Latencies:
    """Histogram of call durations: geometric bins, each 2 % wider than the last, from LOWEST_MS to HIGHEST_MS."""

    counts: NDArray[np.int64] = field(default_factory=lambda: np.zeros(LATENCY_BINS, np.int64))
    total_ms: float = 0.0
    max_ms: float = 0.0

    def add(self, ms: float) -> None:
        """Count one call."""
        position = math.log(max(ms, LOWEST_MS) / LOWEST_MS) / math.log(GROWTH)
        self.counts[min(int(position), LATENCY_BINS - 1)] += 1
        self.total_ms += ms
        self.max_ms = max(self.max_ms, ms)

    def __len__(self) -> int:
        return int(self.counts.sum())

    def percentile(self, percent: float) -> float:
        """Percentile of the call durations, ms; NaN if there was no call."""
        if not len(self):
            return math.nan
        rank = max(1, math.ceil(percent / 100.0 * len(self)))
        bin_ = int(np.searchsorted(np.cumsum(self.counts), rank))
        return float(min(LOWEST_MS * GROWTH ** (bin_ + 0.5), self.max_ms))


@dataclass(frozen=True, slots=True)
class Call:
    """Durations of one call, ms: by the tracker's own clock, at most the round trip; and the round trip."""

    own_ms: float
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

"""Latencies in bounded memory: a histogram whose percentiles are right to one per cent, for streams of any length."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

LOWEST_MS, HIGHEST_MS, GROWTH = 1e-3, 1e6, 1.02
LATENCY_BINS = math.ceil(math.log(HIGHEST_MS / LOWEST_MS) / math.log(GROWTH)) + 1


@dataclass(slots=True)
class Latencies:
    """How long calls took: counts in bins of milliseconds, each 2 % wider than the last, from 1 microsecond up."""

    counts: NDArray[np.int64] = field(default_factory=lambda: np.zeros(LATENCY_BINS, np.int64))
    total_ms: float = 0.0
    max_ms: float = 0.0

    def add(self, ms: float) -> None:
        """Count one call."""
        place = math.log(max(ms, LOWEST_MS) / LOWEST_MS) / math.log(GROWTH)
        self.counts[min(int(place), LATENCY_BINS - 1)] += 1
        self.total_ms += ms
        self.max_ms = max(self.max_ms, ms)

    def __len__(self) -> int:
        return int(self.counts.sum())

    def percentile(self, percent: float) -> float:
        """The smallest time, in ms, that `percent` of the calls did not exceed; NaN where there was no call."""
        if not len(self):
            return math.nan
        rank = max(1, math.ceil(percent / 100.0 * len(self)))
        place = int(np.searchsorted(np.cumsum(self.counts), rank))
        return float(min(LOWEST_MS * GROWTH ** (place + 0.5), self.max_ms))

    def summary(self) -> dict[str, float]:
        """p50, p95 and p99 in ms."""
        return {f"p{percent}": self.percentile(percent) for percent in (50, 95, 99)}

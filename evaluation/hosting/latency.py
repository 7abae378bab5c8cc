"""Latencies in bounded memory: a histogram with percentiles accurate to 1 %, for streams of any length."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

LOWEST_MS, HIGHEST_MS, GROWTH = 1e-3, 1e6, 1.02
TWENTIETHS = range(0, 101, 5)
"""Percentiles of which each two neighbours have a twentieth of the calls between them."""
LATENCY_BINS = math.ceil(math.log(HIGHEST_MS / LOWEST_MS) / math.log(GROWTH)) + 1


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
        """Percentile of the call durations, ms; NaN where there was no call."""
        if not len(self):
            return math.nan
        rank = max(1, math.ceil(percent / 100.0 * len(self)))
        bin_ = int(np.searchsorted(np.cumsum(self.counts), rank))
        return float(min(LOWEST_MS * GROWTH ** (bin_ + 0.5), self.max_ms))

    def summary(self) -> dict[str, float]:
        """p50, p95 and p99 in ms."""
        return {f"p{percent}": self.percentile(percent) for percent in (50, 95, 99)}

    def twentieths(self) -> tuple[float, ...]:
        """The percentiles TWENTIETHS in ms, to four digits."""
        return tuple(float(f"{self.percentile(percent):.4g}") for percent in TWENTIETHS)

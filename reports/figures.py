"""Geometry of the report's figures: positions of scores and times, in SVG user units, for the templates."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from gridtrack.evaluation.results.passes import Quantiles

SHORTEST_MS = 0.01


@dataclass(frozen=True)
class Series:
    """One tracker in a figure: its label, its name, and its style (CSS classes), the same on the whole page."""

    label: str
    name: str
    style: str


@dataclass(frozen=True)
class Axis:
    """A linear or logarithmic map from values [low, high] to positions [start, end]."""

    low: float
    high: float
    start: float
    end: float
    logarithmic: bool = False

    def __call__(self, value: float) -> float:
        """Position of `value`, clamped to the axis, rounded to a tenth of a unit."""
        low, high, value = (math.log(v) if self.logarithmic else v for v in (self.low, self.high, max(value, self.low)))
        share = (value - low) / (high - low)
        return round(self.start + min(max(share, 0.0), 1.0) * (self.end - self.start), 1)


@dataclass(frozen=True)
class Span:
    """A time from its median to its 99th percentile."""

    p50: float
    p95: float
    p99: float


@dataclass(frozen=True)
class TimeScale:
    """A logarithmic axis of milliseconds, shared by the rows of a table; `period`: position of the stream's period."""

    axis: Axis
    ticks: tuple[tuple[float, str], ...]
    period: float

    def span(self, times: Quantiles) -> Span:
        """Positions of the three quantiles."""
        return Span(self.axis(times.p50), self.axis(times.p95), self.axis(times.p99))


def time_scale(times_ms: Sequence[float], period_ms: float, width: float) -> TimeScale:
    """Whole decades that contain `times_ms` and the period; times below SHORTEST_MS are drawn at the edge."""
    known = [period_ms, *(max(t, SHORTEST_MS) for t in times_ms)]
    low = math.floor(math.log10(min(known)))
    high = max(math.ceil(math.log10(max(known))), low + 1)
    axis = Axis(10.0**low, 10.0**high, 6.0, width - 6.0, logarithmic=True)
    ticks = tuple((axis(10.0**k), f"{10.0**k:g}" if (high - k) % 2 == 0 else "") for k in range(low, high + 1))
    return TimeScale(axis, ticks, axis(period_ms))

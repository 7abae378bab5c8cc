"""Geometry of the report's figures: positions of scores and times, in SVG user units, for the templates."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby

from gridtrack.evaluation.results.passes import Quantiles
from gridtrack.evaluation.results.values import Curve
from gridtrack.reports.run import UNDEFINED

ROW_HEIGHT = 17.0
"""Height of one line of text in a figure."""
SHORTEST_MS = 0.01

Band = tuple[Curve, Curve]
"""The confidence interval of a curve at each step: low and high."""


@dataclass(frozen=True)
class Series:
    """One tracker in a figure: its name, and its style (CSS classes), the same on the whole page."""

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
class Line:
    """One curve. Step 0 is the input frame and not ranked: a dashed piece leads to it."""

    series: Series
    pieces: tuple[str, ...]
    to_zero: str
    at_zero: tuple[float, float] | None
    bands: tuple[str, ...]
    """The outlines of its confidence band."""
    label_at: tuple[float, float, float] | None
    """Position of the label beside the curve's end: x, y, and the y of the end itself."""


@dataclass(frozen=True)
class Reading:
    """The values of every curve at one step, the highest first: shown while the pointer is at that step."""

    x: float
    left: float
    width: float
    heading: str
    box: tuple[float, float, float, float]
    rows: tuple[tuple[Series, str, float, float], ...]
    """Series, value as text, the y of the line of text, and the y of the point."""


@dataclass(frozen=True)
class CurvePanel:
    """F1 over the horizon in one stratum, one line per tracker: the values and their geometry."""

    title: str
    horizons_s: tuple[float, ...]
    curves: tuple[tuple[Series, Curve], ...]
    width: int
    height: int
    x: Axis
    y: Axis
    x_ticks: tuple[float, ...]
    y_ticks: tuple[float, ...]
    lines: tuple[Line, ...]
    readings: tuple[Reading, ...]

    @property
    def words(self) -> str:
        """The panel in words: the last value of each curve."""
        ends = [
            f"{series.name} {UNDEFINED if (v := curve[-1]) is None else f'{v:.3f}'}" for series, curve in self.curves
        ]
        return f"F1 of {self.title} cells over the horizon; at {self.horizons_s[-1]:g} s: {', '.join(ends)}"


def curve_panel(
    title: str,
    horizons_s: Sequence[float],
    curves: Sequence[tuple[Series, Curve]],
    size: tuple[int, int],
    label_width: float = 0.0,
    bands: Sequence[Band | None] = (),
) -> CurvePanel:
    """Lay out F1 curves over `horizons_s` in a panel of `size`; with `label_width` each curve has a label at its end.

    `bands`: the confidence bands of the curves, in the same order; empty for none.
    """
    width, height = size
    x = Axis(0.0, max(horizons_s[-1], 1e-9), 34.0, width - max(label_width, 12.0))
    y = Axis(0.0, 1.0, height - 28.0, 12.0)
    labels = _label_heights([(y(v) if (v := _last(curve)) is not None else None) for _, curve in curves], 10.0, y.start)
    lines = tuple(
        _line(series, curve, band, horizons_s, x, y, (x.end + 14.0, at) if label_width and at is not None else None)
        for (series, curve), band, at in zip(curves, bands or [None] * len(curves), labels, strict=True)
    )
    readings = tuple(_reading(step, horizons_s, curves, x, y) for step in range(len(horizons_s)))
    x_ticks = tuple(0.5 * i for i in range(int(horizons_s[-1] / 0.5 + 1e-6) + 1))
    return CurvePanel(
        title,
        tuple(horizons_s),
        tuple(curves),
        width,
        height,
        x,
        y,
        x_ticks,
        (0.0, 0.2, 0.4, 0.6, 0.8, 1.0),
        lines,
        readings,
    )


def _last(curve: Curve) -> float | None:
    return curve[-1] if curve else None


def _line(
    series: Series,
    curve: Curve,
    band: Band | None,
    horizons_s: Sequence[float],
    x: Axis,
    y: Axis,
    label: tuple[float, float] | None,
) -> Line:
    at = [None if value is None else (x(h), y(value)) for h, value in zip(horizons_s, curve, strict=True)]
    pieces = tuple(_path(piece) for piece in _unbroken(at[1:]))
    to_zero = _path([p for p in at[:2] if p is not None]) if len(at) > 1 and at[0] and at[1] else ""
    end = at[-1]
    outlines = tuple(_outlines(band, horizons_s, x, y)) if band else ()
    return Line(series, pieces, to_zero, at[0], outlines, (*label, end[1]) if label and end else None)


def _outlines(band: Band, horizons_s: Sequence[float], x: Axis, y: Axis) -> Iterator[str]:
    """The band from step 1 on: one closed outline for each range of steps in which it is defined."""
    steps = list(zip(horizons_s, *band, strict=True))[1:]
    for defined, run in groupby(steps, key=lambda step: step[1] is not None and step[2] is not None):
        if defined:
            corners = [(x(h), y(low or 0.0), y(high or 0.0)) for h, low, high in run]
            yield _path([(at, top) for at, _, top in corners] + [(at, bottom) for at, bottom, _ in reversed(corners)])


def _unbroken(points: Sequence[tuple[float, float] | None]) -> Iterator[list[tuple[float, float]]]:
    """The pieces of a curve between its undefined points."""
    for defined, run in groupby(points, key=lambda point: point is not None):
        if defined:
            yield [point for point in run if point is not None]


def _path(points: Sequence[tuple[float, float]]) -> str:
    return " ".join(f"{x:g},{y:g}" for x, y in points)


def _label_heights(ends: Sequence[float | None], top: float, bottom: float) -> list[float | None]:
    """Heights near `ends` at which labels do not overlap: in the same order, at least one line of text apart."""
    order = sorted((end, i) for i, end in enumerate(ends) if end is not None)
    heights = [min(end, bottom) for end, _ in order]
    for k in range(1, len(heights)):
        heights[k] = max(heights[k], heights[k - 1] + ROW_HEIGHT)
    limit = max(bottom, top + ROW_HEIGHT * (len(heights) - 1))
    for k in reversed(range(len(heights))):
        heights[k] = min(heights[k], limit - ROW_HEIGHT * (len(heights) - 1 - k))
    placed: list[float | None] = [None] * len(ends)
    for (_, i), height in zip(order, heights, strict=True):
        placed[i] = round(height, 1)
    return placed


def _reading(
    step: int, horizons_s: Sequence[float], curves: Sequence[tuple[Series, Curve]], x: Axis, y: Axis
) -> Reading:
    at = x(horizons_s[step])
    pitch = (x.end - x.start) / max(len(horizons_s) - 1, 1)
    values = sorted(
        ((value, series) for series, curve in reversed(curves) if (value := curve[step]) is not None),
        key=lambda pair: -pair[0],
    )
    width, height = 168.0, ROW_HEIGHT * (len(values) + 1) + 12.0
    left = at + 12.0 if at + 12.0 + width < x.end else at - 12.0 - width
    top = y.end + 2.0
    rows = tuple(
        (series, f"{value:.3f}", round(top + ROW_HEIGHT * (i + 2), 1), y(value))
        for i, (value, series) in enumerate(values)
    )
    heading = f"{horizons_s[step]:.3g} s, step {step}" + (": input frame, not ranked" if step == 0 else "")
    return Reading(at, round(at - pitch / 2, 2), round(pitch, 2), heading, (round(left, 1), top, width, height), rows)


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

"""Small figures of a score at each value of something other than the horizon: a rate, a degradation, a scale."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from gridtrack.reports.figures import Axis, Series

SWEEP_SIZE = (270, 180)
"""Width and height of a panel, in SVG user units."""
Values = Sequence[float | None]


@dataclass(frozen=True)
class SweepLine:
    """One tracker in a panel: its SVG path, its points, and the outline of its confidence band, empty without one."""

    series: Series
    path: str
    points: tuple[tuple[float, float], ...]
    band: str


@dataclass(frozen=True)
class SweepPanel:
    """A score of every tracker at each value of a condition."""

    score: str
    title: str
    series: tuple[tuple[Series, tuple[float | None, ...]], ...]
    ticks: tuple[tuple[float, str], ...]
    y_ticks: tuple[tuple[float, str], ...]
    lines: tuple[SweepLine, ...]
    x: Axis
    width: int = SWEEP_SIZE[0]
    height: int = SWEEP_SIZE[1]

    @property
    def words(self) -> str:
        """The panel in words: the first and the last value of each line."""
        ends = [f"{s.name} from {_score_text(values[0])} to {_score_text(values[-1])}" for s, values in self.series]
        return f"{self.score}, {self.title}: {', '.join(ends)}"


def sweep_panel(
    score: str,
    title: str,
    ticks: Sequence[tuple[float, str]],
    series: Sequence[tuple[Series, Values]],
    bands: Sequence[tuple[Values, Values] | None] = (),
    top: float | None = None,
) -> SweepPanel:
    """Lay out one line for each tracker over the values of `ticks`; the axis of the score ends at `top`, None: at the
    highest value of all.

    `bands`: low and high ends of the confidence bands of the lines, in the same order; empty for none.
    """
    width, height = SWEEP_SIZE
    highest = max((value for _, values in series for value in values if value is not None), default=0.0)
    top = top or max(math.ceil(highest * 10) / 10, 0.1)
    x = Axis(ticks[0][0], ticks[-1][0], 34.0, width - 22.0)
    y = Axis(0.0, top, height - 26.0, 10.0)
    at = [x(value) for value, _ in ticks]
    bands = bands or [None] * len(series)
    lines = tuple(_line(one, at, values, band, y) for (one, values), band in zip(series, bands, strict=True))
    return SweepPanel(
        score,
        title,
        tuple((one, tuple(values)) for one, values in series),
        tuple((x(value), words) for value, words in ticks),
        tuple((y(top * share), f"{top * share:.2g}") for share in (0.0, 0.5, 1.0)),
        lines,
        x,
    )


def _line(
    series: Series, at: Sequence[float], values: Values, band: tuple[Values, Values] | None, y: Axis
) -> SweepLine:
    points = tuple(_placed(at, values, y))
    outline = [*_placed(at, band[0], y), *reversed(list(_placed(at, band[1], y)))] if band else []
    return SweepLine(series, _path(points), points, _path(outline))


def _placed(at: Sequence[float], values: Values, y: Axis) -> Iterable[tuple[float, float]]:
    return [(x, y(value)) for x, value in zip(at, values, strict=True) if value is not None]


def _path(points: Iterable[tuple[float, float]]) -> str:
    return " ".join(f"{x:g},{y:g}" for x, y in points)


def series_of(panels: Sequence[SweepPanel]) -> tuple[Series, ...]:
    """Every tracker that a panel shows, once."""
    return tuple(dict.fromkeys(series for panel in panels for series, _ in panel.series))


def _score_text(value: float | None) -> str:
    return "undefined" if value is None else f"{value:.3f}"

"""The drawing of the history of a regression check: scores and times over commits, as an SVG file."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from itertools import count
from typing import TYPE_CHECKING

from gridtrack.common.errors import printable
from gridtrack.evaluation.regression.history import HistoryEntry
from gridtrack.evaluation.regression.speed import CALLS
from gridtrack.reports.print_figures import figure_style, file_of
from gridtrack.reports.styles import FLOOR_GREYS, TRACKER_COLOURS, look_of
from gridtrack.reports.verdict_text import band_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.legend import Legend

HISTORY_PANEL_INCHES, LEAST_INCHES, ENTRY_INCHES = 1.7, 6.0, 0.3
"""Height of a panel, width of the smallest figure, and the width of an entry."""
DRAWN_STRATA = ("dynamic", "in-motion", "visible", "occluded")
"""Strata with a panel of F1 in the middle step band; any other score has one once it was worse."""
MAX_LABELS = 24
SHORT_COMMIT = 7
SOFT = "#5f646b"


@dataclass(frozen=True, slots=True)
class Point:
    """A value of one entry with its standing; `low` and `high` are the ends of its interval, or the value."""

    value: float
    standing: str
    low: float
    high: float
    title: str


Panel = tuple[str, Mapping[str, Mapping[int, Point]]]
"""A title, and the line of each tracker: its points by the number of the entry."""


def history_svg(entries: Sequence[HistoryEntry]) -> str:
    """A panel for each F1 of the middle step band, for each other score that was worse in an entry, and for the time of
    each call. `entries`: the oldest first. Raises ConfigurationError if matplotlib is not installed."""
    panels = [panel for panel in (*_score_panels(entries), *_time_panels(entries)) if panel[1]]
    floors = {printable(label) for entry in entries for label in entry.floors}
    colours = _colours(dict.fromkeys(name for _, lines in panels for name in lines), floors)
    titles = _Titles()
    width = max(LEAST_INCHES, ENTRY_INCHES * len(entries))
    with figure_style("a drawing") as new_figure:
        figure = new_figure((width, HISTORY_PANEL_INCHES * len(panels) + 1.0), layout="constrained")
        axes = figure.subplots(max(len(panels), 1), sharex=True, squeeze=False)[:, 0]
        for axis, (title, lines) in zip(axes, panels, strict=False):
            axis.set_title(title, fontsize=8, fontweight="bold", loc="left", parse_math=False)
            _draw_verdicts(axis, entries, titles)
            for name, line in lines.items():
                _draw_line(axis, line, name, colours[name], entries, titles)
        _name_commits(axes[-1], entries)
        drawn = file_of(figure, "svg", _legend(figure, colours))
    return titles.added_to(drawn.decode())


class _Titles:
    """Titles of drawn elements, which a browser shows at the pointer. matplotlib writes only ids."""

    def __init__(self) -> None:
        self._titles: list[str] = []

    def id_of(self, title: str) -> str:
        """The id of an element with this title."""
        self._titles.append(title)
        return f"title-{len(self._titles) - 1}"

    def added_to(self, svg: str) -> str:
        """The drawing with its titles."""
        return re.sub(
            r'<g id="title-(\d+)">',
            lambda one: f"{one[0]}<title>{escape(printable(self._titles[int(one[1])]))}</title>",
            svg,
        )


def _score_panels(entries: Sequence[HistoryEntry]) -> Iterator[Panel]:
    drawn: dict[tuple[str, str, str], dict[str, dict[int, Point]]] = {
        ("F1", stratum, "middle"): {} for stratum in DRAWN_STRATA
    }
    scores = [(at, row) for at, entry in enumerate(entries) for row in entry.scores]
    for _, row in scores:
        if row.standing == "worse":
            drawn.setdefault((row.score, row.stratum, row.band), {})
    for at, row in scores:
        lines = drawn.get((row.score, row.stratum, row.band))
        if lines is not None and row.value is not None:
            point = Point(row.value, row.standing, row.value, row.value, f"{row.label} {row.value:.4f}")
            lines.setdefault(printable(row.label), {})[at] = point
    for (score, stratum, band), lines in drawn.items():
        lower = any(row.score == score and row.lower_is_better for _, row in scores)
        yield f"{_score_name(score, stratum, band)}{' (lower is better)' if lower else ''}", lines


def _score_name(score: str, stratum: str, band: str) -> str:
    return printable(f"{score}, {stratum}, {band_text(band)}")


def _time_panels(entries: Sequence[HistoryEntry]) -> Iterator[Panel]:
    for call in CALLS:
        times: dict[str, dict[int, Point]] = {}
        for at, entry in enumerate(entries):
            for time in (one for one in entry.speed if one.call == call):
                title = f"{time.label} takes {time.ratio:.3f} times as long as {time.against}"
                low, high = (time.ratio if end is None else end for end in (time.low, time.high))
                times.setdefault(printable(time.label), {})[at] = Point(time.ratio, time.standing, low, high, title)
        yield f"time of {call}, as a multiple of the time of the base or the reference", times


def _draw_verdicts(axis: Axes, entries: Sequence[HistoryEntry], titles: _Titles) -> None:
    """A vertical line in every panel for each run that was worse; dashed if nothing was measured."""
    for at, entry in enumerate(entries):
        if entry.verdict != "no worse":
            measured = entry.verdict == "worse"
            text = _worse_text(entry) if measured else "; ".join(entry.reasons)
            line = axis.axvline(at, color=SOFT, linewidth=0.8, linestyle="solid" if measured else "dashed")
            line.set_gid(titles.id_of(f"{_name(entry)}: {entry.verdict}: {text}"))


def _worse_text(entry: HistoryEntry) -> str:
    """The worse scores and times, by tracker. An entry has no scores of single recordings and no recoveries."""
    found: dict[str, list[str]] = {}
    for row in (one for one in entry.scores if one.standing == "worse"):
        found.setdefault(row.label, []).append(_score_name(row.score, row.stratum, row.band))
    for time in (one for one in entry.speed if one.standing == "worse"):
        found.setdefault(time.label, []).append(f"time of {time.call}")
    worse = [f"{label} in {' and '.join(names)}" for label, names in found.items()]
    return "; ".join(worse) or "a tracker on one recording, or its recoveries"


def _draw_line(
    axis: Axes, line: Mapping[int, Point], name: str, colour: str, entries: Sequence[HistoryEntry], titles: _Titles
) -> None:
    """One line, its intervals, and a mark for each entry: a disc, and a cross if the run was worse there."""
    axis.plot(list(line), [point.value for point in line.values()], color=colour, linewidth=1.2)
    for at, point in line.items():
        if point.low < point.high:
            axis.vlines(at, point.low, point.high, color=colour, alpha=0.5, linewidth=1.0)
        marker = "x" if point.standing == "worse" else "o"
        (mark,) = axis.plot(at, point.value, marker, color=colour, markersize=7 if marker == "x" else 4, mew=1.8)
        mark.set_gid(titles.id_of(f"{_name(entries[at])}: {point.title}, {point.standing}"))
    axis.grid(axis="y", linewidth=0.4, alpha=0.5)


def _name_commits(axis: Axes, entries: Sequence[HistoryEntry]) -> None:
    """The commit below each entry; in a long history only below every few entries."""
    shown = range(0, len(entries), -(-len(entries) // MAX_LABELS) or 1)
    axis.set_xticks(list(shown), [_name(entries[at]) for at in shown], rotation=40, ha="right", color=SOFT)
    axis.set_xlim(-0.5, max(len(entries), 1) - 0.5)


def _name(entry: HistoryEntry) -> str:
    """The commit in short, with a mark if tracked files differed from it; the day without a commit."""
    return f"{entry.commit[:SHORT_COMMIT]}{'+' if entry.changed else ''}" if entry.commit else entry.recorded[:8]


def _legend(figure: Figure, colours: Mapping[str, str]) -> Legend:
    """The names in their colours, and the signs."""
    from matplotlib.lines import Line2D

    lines = [Line2D([], [], color=colour, marker="o", markersize=4) for colour in colours.values()]
    signs = [
        Line2D([], [], color=SOFT, marker="x", linestyle=""),
        Line2D([], [], color=SOFT),
        Line2D([], [], color=SOFT, linestyle="dashed"),
    ]
    names = [*colours, "worse", "worse in any score", "not measured"]
    return figure.legend([*lines, *signs], names, loc="outside upper left", ncols=4, frameon=False)


def _colours(names: Iterable[str], floors: Collection[str]) -> dict[str, str]:
    """The colours of the lines, as in the report: greys for the `floors`; after the last colour the first again."""
    found: dict[str, str] = {}
    greys, colours = count(), count()
    for name in names:
        grey = name in floors
        style = f"f{next(greys) % FLOOR_GREYS}" if grey else f"t{next(colours) % TRACKER_COLOURS}"
        found[name] = look_of(style)[0]
    return found

"""The history of a regression check as a drawing: scores and times over commits, an SVG file that opens by itself."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape

from gridtrack.common.errors import printable
from gridtrack.evaluation.regression.history import HistoryEntry
from gridtrack.evaluation.regression.speed import CALLS
from gridtrack.reports.figures import Axis, document
from gridtrack.reports.page import TEMPLATES
from gridtrack.reports.recording_section import TRACKER_COLOURS
from gridtrack.reports.verdict_text import band_text

PANEL_HEIGHT, GAP, LEFT, RIGHT, FOOT = 130, 46, 56, 24, 30
LEAST_WIDTH, STEP = 420, 26
"""Width of the smallest panel, and from one entry to the next, in SVG user units."""
LINE, CHARACTER = 16, 6.5
"""Height of a line of the legend, and width of a character in it."""
DRAWN_STRATA = ("dynamic", "in-motion", "visible", "occluded")
"""Strata with a panel of F1 in the middle step band; any other score has one once it was worse."""
FLOORS = ("persistence", "static-map", "blank")
"""Rows in the greys of the report: a history has no roles."""
MAX_LABELS = 24
SHORT_COMMIT = 7
SOFT, HAIR = "#5f646b", "#e2e3e5"


@dataclass(frozen=True, slots=True)
class Point:
    """A value of one entry with its standing; `low` and `high` are the ends of its interval, or the value."""

    value: float
    standing: str
    low: float
    high: float
    told: str


Panel = tuple[str, Mapping[str, Mapping[int, Point]]]
"""A title, and by tracker the points of its line by the number of the entry."""


def history_svg(entries: Sequence[HistoryEntry]) -> str:
    """A panel for each F1 of the middle step band, for each other score that was worse at any of the `entries`, the
    oldest first, and for the time of each call."""
    panels = [panel for panel in (*_score_panels(entries), *_time_panels(entries)) if panel[1]]
    colours = _colours(dict.fromkeys(name for _, lines in panels for name in lines))
    width = max(LEAST_WIDTH, STEP * len(entries))
    x = Axis(-0.5, len(entries) - 0.5, LEFT, LEFT + width)
    signs = ("x: worse", "line: worse in any score", "dashed: not measured")
    legend = list(_legend([*colours, *signs], {**colours, **dict.fromkeys(signs, SOFT)}, width))
    top = LINE * len(legend) + 30
    foot = top + len(panels) * (PANEL_HEIGHT + GAP)
    parts = [*legend]
    for number, (title, lines) in enumerate(panels):
        parts.append(_panel(top + number * (PANEL_HEIGHT + GAP), title, x, lines, entries, colours))
    parts.append(_commits(foot - GAP + 16, x, entries))
    return document(LEFT + width + RIGHT, foot + FOOT, parts, 11)


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
        lower = "" if score == "F1" else " (lower is better)"
        yield f"{_score_name(score, stratum, band)}{lower}", lines


def _score_name(score: str, stratum: str, band: str) -> str:
    return printable(f"{score}, {stratum}, {band_text(band)}")


def _time_panels(entries: Sequence[HistoryEntry]) -> Iterator[Panel]:
    for call in CALLS:
        times: dict[str, dict[int, Point]] = {}
        for at, entry in enumerate(entries):
            for time in (one for one in entry.speed if one.call == call):
                told = f"{time.label} takes {time.ratio:.3f} times as long as {time.against}"
                low, high = (time.ratio if end is None else end for end in (time.low, time.high))
                times.setdefault(printable(time.label), {})[at] = Point(time.ratio, time.standing, low, high, told)
        yield f"time of {call}, as a multiple of that of the base or the reference", times


def _panel(
    top: float,
    title: str,
    x: Axis,
    lines: Mapping[str, Mapping[int, Point]],
    entries: Sequence[HistoryEntry],
    colours: Mapping[str, str],
) -> str:
    points = [point for line in lines.values() for point in line.values()]
    low, high = min(point.low for point in points), max(point.high for point in points)
    room = max(0.1 * (high - low), min(0.005, 0.1 * high)) or 0.005
    y = Axis(low - room, high + room, top + PANEL_HEIGHT, top)
    parts = [f'<text x="{LEFT}" y="{top - 8}" font-weight="bold">{escape(title)}</text>']
    for tick in (low, high) if y(low) - y(high) > LINE else (high,):
        parts.append(f'<path d="M{x.start} {y(tick)}H{x.end}" stroke="{HAIR}"/>')
        parts.append(f'<text x="{x.start - 6}" y="{y(tick) + 4}" text-anchor="end">{tick:.4f}</text>')
    parts += [_upright(entry, f"M{x(at)} {top}v{PANEL_HEIGHT}") for at, entry in enumerate(entries)]
    for name, line in lines.items():
        parts += _line(line, x, y, entries, colours[name])
    return "".join(parts)


def _upright(entry: HistoryEntry, path: str) -> str:
    """A line from top to bottom of a panel, in every panel: what was worse, broken where nothing was measured."""
    if entry.verdict == "no worse":
        return ""
    measured = entry.verdict == "worse"
    told = _worse_text(entry) if measured else "; ".join(entry.reasons)
    look = f'stroke="{SOFT}"' if measured else f'stroke="{SOFT}" stroke-dasharray="2 3"'
    title = escape(printable(f"{_name(entry)}: {entry.verdict}: {told}"))
    return f'<path d="{path}" {look}><title>{title}</title></path>'


def _worse_text(entry: HistoryEntry) -> str:
    """What was worse, by tracker; an entry has no scores of single recordings, and no recoveries."""
    found: dict[str, list[str]] = {}
    for row in (one for one in entry.scores if one.standing == "worse"):
        found.setdefault(row.label, []).append(_score_name(row.score, row.stratum, row.band))
    for time in (one for one in entry.speed if one.standing == "worse"):
        found.setdefault(time.label, []).append(f"time of {time.call}")
    told = [f"{label} in {' and '.join(names)}" for label, names in found.items()]
    return "; ".join(told) or "a tracker on one recording, or its recoveries"


def _line(line: Mapping[int, Point], x: Axis, y: Axis, entries: Sequence[HistoryEntry], colour: str) -> Iterator[str]:
    """One line, its intervals, and a mark for each entry: a disc, and a cross where the run was worse there."""
    path = " ".join(f"{x(at)},{y(point.value)}" for at, point in line.items())
    yield f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="1.5"/>'
    for at, point in line.items():
        if point.low < point.high:
            yield f'<path d="M{x(at)} {y(point.low)}V{y(point.high)}" stroke="{colour}" opacity="0.5"/>'
        title = f"<title>{escape(printable(f'{_name(entries[at])}: {point.told}, {point.standing}'))}</title>"
        if point.standing == "worse":
            cross = f"M{x(at) - 5} {y(point.value) - 5}l10 10m0 -10l-10 10"
            yield f'<path d="{cross}" stroke="{colour}" stroke-width="3">{title}</path>'
        else:
            yield f'<circle cx="{x(at)}" cy="{y(point.value)}" r="3" fill="{colour}">{title}</circle>'


def _legend(names: Sequence[str], colours: Mapping[str, str], width: float) -> Iterator[str]:
    """The names in their colours, in as many lines as they take."""
    line, left = 0, float(LEFT)
    rows: list[list[str]] = [[]]
    for name in names:
        needed = CHARACTER * (len(name) + 2)
        if left + needed > LEFT + width and rows[line]:
            line, left = line + 1, float(LEFT)
            rows.append([])
        rows[line].append(f'<tspan x="{left:g}" fill="{colours[name]}">{escape(name)}</tspan>')
        left += needed
    for number, row in enumerate(rows):
        yield f'<text y="{LINE * (number + 1)}" font-weight="bold">{"".join(row)}</text>'


def _commits(top: float, x: Axis, entries: Sequence[HistoryEntry]) -> str:
    """The commit below each entry, of long histories below every few."""
    every = -(-len(entries) // MAX_LABELS)
    return "".join(
        f'<text transform="translate({x(at) - 3} {top}) rotate(40)" fill="{SOFT}">{escape(_name(entries[at]))}</text>'
        for at in range(0, len(entries), every)
    )


def _name(entry: HistoryEntry) -> str:
    """The commit in short, with a mark where tracked files differed from it; the day without a commit."""
    return f"{entry.commit[:SHORT_COMMIT]}{'+' if entry.changed else ''}" if entry.commit else entry.recorded[:8]


def _colours(names: Iterable[str]) -> dict[str, str]:
    """The colours of the lines, those of the report: greys for the floor, and again from the first after the last."""
    css = (TEMPLATES / "page.css").read_text("utf-8")
    found: dict[str, str] = {}
    trackers = 0
    for name in names:
        style = f"f{FLOORS.index(name)}" if name in FLOORS else f"t{trackers % TRACKER_COLOURS}"
        trackers += name not in FLOORS
        colour = re.search(rf"--{style}: (#[0-9a-f]{{3,6}})", css)
        assert colour is not None
        found[name] = colour[1]
    return found

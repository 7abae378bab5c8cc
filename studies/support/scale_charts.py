"""Fractions skill score over the side of a neighbourhood, as one small chart for each family of trackers, SVG."""

from __future__ import annotations

from html import escape

from gridtrack.evaluation.referee.splits import ORACLE
from gridtrack.evaluation.scores.neighbourhoods import SCALES
from gridtrack.reports.figures import Axis, document

from studies.support.unseen_places import FAMILIES, REFERENCE, PlaceScores

COLOURS = ("#1d4ed8", "#c2410c", "#0f766e")
"""Of the trackers of a family."""
GREY = "#777"
DASHES = {0.5: "none", 1.0: "5 3"}
"""The horizons that are drawn, seconds."""
WIDTH, HEIGHT, GAP, LEFT, TOP, BOTTOM, COLUMNS = 210, 150, 44, 36, 34, 62, 3


def scale_charts(scores: PlaceScores, stratum: str) -> str:
    """The charts of the families of which a tracker was measured, each with the reference in grey, and the oracle; the
    reference alone where none was."""
    families = {
        name: [one for one in members if one in scores.labels]
        for name, members in FAMILIES.items()
        if any(one in scores.labels for one in members)
    } or {REFERENCE: []}
    charts = [_chart(scores, stratum, at, name, members) for at, (name, members) in enumerate(families.items())]
    rows, columns = -(-len(charts) // COLUMNS), min(len(charts), COLUMNS)
    foot = rows * (TOP + HEIGHT + BOTTOM) + 14
    words = "fractions skill score over the side of a neighbourhood, cells; solid: 0.5 s ahead, dashed: 1 s"
    caption = f'<text x="{LEFT}" y="{foot}">{words}</text>'
    width = max(columns * (LEFT + WIDTH) + (columns - 1) * (GAP - LEFT) + 10, LEFT + 480)
    return document(width, foot + 10, [*charts, caption], font_size=11)


def _chart(scores: PlaceScores, stratum: str, at: int, name: str, members: list[str]) -> str:
    left, top = LEFT + at % COLUMNS * (WIDTH + GAP), TOP + at // COLUMNS * (TOP + HEIGHT + BOTTOM)
    x = Axis(SCALES[0], SCALES[-1], left, left + WIDTH)
    y = Axis(0.0, 1.0, top + HEIGHT, top)
    parts = [f'<text x="{left}" y="{top - 12}" font-weight="bold">{escape(name)}</text>']
    for tick in (0.0, 0.5, 1.0):
        parts.append(f'<path d="M{left} {y(tick):.1f}h{WIDTH}" stroke="#ddd"/>')
        parts.append(f'<text x="{left - 6}" y="{y(tick) + 4:.1f}" text-anchor="end">{tick:g}</text>')
    for scale in SCALES:
        parts.append(f'<text x="{x(scale):.1f}" y="{top + HEIGHT + 15}" text-anchor="middle">{scale}</text>')
    shown = [(label, GREY) for label in (REFERENCE, ORACLE) if label in scores.labels]
    shown += [(label, COLOURS[k % len(COLOURS)]) for k, label in enumerate(members)]
    for label, colour in shown:
        parts += _lines(scores, stratum, label, colour, x, y)
    for k, (label, colour) in enumerate(shown[len(shown) - len(members) :]):
        parts.append(_key(left + k * WIDTH / 2, top + HEIGHT + 32, label, colour))
    return "".join(parts)


def _lines(scores: PlaceScores, stratum: str, label: str, colour: str, x: Axis, y: Axis) -> list[str]:
    """The curve of a row at each horizon; none where it has no such score."""
    found, lines = scores.strata[label].get(stratum), []
    for horizon_s, dash in DASHES.items():
        step = scores.horizons.get(horizon_s)
        values = [found.at(f"fss_{scale}", step) for scale in SCALES] if found and step else []
        points = " ".join(f"{x(s):.1f},{y(v):.1f}" for s, v in zip(SCALES, values, strict=False) if v is not None)
        if points:
            dashed = f' stroke-dasharray="{dash}"' if dash != "none" else ""
            lines.append(f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="2"{dashed}/>')
    return lines


def _key(x: float, y: float, label: str, colour: str) -> str:
    return (
        f'<path d="M{x:.0f} {y - 4}h18" stroke="{colour}" stroke-width="2"/>'
        f'<text x="{x + 23:.0f}" y="{y}">{escape(label)}</text>'
    )

"""Label budget as curves: the mean and the range over draws of the table of `studies/label_budget.py`.

`python -m studies.label_curve [TABLE]` (one second) draws the table into an SVG file beside it, and writes the means
that the text of the page has.
"""

from __future__ import annotations

import argparse
import statistics
from collections import defaultdict
from html import escape
from pathlib import Path

from gridtrack.reports.figures import Axis, document

from studies.support.label_table import BUDGETS, COLUMNS, read_rows
from studies.support.results_file import ResultSection, write_section
from studies.support.svg import svg_path

TABLE = Path("docs/results/junction/label-budget.csv")
RESULTS = Path("docs/results/trackers/one-shot.json")
STYLES = {"one-shot": "#c2410c", "latent": "#1d4ed8", "latent, linear": "#0f766e", "latent and scan": "#7e22ce"}
DASHES = {"spread": "none", "consecutive": "5 3"}
WIDTH, HEIGHT, GAP, LEFT, TOP, BOTTOM = 270, 220, 46, 40, 30, 42
LOSSES = (0.1, 0.2, 0.5, 1.0, 2.0)
"""Ticks of the loss axis, nats a scan."""

Points = list[tuple[int, float, float, float]]
"""Of each budget its number of scans, and mean, least and most over the draws."""


def curves(path: Path, column: str) -> dict[tuple[str, str], Points]:
    """The curve of each method and drawing."""
    values: dict[tuple[str, str], dict[int, list[float]]] = defaultdict(lambda: defaultdict(list))
    for row in read_rows(path):
        values[row["method"], row["drawing"]][int(row["scans"])].append(float(row[column]))
    return {
        line: [(scans, statistics.fmean(own), min(own), max(own)) for scans, own in sorted(of_scans.items())]
        for line, of_scans in values.items()
    }


def means(path: Path) -> dict[str, str]:
    """The mean over the draws of each drawing, method, budget and column, for texts."""
    return {
        f"{drawn}, {method}, {scans}, {column}": f"{mean:.2f}"
        for column in COLUMNS
        for (method, drawn), points in curves(path, column).items()
        for scans, mean, _, _ in points
    }


def curve_panel(number: int, title: str, lines: dict[tuple[str, str], Points]) -> str:
    """One column of the table as axes and curves."""
    left = LEFT + number * (WIDTH + GAP)
    x = Axis(BUDGETS[0], BUDGETS[-1], left, left + WIDTH, logarithmic=True)
    y = Axis(0.08, 2.2, TOP + HEIGHT, TOP, logarithmic=True)
    parts = [f'<text x="{left}" y="18" font-weight="bold">{escape(title)}</text>']
    for loss in LOSSES:
        parts.append(f'<path d="M{left} {y(loss)}h{WIDTH}" stroke="#ddd"/>')
        parts.append(f'<text x="{left - 6}" y="{y(loss) + 4}" text-anchor="end">{loss:g}</text>')
    for scans in BUDGETS:
        parts.append(f'<text x="{x(scans)}" y="{TOP + HEIGHT + 16}" text-anchor="middle">{scans}</text>')
    for (method, drawing), points in lines.items():
        above = [f"{x(scans)},{y(most)}" for scans, _, _, most in points]
        below = [f"{x(scans)},{y(least)}" for scans, _, least, _ in reversed(points)]
        mean = " ".join(f"{x(scans)},{y(value)}" for scans, value, _, _ in points)
        colour = STYLES[method]
        parts.append(f'<polygon points="{" ".join(above + below)}" fill="{colour}" opacity="0.13"/>')
        parts.append(
            f'<polyline points="{mean}" fill="none" stroke="{colour}" stroke-width="2"'
            f' stroke-dasharray="{DASHES[drawing]}"/>'
        )
    return "".join(parts)


def drawing(path: Path) -> str:
    """The figure, SVG."""
    panels = [curve_panel(number, title, curves(path, title)) for number, title in enumerate(COLUMNS)]
    foot, width = TOP + HEIGHT + 36, LEFT + len(panels) * (WIDTH + GAP)
    keys = [
        f'<path d="M{LEFT + 150 * k} {foot - 4}h22" stroke="{colour}" stroke-width="2"/>'
        f'<text x="{LEFT + 150 * k + 28}" y="{foot}">{escape(method)}</text>'
        for k, (method, colour) in enumerate(STYLES.items())
    ]
    text = "log loss, nats a scan, by labelled scans (dashed: in a row)"
    caption = f'<text x="{width - GAP}" y="{foot}" text-anchor="end">{text}</text>'
    return document(width, TOP + HEIGHT + BOTTOM, [*panels, *keys, caption], font_size=12)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("table", type=Path, nargs="?", default=TABLE)
    parser.add_argument("--picture", type=svg_path, help="default: beside the table")
    parser.add_argument("--results", type=Path, default=RESULTS)
    given = parser.parse_args()
    (given.picture or given.table.with_suffix(".svg")).write_text(drawing(given.table))
    section = ResultSection(command="python -m studies.label_curve", values=means(given.table))
    write_section(given.results, "how many labels", section)


if __name__ == "__main__":
    main()

"""Figures for print: scores over the horizon, a panel for each score and stratum, as SVG or PDF."""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

from gridtrack.common.errors import ConfigurationError, printable
from gridtrack.evaluation.runs.summary import StratumScores
from gridtrack.reports.chosen_scores import ExportedTable
from gridtrack.reports.page import TEMPLATES
from gridtrack.reports.recording_section import styles_of
from gridtrack.reports.run import ReportedRun
from gridtrack.reports.score_frames import SCORES
from gridtrack.reports.table import TableColumn

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D

PANEL_INCHES = (2.6, 2.2)
DASHES: Mapping[str, tuple[float, ...]] = {
    "f0": (7, 3),
    "f1": (3, 2),
    "f2": (1.5, 3),
    "ceiling": (1, 2),
    "again": (10, 2, 2, 2),
    "run0": (),
    "run1": (7, 3),
    "run2": (2, 2),
    "run3": (9, 2, 2, 2),
}
"""Dashes of each class of a style, as page.css has them; the last class of a style decides."""
SETTINGS: dict[Any, Any] = {
    "font.family": "sans-serif",
    "font.size": 8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "pdf.fonttype": 42,  # whole outlines: journals refuse Type 3 fonts
    "svg.fonttype": "none",  # text stays text
    "svg.hashsalt": "gridtrack",  # the same run is the same file
}


def print_figure(
    runs: Sequence[ReportedRun], exported: Sequence[ExportedTable], kind: Literal["svg", "pdf"], scores: str
) -> bytes:
    """The scores of `exported` over every horizon, a row of panels for each recording; bands are 95 % intervals.

    Without `scores`, the columns as the user chose them, each F1 of the headline is drawn. Raises ConfigurationError
    where matplotlib is not installed.
    """
    try:
        import matplotlib
        from matplotlib.figure import Figure
    except ImportError:
        raise ConfigurationError(f"{kind} needs matplotlib: pip install 'gridtrack[figures]'") from None
    panels = [_panels(one, bool(scores)) for one in exported]
    width, height = PANEL_INCHES
    css = (TEMPLATES / "page.css").read_text("utf-8")
    looks = {key: _look(style, css) for key, style in styles_of(runs).items()}
    with matplotlib.rc_context(SETTINGS), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph")  # a name in a script that the font lacks is drawn as boxes
        figure = Figure((width * max(map(len, panels)), height * len(panels)), layout="constrained")
        axes = figure.subplots(len(panels), max(map(len, panels)), squeeze=False)
        lines: dict[str, Line2D] = {}
        for one, columns, beside in zip(exported, panels, axes, strict=True):
            for axis in beside[len(columns) :]:
                axis.set_axis_off()
            for column, axis in zip(columns, beside, strict=False):
                lines |= _draw(axis, one, column, looks, titled=len(exported) > 1)
        legend = figure.legend(list(lines.values()), list(lines), loc="outside right upper", frameon=False)
        for text in legend.get_texts():
            text.set_parse_math(False)
        written = io.BytesIO()
        date = "Date" if kind == "svg" else "CreationDate"
        figure.savefig(written, format=kind, metadata={date: None, "Creator": "gridtrack"})
    return written.getvalue()


def _panels(one: ExportedTable, chosen: bool) -> list[TableColumn]:
    """A column for each score and stratum."""
    columns = {(c.score, c.stratum): c for c in one.table.columns if chosen or c.group.startswith("F1")}
    return list(columns.values())


def _look(style: str, css: str) -> tuple[str, tuple[float, ...]]:
    """The colour and the dashes that a style has on the light page."""
    name, *further = style.split()
    variable = "ink" if name == "ceiling" else name
    found = re.search(rf"--{variable}: (#[0-9a-f]{{3,6}})", css)
    if found is None:
        raise AssertionError(f"page.css has no colour --{variable}")
    return found[1], DASHES.get((name, *further)[-1], ())


def _draw(
    axis: Axes,
    one: ExportedTable,
    column: TableColumn,
    looks: Mapping[str, tuple[str, tuple[float, ...]]],
    titled: bool,
) -> dict[str, Line2D]:
    """One panel: a line for each row from step 1 on, as step 0 is the input frame; the lines by their names."""
    lines: dict[str, Line2D] = {}
    for row in one.table.rows:
        scores = row.trial.strata.get(column.stratum)
        if scores is None or not row.trial.ranked:
            continue
        colour, dashes = looks[row.key]
        values = _values(scores, column.score, one.table.horizons_s)
        (line,) = axis.plot(
            one.table.horizons_s[1:], values, color=colour, linewidth=1.2, dashes=dashes or (None, None)
        )
        lines[printable(row.name)] = line
        if f"{column.score}_low" in SCORES:
            low, high = (_values(scores, f"{column.score}_{end}", one.table.horizons_s) for end in ("low", "high"))
            axis.fill_between(one.table.horizons_s[1:], low, high, color=colour, alpha=0.13, linewidth=0)
    title = f"{one.table.recording}: {column.group}" if titled else column.group
    axis.set_title(printable(title), fontsize=8, parse_math=False)
    axis.set_xlabel("horizon, s")
    axis.grid(linewidth=0.4, alpha=0.5)
    if column.better > 0:
        axis.set_ylim(min(0.0, axis.dataLim.y0), 1.0)  # a share of the oracle may be below 0
    return lines


def _values(scores: StratumScores, score: str, horizons_s: Sequence[float]) -> list[float]:
    """A score from step 1 on; NaN where it is undefined."""
    values = (scores.at(score, step) for step in range(1, len(horizons_s)))
    return [float("nan") if value is None else value for value in values]

"""Figures for print: scores over the horizon, a panel for each score and stratum, as SVG or PDF."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Literal

from gridtrack.common.errors import ConfigurationError, printable
from gridtrack.evaluation.runs.result_files import Curve
from gridtrack.reports.chosen_scores import ExportedTable
from gridtrack.reports.run import ReportedRun
from gridtrack.reports.styles import look_of, styles_of
from gridtrack.reports.table import TableColumn

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.legend import Legend
    from matplotlib.lines import Line2D

PANEL_INCHES = (2.6, 2.2)
SETTINGS: dict[Any, Any] = {
    "font.family": "sans-serif",
    "font.size": 8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "pdf.fonttype": 42,  # whole outlines: journals refuse Type 3 fonts
    "svg.fonttype": "none",  # text stays text
    "svg.hashsalt": "gridtrack",  # the same run is the same file
}


@contextmanager
def figure_style(what: str) -> Iterator[type[Figure]]:
    """matplotlib's Figure, with the style of SETTINGS in the block.

    Raises ConfigurationError, about the figure `what`, if matplotlib is not installed.
    """
    try:
        import matplotlib
        from matplotlib.figure import Figure
    except ImportError:
        raise ConfigurationError(f"{what} needs matplotlib: pip install 'gridtrack[figures]'") from None
    with matplotlib.rc_context(SETTINGS), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph")  # a name in a script that the font lacks is drawn as boxes
        yield Figure


def file_of(figure: Figure, kind: Literal["svg", "pdf"], legend: Legend) -> bytes:
    """The file of a figure, without its date; names in its `legend` are plain text."""
    for text in legend.get_texts():
        text.set_parse_math(False)
    written = io.BytesIO()
    date = "Date" if kind == "svg" else "CreationDate"
    figure.savefig(written, format=kind, metadata={date: None, "Creator": "gridtrack"})
    return written.getvalue()


def print_figure(
    runs: Sequence[ReportedRun], exported: Sequence[ExportedTable], kind: Literal["svg", "pdf"], scores: str
) -> bytes:
    """The scores of `exported` over every horizon, a row of panels for each recording; bands are 95 % intervals.

    `scores`: the user's choice of columns; empty: the headline score in each stratum. Raises ConfigurationError if
    matplotlib is not installed.
    """
    panels = [_panels(one, bool(scores)) for one in exported]
    width, height = PANEL_INCHES
    looks = {key: look_of(style) for key, style in styles_of(runs).items()}
    with figure_style(kind) as new_figure:
        figure = new_figure((width * max(map(len, panels)), height * len(panels)), layout="constrained")
        axes = figure.subplots(len(panels), max(map(len, panels)), squeeze=False)
        lines: dict[str, Line2D] = {}
        for one, columns, beside in zip(exported, panels, axes, strict=True):
            for axis in beside[len(columns) :]:
                axis.set_axis_off()
            for column, axis in zip(columns, beside, strict=False):
                lines |= _draw(axis, one, column, looks, titled=len(exported) > 1)
        legend = figure.legend(list(lines.values()), list(lines), loc="outside right upper", frameon=False)
        return file_of(figure, kind, legend)


def _panels(one: ExportedTable, chosen: bool) -> list[TableColumn]:
    """A column for each score and stratum."""
    columns = {(c.key, c.stratum): c for c in one.table.columns if chosen or c.key == one.table.headline}
    return list(columns.values())


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
        estimate = row.trial.estimate(column.stratum, *column.key)
        if estimate is None or not row.trial.ranked:
            continue
        colour, dashes = looks[row.key]
        later_s = one.table.horizons_s[1:]
        values = _later(estimate.value, len(later_s))
        (line,) = axis.plot(later_s, values, color=colour, linewidth=1.2, dashes=dashes or (None, None))
        lines[printable(row.name)] = line
        if estimate.low is not None and estimate.high is not None:
            low, high = (_later(end, len(later_s)) for end in (estimate.low, estimate.high))
            axis.fill_between(later_s, low, high, color=colour, alpha=0.13, linewidth=0)
    title = f"{one.table.recording}: {column.group}" if titled else column.group
    axis.set_title(printable(title), fontsize=8, parse_math=False)
    axis.set_xlabel("horizon, s")
    axis.grid(linewidth=0.4, alpha=0.5)
    if column.better > 0 and axis.dataLim.y1 <= 1.0:
        axis.set_ylim(min(0.0, axis.dataLim.y0), 1.0)  # a share of the oracle may be below 0
    return lines


def _later(curve: Curve, steps: int) -> list[float]:
    """A curve at steps 1 to `steps`; NaN if it is undefined."""
    return [float("nan") if value is None else value for value in curve[1 : steps + 1]]

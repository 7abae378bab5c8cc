"""The report page: one HTML file that opens from disk, with no script in it and nothing to fetch."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from gridtrack.reports.facts import Fact, facts_of, lead_of, provenance_of, title_of
from gridtrack.reports.figures import CurvePanel, Series, TimeScale, curve_panel, time_scale
from gridtrack.reports.film import Film, film_of
from gridtrack.reports.notices import Notice, notices_of
from gridtrack.reports.pictures import scale_png
from gridtrack.reports.run import FLOOR, Run, StratumScores, read_runs
from gridtrack.reports.table import DETAIL_HORIZON_S, HORIZONS_S, UNDEFINED, HeadlineTable, Row, headline_tables

TEMPLATES = Path(__file__).parent / "templates"
COLOURS = 8
"""Trackers beyond this many repeat the colours, with broken lines."""
PANELS = (("moving", (740, 460), 150.0), ("visible", (370, 222), 0.0), ("static", (370, 222), 0.0))
"""Stratum, size and label width of the curves: the stratum to look at first is the largest."""
TIME_WIDTH = 220.0


@dataclass(frozen=True)
class ThresholdMark:
    """F1 of moving cells at one horizon, at the chosen threshold and at 0.5."""

    threshold: float | None
    f1: float | None
    f1_at_half: float | None


@dataclass(frozen=True)
class Section:
    """Everything that the page shows of one recording."""

    table: HeadlineTable
    curves: tuple[tuple[str, tuple[CurvePanel, ...]], ...]
    """Per run its name (empty where there is only one) and its panels."""
    threshold_horizons: tuple[str, ...]
    thresholds: tuple[tuple[Row, tuple[ThresholdMark, ...]], ...]
    time_scale: TimeScale
    period_ms: float | None
    film: Film | None


def render_report(runs: Sequence[Path], out: Path | None = None) -> Path:
    """Write the report of `runs` and return its path: `out`, or index.html in the first run's folder `report`.

    Several runs stand side by side on one page, without `out` in side-by-side.html. Raises ReportError.
    """
    read = read_runs(runs)
    path = out or runs[0] / "report" / ("index.html" if len(runs) == 1 else "side-by-side.html")
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(path.name + ".partial")
    partial.write_text(render_page(read), "utf-8")
    partial.replace(path)
    return path

"""Scores that forgive a few cells: the fractions skill score over the scale, soft IoU and errors along beams."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from gridtrack.common.grid import GridSpec
from gridtrack.evaluation.results.columns import SCALES
from gridtrack.evaluation.results.trial_summary import StratumScores
from gridtrack.reports.figures import Series
from gridtrack.reports.sweeps import SweepPanel, series_of, sweep_panel
from gridtrack.reports.table import MAIN_STRATUM, HeadlineTable, TableCell, TableRow

PANEL_STRATA = (MAIN_STRATUM, "dynamic")
"""The strata whose fractions skill score is drawn."""
FSS = {f"fss_{scale}": scale for scale in SCALES}
"""The scale of each fractions skill score, by its name in summary.json."""
HEADINGS = {
    **{name: f"FSS, {scale} cell{'s' * (scale > 1)}" for name, scale in FSS.items()},
    "soft_iou": "soft IoU",
    "beam_error": "mean, m",
    "beam_error_median": "median, m",
    "beam_bias": "bias, m",
}
"""The scores by their names in summary.json."""


@dataclass(frozen=True)
class SpatialScoresAt:
    """The scores of every tracker in one stratum at one horizon, in the order of HEADINGS."""

    stratum: str
    horizon: str
    rows: tuple[tuple[TableRow, tuple[TableCell, ...]], ...]


@dataclass(frozen=True)
class SpatialSection:
    """`panels`: the fractions skill score over the scale; `main`: the scores that stand first; `others`: all."""

    panels: tuple[SweepPanel, ...]
    main: SpatialScoresAt
    others: tuple[SpatialScoresAt, ...]
    cells: str
    """Of what size cells are."""
    has_bands: bool
    headings: tuple[str, ...] = tuple(HEADINGS.values())
    neighbourhood_headings: int = len(FSS) + 1
    """How many of the headings are scores of neighbourhoods and cells; those of beams follow."""

    @property
    def series(self) -> tuple[Series, ...]:
        """Every tracker that a panel shows, once, in the order of the table."""
        return series_of(self.panels)[::-1]


def spatial_section(table: HeadlineTable, grid: str, styles: Mapping[str, str]) -> SpatialSection | None:
    """The section of a recording with this `grid`; None for a run of before, which has no such scores.

    The `grid` of recordings together is empty where theirs differ.
    """
    rows = [row for row in table.rows if _fss(row, MAIN_STRATUM) is not None]
    if not rows:
        return None
    horizons = [(c.heading, c.step) for c in table.columns if c.score == "f1" and c.stratum == MAIN_STRATUM]
    strata = dict.fromkeys(name for row in rows for name, scores in row.trial.strata.items() if _has_any(scores))
    every = {
        (stratum, step): _scores_at(rows, stratum, heading, step) for stratum in strata for heading, step in horizons
    }
    panels = tuple(
        _panel(rows, stratum, heading, step, styles) for stratum in PANEL_STRATA for heading, step in horizons
    )
    has_bands = any(line.band for panel in panels for line in panel.lines)
    cells = f"cells of {GridSpec.parse(grid).cell_m:g} m" if grid else "the cells of each recording"
    return SpatialSection(panels, every[MAIN_STRATUM, table.decisive.step], tuple(every.values()), cells, has_bands)


def _fss(row: TableRow, stratum: str) -> StratumScores | None:
    """The scores of a trial in a stratum; None where it has no fractions skill score."""
    scores = row.trial.strata.get(stratum)
    return None if scores is None or scores.fss_1 is None else scores


def _has_any(scores: StratumScores) -> bool:
    return any(getattr(scores, name) is not None for name in HEADINGS)


def _scores_at(rows: Sequence[TableRow], stratum: str, heading: str, step: int) -> SpatialScoresAt:
    cells = (
        (row, tuple(_cell(row.trial.strata[stratum], name, step) for name in HEADINGS))
        for row in rows
        if stratum in row.trial.strata
    )
    return SpatialScoresAt(stratum, heading, tuple(cells))


def _cell(scores: StratumScores, name: str, step: int) -> TableCell:
    low, high = (scores.at(f"{name}_{end}", step) for end in ("low", "high"))
    return TableCell(scores.at(name, step), interval=None if low is None or high is None else (low, high))


def _panel(rows: Sequence[TableRow], stratum: str, heading: str, step: int, styles: Mapping[str, str]) -> SweepPanel:
    """The score over the scale, in the reverse order of the table, so that the best is drawn on top."""
    shown = [(row, scores) for row in reversed(rows) if (scores := _fss(row, stratum)) is not None]
    ends = [tuple([scores.at(f"{name}_{end}", step) for name in FSS] for end in ("low", "high")) for _, scores in shown]
    return sweep_panel(
        "FSS",
        f"{stratum} cells, {heading} ahead",
        [(float(scale), f"{scale}{' cells' if scale == SCALES[-1] else ''}") for scale in SCALES],
        [
            (Series(row.label, row.name, styles[row.label]), [scores.at(name, step) for name in FSS])
            for row, scores in shown
        ],
        [(low, high) for low, high in ends],
        top=1.0,
    )

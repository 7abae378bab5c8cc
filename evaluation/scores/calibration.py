"""Calibration error: how far the probabilities of a forecast are from the share of occupied cells."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from gridtrack.evaluation.referee.referee import ScoredForecast
from gridtrack.evaluation.scores.cells import CALIBRATION_BINS, CALIBRATION_EDGES, cells_of, for_calibration
from gridtrack.evaluation.scores.definition import Floats, Output, ScoreDefinition, Sums, TrialFacts, block, divided

POSSIBLY_OCCUPIED = 10 / 1024
"""A tracker considers cells with at least this probability, about 1 %, possibly occupied."""
LEAST_CELLS = 50
"""A bin of fewer cells has no share of occupied cells in the figure: it is mostly noise."""


def calibration_sums(forecast: ScoredForecast) -> Floats:
    """Cells, occupied cells and the sum of the probability (S, K, 3 C) in the bins for calibration."""
    tally = forecast.once(cells_of)
    counts = (for_calibration(tally.cells), for_calibration(tally.positives), tally.p_sum)
    return np.concatenate(counts, axis=-1, dtype=np.float64)


def calibration_parts() -> tuple[str, ...]:
    """Names of the sums."""
    return tuple(part for name in ("cells", "occupied", "p") for part in block(name, CALIBRATION_BINS))


def _count(forecast: ScoredForecast, facts: TrialFacts, memory: None) -> Floats:
    return forecast.once(calibration_sums)


def _value(sums: Sums) -> Mapping[str, Floats]:
    """|mean probability - share occupied| of each bin, weighted by its cells; over all bins, and from about 1 % on."""
    cells, positives, p_sum = (sums.block(name) for name in ("cells", "occupied", "p"))
    apart, first = np.abs(p_sum - positives), int(np.searchsorted(CALIBRATION_EDGES, POSSIBLY_OCCUPIED))
    return {
        "error": divided(apart.sum(axis=-1), cells.sum(axis=-1)),
        "above_1_percent": divided(apart[..., first:].sum(axis=-1), cells[..., first:].sum(axis=-1)),
    }


def _figure(sums: Sums) -> dict[str, Any]:
    """Mean probability and share of occupied cells of each bin with at least LEAST_CELLS; sums (U, P) of units."""
    cells, positives, p_sum = (sums.block(name).sum(axis=0) for name in ("cells", "occupied", "p"))
    enough = cells >= LEAST_CELLS
    return {"mean_p": p_sum[enough] / cells[enough], "share": positives[enough] / cells[enough]}


CALIBRATION = ScoreDefinition(
    name="calibration",
    title="Calibration error",
    position=50,
    outputs=(
        Output("error", "Calibration error", better="lower"),
        Output("above_1_percent", "Calibration error, p ≥ 1 %", better="lower"),
    ),
    about="Expected calibration error: |mean probability - share of occupied cells| of each bin of probability,"
    " weighted by its cells. Most cells are free and get a probability near 0, so the error over all cells is small"
    " for any tracker; the second form is over the cells that the tracker considers possibly occupied, which differ"
    " between trackers.",
    parts=lambda facts: calibration_parts(),
    count=_count,
    value=_value,
    figure=_figure,
)

"""Brier score of the probability of a cell, and its decomposition."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gridtrack.evaluation.referee.referee import ScoredForecast
from gridtrack.evaluation.scores.calibration import calibration_parts, calibration_sums
from gridtrack.evaluation.scores.cells import cells_of
from gridtrack.evaluation.scores.definition import Floats, Output, Ratio, ScoreDefinition, Sums, TrialFacts, divided


def _count(forecast: ScoredForecast, facts: TrialFacts, memory: None) -> Floats:
    squared_error = forecast.once(cells_of).squared_error
    return np.concatenate([squared_error[..., None], forecast.once(calibration_sums)], axis=-1)


def _value(sums: Sums) -> Mapping[str, Ratio | Floats]:
    """The score and Murphy's decomposition: reliability - resolution + uncertainty is the score.

    The decomposition (1973) assumes one probability per bin. The variance of the probability within bins and its
    covariance with the occupancy are added to the resolution, so that the sum is exact (Stephenson, Coelho and
    Jolliffe, 2008, "Two extra components in the Brier score decomposition").
    """
    cells_of_bin, positives_of_bin, p_sum = (sums.block(name) for name in ("cells", "occupied", "p"))
    cells, positives = cells_of_bin.sum(axis=-1), positives_of_bin.sum(axis=-1)
    rate, rate_of_bin = divided(positives, cells), np.nan_to_num(divided(positives_of_bin, cells_of_bin))
    p_of_bin = np.nan_to_num(divided(p_sum, cells_of_bin))
    reliability = divided((cells_of_bin * (p_of_bin - rate_of_bin) ** 2).sum(axis=-1), cells)
    uncertainty = rate * (1.0 - rate)
    brier = divided(sums["squared error"], cells)
    return {
        "mean": Ratio(sums["squared error"], cells),
        "reliability": reliability,
        "resolution": reliability + uncertainty - brier,
        "uncertainty": uncertainty,
    }


BRIER = ScoreDefinition(
    name="brier",
    title="Brier score",
    position=40,
    outputs=(
        Output("mean", "Brier score", better="lower", scale="odds"),
        Output("reliability", "Brier: reliability", better="lower"),
        Output("resolution", "Brier: resolution"),
        Output("uncertainty", "Brier: uncertainty"),
    ),
    about="Mean of (p - o)^2 over cells, o being 1 for an occupied cell and 0 for a free one. Proper. Reliability is 0"
    " for calibrated forecasts; resolution says how far the forecast separates occupied from free cells. Murphy, 1973;"
    " Stephenson, Coelho and Jolliffe, 2008.",
    parts=lambda facts: ("squared error", *calibration_parts()),
    count=_count,
    value=_value,
)

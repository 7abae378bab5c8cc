"""Fractions skill score: agreement of the share of occupied cells in neighbourhoods."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gridtrack.evaluation.referee.referee import ScoredForecast
from gridtrack.evaluation.scores.definition import Floats, Output, Ratio, ScoreDefinition, Sums, TrialFacts
from gridtrack.evaluation.scores.neighbourhoods import SCALES, neighbourhood_strata, neighbourhoods_of


def _count(forecast: ScoredForecast, facts: TrialFacts, memory: None) -> Floats:
    sums = forecast.once(neighbourhoods_of)
    return np.concatenate([sums.agreement, sums.squares], axis=-1)


def _value(sums: Sums) -> Mapping[str, Ratio]:
    """By scale; sums are multiplied by the cells of a neighbourhood, so that a lone occupied cell counts as one."""
    found = {}
    for scale in SCALES:
        squares = scale**2 * sums[f"squares {scale}"]
        agreement = np.minimum(scale**2 * sums[f"agreement {scale}"], squares)  # not above 1 by rounding
        found[f"{scale}_cells"] = Ratio(agreement, squares, counted=True)
    return found


def _output(scale: int) -> Output:
    cells = "1 cell" if scale == 1 else f"{scale} cells"
    return Output(f"{scale}_cells", f"FSS, {cells}", better="higher", scale="odds", tested=True)


FSS = ScoreDefinition(
    name="fss",
    title="Fractions skill score",
    position=60,
    outputs=tuple(_output(scale) for scale in (5, 1, 3, 9)),
    about="1 - sum (P - O)^2 / (sum P^2 + sum O^2), P being the mean probability and O the share of occupied cells of a"
    " square of 1, 3, 5 or 9 cells about each cell of the stratum. 1 is a perfect forecast. It forgives a forecast that"
    " is right but a few cells away; a blurred forecast is not punished at a scale larger than its blur. Roberts and"
    " Lean, 2008.",
    strata=lambda facts: neighbourhood_strata(facts.strata),
    parts=lambda facts: tuple(f"{name} {scale}" for name in ("agreement", "squares") for scale in SCALES),
    count=_count,
    value=_value,
)

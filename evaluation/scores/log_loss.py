"""Log loss of the probability of a cell, in nats."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gridtrack.evaluation.referee.referee import ScoredForecast
from gridtrack.evaluation.scores.cells import cells_of
from gridtrack.evaluation.scores.definition import (
    CurvesByStratum,
    Floats,
    Output,
    Ratio,
    ScoreDefinition,
    Sums,
    TrialFacts,
)
from gridtrack.evaluation.scores.relations import share_of_oracle

LEAST_LOSS_GAP = 0.01
"""No share is computed if the oracle's log loss is less than this share of the best floor's below it."""


def _count(forecast: ScoredForecast, facts: TrialFacts, memory: None) -> Floats:
    tally = forecast.once(cells_of)
    return np.stack([tally.log_loss, tally.cells.sum(axis=-1)], axis=-1).astype(np.float64)


def _value(sums: Sums) -> Mapping[str, Ratio]:
    return {"mean": Ratio(sums["loss"], sums["cells"])}


def _relate(
    own: CurvesByStratum, floor: CurvesByStratum | None, oracle: CurvesByStratum | None
) -> dict[str, CurvesByStratum]:
    return {"oracle_share": share_of_oracle(own, floor, oracle, -1, LEAST_LOSS_GAP, relative=True)}


LOG_LOSS = ScoreDefinition(
    name="log_loss",
    title="Log loss",
    position=30,
    outputs=(
        Output(
            "mean",
            "Log loss",
            unit="nats",
            better="lower",
            scale="log",
            tested=True,
            margin=0.05,
            relative_margin=True,
            decimals=4,
        ),
        Output("oracle_share", "Share of the oracle, log loss", better="higher"),
    ),
    about="Mean negative log likelihood of a cell, with probabilities clipped to [0.001, 0.999]. Proper: the true"
    " probability has the lowest expected loss.",
    parts=lambda facts: ("loss", "cells"),
    count=_count,
    value=_value,
    relate=_relate,
)

"""Soft IoU: intersection over union of probabilities."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gridtrack.evaluation.referee.referee import ScoredForecast
from gridtrack.evaluation.scores.definition import Floats, Output, Ratio, ScoreDefinition, Sums, TrialFacts
from gridtrack.evaluation.scores.neighbourhoods import neighbourhood_strata, neighbourhoods_of


def _count(forecast: ScoredForecast, facts: TrialFacts, memory: None) -> Floats:
    sums = forecast.once(neighbourhoods_of)
    return np.stack([sums.agreement[..., 0] / 2, sums.soft_union], axis=-1)


def _value(sums: Sums) -> Mapping[str, Ratio]:
    intersection, union = sums["intersection"], sums["union"]
    return {"iou": Ratio(np.minimum(intersection, union), union)}


SOFT_IOU = ScoreDefinition(
    name="soft_iou",
    title="Soft IoU",
    position=70,
    outputs=(Output("iou", "Soft IoU", better="higher", scale="odds"),),
    about="Sum of p o over the sum of p + o - p o, over cells. It favours sharp forecasts: persistence can lead it. So"
    " it is shown, and no tracker is compared by it.",
    strata=lambda facts: neighbourhood_strata(facts.strata),
    parts=lambda facts: ("intersection", "union"),
    count=_count,
    value=_value,
)

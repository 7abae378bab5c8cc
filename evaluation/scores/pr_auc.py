"""PR-AUC: the area under the precision-recall curve of the cells of a stratum."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gridtrack.evaluation.referee.referee import ScoredForecast
from gridtrack.evaluation.scores.cells import PROBABILITY_BINS, PROBABILITY_EDGES, cells_of
from gridtrack.evaluation.scores.definition import (
    Floats,
    Measure,
    Output,
    Ratio,
    ScoreDefinition,
    Sums,
    TrialFacts,
    block,
    divided,
)

MOST_POINTS = 40
"""Points of a curve, at about equal steps of recall, and as many ends of flat parts; all would be some hundred."""


def _count(forecast: ScoredForecast, facts: TrialFacts, memory: None) -> Floats:
    """Cells and occupied cells (S, K, 2 B), by probability."""
    tally = forecast.once(cells_of)
    return np.concatenate([tally.cells, tally.positives], axis=-1, dtype=np.float64)


def _value(sums: Sums) -> Mapping[str, Measure]:
    cells, positives = sums.block("cells"), sums.block("occupied")
    return {"area": Measure(area_under_precision_recall(cells, positives), positives.sum(axis=-1))}


def area_under_precision_recall(cells: Floats, positives: Floats) -> Floats:
    """Area (...) under the precision-recall curve of histograms (..., B): precision weighted by the gain in recall."""
    true_positive = positives[..., ::-1].cumsum(axis=-1)
    called = cells[..., ::-1].cumsum(axis=-1)
    gain = divided(positives[..., ::-1], true_positive[..., -1:])
    area: Floats = (gain * np.nan_to_num(divided(true_positive, called))).sum(axis=-1)
    return area


def _figure(sums: Sums) -> dict[str, Floats | Ratio]:
    """Thresholds `p` from the highest down, with precision and recall of the cells at and above each; sums (U, P).

    Of thresholds at which the same cells are called occupied there are the highest and the lowest: F1 is flat between.
    """
    found_of, called_of = (sums.block(name)[:, ::-1].cumsum(axis=1) for name in ("occupied", "cells"))
    found, called = found_of.sum(axis=0), called_of.sum(axis=0)
    if not found[-1]:
        return {}
    recall = found / found[-1]
    wanted = np.searchsorted(recall, np.linspace(0.0, 1.0, MOST_POINTS))
    highest = np.maximum(wanted, np.flatnonzero(called)[0])
    lowest = np.searchsorted(called, called[highest], side="right") - 1
    at = np.union1d(highest, lowest)
    thresholds = PROBABILITY_EDGES[:-1][::-1]
    return {
        "p": thresholds[at],
        "recall": recall[at],
        "precision": Ratio(found_of[:, at], called_of[:, at], counted=True),
    }


PR_AUC = ScoreDefinition(
    name="pr_auc",
    title="PR-AUC",
    position=20,
    outputs=(Output("area", "PR-AUC", better="higher", scale="odds", tested=True),),
    about="Average precision: precision weighted by the gain in recall, over the edges of the histogram of"
    " probabilities, in which 0, 0.5 and 1 are bins of their own. It needs no threshold. Forecasts that say 0 or 1 have"
    " one point of the curve, so a low area.",
    parts=lambda facts: (*block("cells", PROBABILITY_BINS), *block("occupied", PROBABILITY_BINS)),
    count=_count,
    value=_value,
    figure=_figure,
)

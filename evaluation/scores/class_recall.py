"""Recall of the cells of one class: the share of dynamic cells of, say, pedestrians that was called occupied."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gridtrack.evaluation.referee.referee import ScoredForecast
from gridtrack.evaluation.referee.strata import CELL_KINDS, OCCLUDED
from gridtrack.evaluation.referee.targets import SEEN_OCCUPIED
from gridtrack.evaluation.scores.definition import Floats, Output, Ratio, ScoreDefinition, Sums, TrialFacts

_STRATA = ("dynamic", OCCLUDED)
"""Of visible and of hidden cells the stratum that has their threshold."""
_DYNAMIC = CELL_KINDS.index("dynamic")


def class_strata(facts: TrialFacts) -> tuple[str, ...]:
    """The dynamic cells of each class, visible and with ground truth hidden: `dynamic car`, `occluded car`."""
    return tuple(f"{stratum} {name}" for stratum in _STRATA if stratum in facts.strata for name in facts.classes)


def _count(forecast: ScoredForecast, facts: TrialFacts, memory: None) -> Floats:
    """TP, FN, TP at 0.5 and FN at 0.5 (S, K, 4), cells."""
    targets = forecast.targets
    step = np.repeat(np.arange(len(targets)), [target.cells.size for target in targets])
    cells, labels = (np.concatenate([getattr(target, name) for target in targets]) for name in ("cells", "labels"))
    state = np.concatenate([target.state.reshape(-1)[target.cells] for target in targets])
    dynamic = forecast.region_maps.cell_kinds.reshape(-1)[cells] == _DYNAMIC
    step, cells, labels, hidden = step[dynamic], cells[dynamic], labels[dynamic], state[dynamic] != SEEN_OCCUPIED
    p = forecast.occupancy.reshape(len(targets), -1)[step, cells]
    columns = np.array([facts.strata.index(name) if name in facts.strata else 0 for name in _STRATA])
    thresholds = facts.thresholds.values.astype(np.float32)[step, columns[hidden.astype(np.int64)]]
    shape = len(targets), len(_STRATA), len(facts.classes), 4
    found = np.zeros(shape)
    for first, missed in ((0, p < thresholds), (2, p < np.float32(0.5))):
        place = np.ravel_multi_index((step, hidden, labels, first + missed), shape)
        found += np.bincount(place, minlength=found.size).reshape(shape)
    return found.reshape(len(targets), -1, 4)[:, : len(class_strata(facts))]


def _value(sums: Sums) -> Mapping[str, Ratio | Floats]:
    cells = sums["tp"] + sums["fn"]
    return {
        "recall": Ratio(sums["tp"], cells, counted=True),
        "at_half": Ratio(sums["tp half"], sums["tp half"] + sums["fn half"], counted=True),
        "cells": cells,
    }


CLASS_RECALL = ScoreDefinition(
    name="class_recall",
    title="Recall by class",
    position=110,
    outputs=(
        Output("recall", "Recall of the class", better="higher", scale="odds"),
        Output("at_half", "Recall of the class at 0.5", better="higher", scale="odds"),
        Output("cells", "Cells of the class", decimals=0),
    ),
    about="TP / (TP + FN) over the dynamic cells of one class, at the threshold of `dynamic` for visible cells and of"
    " `occluded` for hidden ones. False positives have no class, so there is no precision by class.",
    strata=class_strata,
    parts=lambda facts: ("tp", "fn", "tp half", "fn half"),
    count=_count,
    value=_value,
    needed="classes of the recording",
    thresholded=True,
)

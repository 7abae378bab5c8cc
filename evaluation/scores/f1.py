"""F1, precision and recall of cells called occupied: the score of the seed paper (Ondruska et al. 2016, section V)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.referee.referee import ScoredForecast
from gridtrack.evaluation.referee.strata import OCCLUDED
from gridtrack.evaluation.scores.cells import cells_of
from gridtrack.evaluation.scores.definition import (
    CurvesByStratum,
    Floats,
    Output,
    Ratio,
    ScoreDefinition,
    Sums,
    TrialFacts,
    divided,
)
from gridtrack.evaluation.scores.relations import share_of_oracle
from gridtrack.evaluation.scores.thresholds import LABEL_FREE, LabelFreeThresholds

COUNTS = ("tp", "fp", "fn", "tn")
THRESHOLDS = ("chosen", "half", "visible", "label-free")
"""The threshold of the step and stratum, 0.5, the threshold of all visible cells, and the threshold without labels."""
LEAST_F1_GAP = 0.01
"""No share is computed if the oracle's F1 is less than this above the best floor's: it would be noise."""


def _parts(facts: TrialFacts) -> tuple[str, ...]:
    return tuple(f"{count} {threshold}" for threshold in THRESHOLDS for count in COUNTS)


def _count(forecast: ScoredForecast, facts: TrialFacts, memory: LabelFreeThresholds) -> Floats:
    """TP, FP, FN and TN (S, K, 16), cells, at each of THRESHOLDS."""
    tally, label_free = forecast.once(cells_of), memory.bins(forecast.stamp_ns)
    chosen = label_free if facts.thresholds.chosen_on == LABEL_FREE else facts.thresholds.bins
    visible = chosen[:, [facts.strata.index("visible")]]
    bins = np.stack([chosen, memory.half, np.broadcast_to(visible, chosen.shape), label_free])
    memory.add(forecast.frames[-1].stamp_ns, tally)
    return np.concatenate(tally.confusion(bins), axis=-1, dtype=np.float64)


def _value(sums: Sums) -> Mapping[str, Ratio]:
    tp, fp, fn = (sums[f"{count} chosen"] for count in COUNTS[:3])
    others = {name: _f1(sums, threshold) for name, threshold in _AT_OTHER_THRESHOLDS.items()}
    return {
        "f1": _f1(sums, "chosen"),
        "precision": Ratio(tp, tp + fp, counted=True),
        "recall": Ratio(tp, tp + fn, counted=True),
        **others,
    }


_AT_OTHER_THRESHOLDS = {"at_half": "half", "at_visible": "visible", "label_free": "label-free"}


def _f1(sums: Sums, threshold: str) -> Ratio:
    """2 TP / (2 TP + FP + FN); undefined if no cell was occupied."""
    tp, fp, fn = (sums[f"{count} {threshold}"] for count in COUNTS[:3])
    return Ratio(2 * tp, 2 * tp + fp + fn, support=tp + fn, counted=True)


def f1_of(confusion: NDArray[np.integer]) -> Floats:
    """F1 (...) of TP, FP, FN, TN (..., 4)."""
    tp, fp, fn = (confusion[..., i] for i in range(3))
    return divided(2 * tp, 2 * tp + fp + fn, defined=tp + fn > 0)


def _relate(
    own: CurvesByStratum, floor: CurvesByStratum | None, oracle: CurvesByStratum | None
) -> dict[str, CurvesByStratum]:
    """The share of the way from the best floor to the oracle, and on hidden cells the gap to visible ones."""
    found: dict[str, CurvesByStratum] = {"oracle_share": share_of_oracle(own, floor, oracle, 1, LEAST_F1_GAP)}
    if OCCLUDED in own:
        found["truth_gap"] = {OCCLUDED: own["visible"] - own[OCCLUDED]}
    return found


F1 = ScoreDefinition(
    name="f1",
    title="F1",
    position=10,
    outputs=(
        Output("f1", "F1", better="higher", scale="odds", tested=True, margin=0.005),
        Output("precision", "Precision", scale="odds"),
        Output("recall", "Recall", scale="odds"),
        Output("at_half", "F1 at 0.5", better="higher", scale="odds", tested=True),
        Output("at_visible", "F1, threshold of visible cells", better="higher", scale="odds", tested=True),
        Output("label_free", "F1, label-free threshold", better="higher", scale="odds"),
        Output("oracle_share", "Share of the oracle, F1", better="higher"),
        Output("truth_gap", "F1 on visible less F1 on hidden cells"),
    ),
    about="2 TP / (2 TP + FP + FN) over cells, at the threshold of the step and stratum that was chosen on the"
    " validation stretch; undefined where no cell was occupied. It depends on the threshold, and counts a cell beside"
    " the right one as two errors. The share of the oracle is (F1 - floor) / (F1 of the oracle - floor), with the"
    " floor of the run that has the best headline score. Ondruska et al., 2016.",
    parts=_parts,
    count=_count,
    value=_value,
    new_memory=lambda facts: LabelFreeThresholds(facts.steps, facts.strata),
    relate=_relate,
    thresholded=True,
)

"""Scores by class of one or several trials: recall of the cells of each class, and of class probabilities."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import nearest_step
from gridtrack.evaluation.results.columns import CLASSES_TABLE
from gridtrack.evaluation.results.recording import RecordingDescription
from gridtrack.evaluation.results.trial_record import TrialRecord
from gridtrack.evaluation.results.trial_summary import (
    ClassRecall,
    ClassScores,
    ConfusionAtStep,
    RecallByClass,
    SemanticScores,
)
from gridtrack.evaluation.results.values import rounded_curve
from gridtrack.evaluation.scoring.class_store import SemanticsCounts, add_semantics, read_found, read_semantics
from gridtrack.evaluation.scoring.metrics import balanced_accuracy, ratio
from gridtrack.evaluation.scoring.semantics import VISIBILITIES

CONFUSION_HORIZONS_S = (0.0, 0.5, 1.0, 2.5)
"""Horizons of the confusion matrices, as far as a run forecasts; all other scores are of every step."""


@dataclass(frozen=True, slots=True)
class ScoresByClass:
    """Recall by class, and scores of class probabilities; None where there are none."""

    recall_by_class: RecallByClass | None = None
    semantics: SemanticScores | None = None


def class_scores(
    trials: Sequence[tuple[TrialRecord, Path, list[int]]], classes: Sequence[str], horizons_s: Sequence[float]
) -> ScoresByClass:
    """Scores by class of trials together, each at its steps; `classes` and `horizons_s` are those of all of them.

    Raises ScoresError.
    """
    scored = [one for one in trials if one[0].frames_scored and (one[1] / CLASSES_TABLE.file).exists()]
    if not classes or not scored:
        return ScoresByClass()
    found = np.sum([read_found(folder, record.steps, classes)[steps] for record, folder, steps in scored], axis=0)
    read = ((read_semantics(folder, record.steps, classes), steps) for record, folder, steps in scored)
    counts = [one.at(steps) for one, steps in read if one is not None]
    semantics = _semantics(add_semantics(counts), classes, horizons_s) if len(counts) == len(scored) else None
    return ScoresByClass(_recall(found, classes), semantics)


def unknown_classes(record: TrialRecord, recording: RecordingDescription) -> str:
    """A notice of the recording's classes that the tracker does not have; empty where there are none."""
    missing = [name for name in recording.classes if name not in record.classes]
    if not record.classes or not missing:
        return ""
    return (
        f"{record.label} does not forecast the classes {', '.join(missing)} of {record.recording}: their cells count as"
        " misclassified, with probability 0"
    )


def _recall(found: NDArray[np.int64], classes: Sequence[str]) -> RecallByClass:
    """Recall of the cells of each class at every step, of counts (S, visibility, K, 4)."""
    tp, fn, tp_half, fn_half = np.moveaxis(found, -1, 0)
    recall, recall_at_half, cells = ratio(tp, tp + fn), ratio(tp_half, tp_half + fn_half), tp + fn
    return {
        visibility: {
            name: ClassRecall(
                recall=rounded_curve(recall[:, i, k]),
                recall_at_half=rounded_curve(recall_at_half[:, i, k]),
                cells=tuple(cells[:, i, k].tolist()),
            )
            for k, name in enumerate(classes)
        }
        for i, visibility in enumerate(VISIBILITIES)
        if cells[:, i].any()
    }


def _semantics(counts: SemanticsCounts, classes: Sequence[str], horizons_s: Sequence[float]) -> SemanticScores:
    """Scores of every step, and the confusion matrices at the steps nearest to CONFUSION_HORIZONS_S."""
    cells = counts.confusion.sum(axis=(-2, -1))
    per_cell, per_scan = ratio(counts.log_loss, cells), ratio(counts.scan_log_loss, counts.scans)
    accuracy = balanced_accuracy(counts.confusion)
    period_s = horizons_s[1] if len(horizons_s) > 1 else np.inf
    nearest = dict.fromkeys(nearest_step(horizon_s, period_s) for horizon_s in CONFUSION_HORIZONS_S)
    steps = [step for step in nearest if step < len(horizons_s)]
    kinds = {
        visibility: ClassScores(
            nll_per_scan=rounded_curve(per_scan[:, i]),
            nll_summed_over_scans=rounded_curve(counts.scan_log_loss[:, i]),
            nll_per_cell=rounded_curve(per_cell[:, i]),
            balanced_accuracy=rounded_curve(accuracy[:, i]),
            cells=tuple(cells[:, i].tolist()),
            scans=tuple(counts.scans[:, i].tolist()),
            confusion=tuple(ConfusionAtStep(step=step, cells=counts.confusion[step, i].tolist()) for step in steps),
        )
        for i, visibility in enumerate(VISIBILITIES)
        if cells[:, i].any()
    }
    return SemanticScores(classes=tuple(classes), kinds=kinds)

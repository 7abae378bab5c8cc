"""Class scores of the summary: recall of occupancy by class, and classification of occupied cells."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.scoring.class_store import CLASSES, SemanticsCounts, pooled, read_found, read_semantics
from gridtrack.evaluation.scoring.metrics import Scores, balanced_accuracy, ratio
from gridtrack.evaluation.scoring.record import TrialRecord
from gridtrack.evaluation.scoring.semantics import VISIBILITIES

HEADLINE_S = (0.0, 0.5, 1.0, 2.5)
"""Horizons of the confusion matrices in the summary, as far as the run forecasts; other scores cover every step."""


def class_scores(
    trials: Sequence[tuple[TrialRecord, Path]], classes: Sequence[str], horizons_s: Sequence[float]
) -> dict[str, Any]:
    """`recall_by_class` and `semantics` of trials together, each None where there are no counts.

    `classes` and `horizons_s` are those of their recordings. Raises ScoresError.
    """
    scored = [(record, folder) for record, folder in trials if record.frames_scored and (folder / CLASSES).exists()]
    if not classes or not scored:
        return {"recall_by_class": None, "semantics": None}
    found = np.sum([read_found(folder, record.steps, classes) for record, folder in scored], axis=0)
    counts = [c for record, folder in scored if (c := read_semantics(folder, record.steps, classes)) is not None]
    return {
        "recall_by_class": _recall(found, classes),
        "semantics": _semantics(pooled(counts), classes, horizons_s) if len(counts) == len(scored) else None,
    }


def unknown_classes(record: TrialRecord, recording: Mapping[str, Any]) -> str:
    """A notice of the recording's classes that a tracker with classes lacks; empty where there are none."""
    missing = [name for name in recording.get("classes", ()) if name not in record.classes]
    if not record.classes or not missing:
        return ""
    return (
        f"{record.label} does not forecast the classes {', '.join(missing)} of {record.recording}: their cells count as"
        " misclassified, with probability 0"
    )


def _recall(found: NDArray[np.int64], classes: Sequence[str]) -> dict[str, dict[str, Any]]:
    """By visibility and class: recall at every step, and the number of cells."""
    tp, fn, tp_half, fn_half = np.moveaxis(found, -1, 0)
    recall, recall_at_half, cells = ratio(tp, tp + fn), ratio(tp_half, tp_half + fn_half), tp + fn
    return {
        visibility: {
            name: {
                "recall": _curve(recall[:, i, k]),
                "recall_at_half": _curve(recall_at_half[:, i, k]),
                "cells": cells[:, i, k].tolist(),
            }
            for k, name in enumerate(classes)
        }
        for i, visibility in enumerate(VISIBILITIES)
        if cells[:, i].any()
    }


def _semantics(counts: SemanticsCounts, classes: Sequence[str], horizons_s: Sequence[float]) -> dict[str, Any]:
    """By visibility: the scores of every step, and the confusion matrices at HEADLINE_S."""
    cells = counts.confusion.sum(axis=(-2, -1))
    per_cell, per_scan = ratio(counts.log_loss, cells), ratio(counts.scan_log_loss, counts.scans)
    accuracy = balanced_accuracy(counts.confusion)
    steps = [horizons_s.index(horizon) for horizon in HEADLINE_S if horizon in horizons_s]
    kinds = {
        visibility: {
            "nll_per_scan": _curve(per_scan[:, i]),
            "nll_summed_over_scans": _curve(counts.scan_log_loss[:, i]),
            "nll_per_cell": _curve(per_cell[:, i]),
            "balanced_accuracy": _curve(accuracy[:, i]),
            "cells": cells[:, i].tolist(),
            "scans": counts.scans[:, i].tolist(),
            "confusion": [{"step": step, "cells": counts.confusion[step, i].tolist()} for step in steps],
        }
        for i, visibility in enumerate(VISIBILITIES)
        if cells[:, i].any()
    }
    return {"classes": list(classes), "kinds": kinds}


def _curve(values: Scores) -> list[float | None]:
    return [None if math.isnan(value) else round(value, 6) for value in values.tolist()]

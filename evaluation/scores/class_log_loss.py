"""Log loss and confusion of class probabilities, on occupied cells with a known class (Ondruska et al. 2016)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.referee.referee import ScoredForecast
from gridtrack.evaluation.referee.strata import OCCLUDED
from gridtrack.evaluation.referee.targets import SEEN_OCCUPIED, Target
from gridtrack.evaluation.scores.cells import CLIP
from gridtrack.evaluation.scores.definition import Floats, Output, Ratio, ScoreDefinition, Sums, TrialFacts, divided

VISIBILITIES = ("visible", OCCLUDED)
"""Visibility of a labelled cell: a labelled beam ends in it; or, with truth, a hidden outline passes through it."""


@dataclass(frozen=True, slots=True)
class Matching:
    """Classes of a tracker (T) and of a recording (K), matched by name.

    `column` (T,) int64: index of each tracker class in the recording's classes, K where the recording lacks it; `row`
    (K,) int64: index of each recording class in the tracker's classes, -1 where the tracker lacks it.
    """

    column: NDArray[np.int64]
    row: NDArray[np.int64]


def match_classes(trackers: Sequence[str], recordings: Sequence[str]) -> Matching:
    """Match a tracker's classes with a recording's."""
    column = [recordings.index(name) if name in recordings else len(recordings) for name in trackers]
    row = [trackers.index(name) if name in trackers else -1 for name in recordings]
    return Matching(np.array(column, np.int64), np.array(row, np.int64))


def _strata(facts: TrialFacts) -> tuple[str, ...]:
    """Of a tracker with classes: visible cells, and with ground truth hidden ones."""
    known = bool(facts.classes and facts.tracker_classes)
    return tuple(name for name in VISIBILITIES if known and name in facts.strata)


def _parts(facts: TrialFacts) -> tuple[str, ...]:
    """Loss, loss per scan and scans, and the cells of each true and most probable class."""
    predicted = (*facts.classes, OTHER_CLASS)
    return (*_LOSSES, *(f"{true} as {other}" for true in facts.classes for other in predicted))


_LOSSES = ("loss", "loss per scan", "scans")
OTHER_CLASS = "another class"
"""Column of the confusion matrix for classes that the recording does not have."""


def _count(forecast: ScoredForecast, facts: TrialFacts, matching: Matching) -> Floats | None:
    """Sums (S, K, P) of one scan: P as of `_parts`."""
    semantics = forecast.forecast.semantics
    if semantics is None:
        return None
    confusion, losses = count_classes(semantics, forecast.targets, matching)
    cells, loss = confusion.sum(axis=(-2, -1)), losses.sum(axis=(-2, -1))
    sums = [loss, np.nan_to_num(divided(loss, cells)), (cells > 0).astype(np.float64)]
    found = np.concatenate([np.stack(sums, axis=-1), confusion.reshape(*cells.shape, -1)], axis=-1)
    return found[:, : len(_strata(facts))]


def count_classes(
    semantics: NDArray[np.float32], targets: Sequence[Target], matching: Matching
) -> tuple[NDArray[np.int32], Floats]:
    """Confusion counts and log loss (S, visibility, K, K+1) of one forecast, on the cells with a known class.

    `semantics` (S, T, M, M) float32. Rows are true classes, columns the most probable ones; the last column is for
    classes that the recording lacks. The log loss, in nats, is summed over the cells of each entry; a class that the
    tracker lacks has probability 0, clipped like all others.
    """
    classes = matching.row.size
    shape = (len(targets), len(VISIBILITIES), classes, classes + 1)
    confusion, log_loss = np.zeros(shape, np.int32), np.zeros(shape)
    for n, target in enumerate(targets):
        p, state = semantics[n].reshape(semantics.shape[1], -1), target.state.reshape(-1)
        _count_classes(p, state, target.cells, target.labels, matching.column, matching.row, confusion[n], log_loss[n])
    return confusion, log_loss


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _count_classes(semantics, state, cells, labels, column, row, confusion, log_loss):  # type: ignore[no-untyped-def]
    """Add one step's labelled cells (N,) to `confusion` and `log_loss` (visibility, K, K+1); `semantics` (T, M*M)."""
    for i in range(cells.size):
        cell, label = cells[i], labels[i]
        visibility = 0 if state[cell] == SEEN_OCCUPIED else 1
        best = 0
        for k in range(1, column.size):
            if semantics[k, cell] > semantics[best, cell]:
                best = k
        p = float(semantics[row[label], cell]) if row[label] >= 0 else 0.0
        confusion[visibility, label, column[best]] += 1
        log_loss[visibility, label, column[best]] -= math.log(min(max(p, CLIP), 1.0 - CLIP))


def confusion_of(sums: Sums) -> Floats:
    """The confusion matrix (..., K, K+1) of sums (..., P): true by most probable class."""
    entries = sums.values[..., len(_LOSSES) :]
    classes = math.isqrt(entries.shape[-1])  # K of K * (K + 1) entries
    return entries.reshape(*entries.shape[:-1], classes, classes + 1)


def balanced_accuracy(confusion: Floats) -> Floats:
    """Mean recall of the classes that occur (...), of confusion counts (..., K, K+1)."""
    correct = np.diagonal(confusion, axis1=-2, axis2=-1)
    recalls = divided(correct, confusion.sum(axis=-1))
    occur = ~np.isnan(recalls)
    return divided(np.where(occur, recalls, 0.0).sum(axis=-1), occur.sum(axis=-1))


def _value(sums: Sums) -> Mapping[str, Ratio | Floats]:
    confusion = confusion_of(sums)
    cells = confusion.sum(axis=(-2, -1))
    return {
        "per_scan": Ratio(sums["loss per scan"], sums["scans"]),
        "summed_over_scans": np.where(sums["scans"] > 0, sums["loss per scan"], np.nan),
        "per_cell": divided(sums["loss"], cells),
        "balanced_accuracy": balanced_accuracy(confusion),
        "cells": cells,
        "scans": sums["scans"],
    }


def _figure(sums: Sums) -> dict[str, Floats | Ratio]:
    """The confusion matrix (K, K+1) of sums (U, P), if any cell was counted."""
    confusion = confusion_of(sums).sum(axis=0)
    return {"confusion": confusion} if confusion.any() else {}


CLASS_LOG_LOSS = ScoreDefinition(
    name="class_log_loss",
    title="Class log loss",
    position=120,
    outputs=(
        Output(
            "per_scan",
            "Class log loss",
            unit="nats a scan",
            better="lower",
            scale="log",
            tested=True,
            margin=0.05,
            relative_margin=True,
        ),
        Output("summed_over_scans", "Class log loss, summed over scans", unit="nats", better="lower"),
        Output("per_cell", "Class log loss", unit="nats a cell", better="lower"),
        Output("balanced_accuracy", "Balanced accuracy", better="higher"),
        Output("cells", "Labelled cells", decimals=0),
        Output("scans", "Labelled scans", decimals=0),
    ),
    about="Mean over scans of the mean of -log P(class) over the scan's labelled occupied cells, with probabilities"
    " clipped to [0.001, 0.999]. A class that the tracker does not have gets probability 0 before that. Balanced"
    " accuracy is the mean recall of the classes that occur. Ondruska et al., 2016.",
    strata=_strata,
    parts=_parts,
    count=_count,
    value=_value,
    new_memory=lambda facts: match_classes(facts.tracker_classes, facts.classes),
    figure=_figure,
    needed="classes of the recording and of the tracker",
    compared_with="classes",
)

"""Counts of classes: the forecast class of occupied cells, and the recall of occupancy by class."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.scoring.counting import CLIP
from gridtrack.evaluation.scoring.strata import CELL_KINDS
from gridtrack.evaluation.scoring.target import SEEN_OCCUPIED, Target
from gridtrack.evaluation.scoring.thresholds import Thresholds

VISIBILITIES = ("visible", "occluded")
"""Visibility of a labelled cell: a labelled beam ends in it; or, with truth, a hidden outline passes through it."""
_THRESHOLD_STRATA = ("dynamic", "occluded")
"""By visibility the stratum whose threshold decides whether a cell is found."""
_DYNAMIC = CELL_KINDS.index("dynamic")


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


def count_classes(
    semantics: NDArray[np.float32], targets: Sequence[Target], matching: Matching
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Confusion counts and log loss (S, visibility, K, K+1) of one forecast, on the cells whose class is known.

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


def count_found(
    occupancy: NDArray[np.float32],
    targets: Sequence[Target],
    cell_kinds: NDArray[np.uint8],
    thresholds: Thresholds,
    classes: int,
) -> NDArray[np.int32]:
    """TP, FN, TP at 0.5 and FN at 0.5 (S, visibility, K, 4) of one forecast, by true class, in `dynamic` cells.

    `occupancy` (S, M, M) float32; `cell_kinds` (M, M) uint8. Visible cells are called occupied at the threshold
    of the stratum `dynamic`, hidden cells at that of `occluded`.
    """
    found = np.zeros((len(targets), len(VISIBILITIES), classes, 4), np.int32)
    values = thresholds.values.astype(np.float32)
    columns = [thresholds.strata.index(name) if name in thresholds.strata else 0 for name in _THRESHOLD_STRATA]
    for n, target in enumerate(targets):
        cells = cell_kinds.reshape(-1)[target.cells] == _DYNAMIC
        p, labels = occupancy[n].reshape(-1)[target.cells[cells]], target.labels[cells]
        visibility = (target.state.reshape(-1)[target.cells[cells]] != SEEN_OCCUPIED).astype(np.int64)
        threshold = values[n, columns][visibility]
        missed = np.stack([p < threshold, p < np.float32(0.5)], axis=1)
        for i in range(2):
            np.add.at(found[n], (visibility, labels, 2 * i + missed[:, i].astype(np.int64)), 1)
    return found


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

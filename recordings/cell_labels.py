"""The class of each occupied cell, from the labels of the beams that end in it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.errors import RecordingError
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridSpec
from gridtrack.common.raycast import end_cells
from gridtrack.common.scan import Scan
from gridtrack.common.scene import UNLABELLED


def labelled_returns(
    scans: Sequence[Scan], grid_T_sensor: Sequence[SE2], grid: GridSpec
) -> tuple[NDArray[np.int64], NDArray[np.uint8]]:
    """Cells (N,), row * M + column, and labels (N,) of the labelled returns: the most frequent label of each cell.

    Of equally frequent labels the lowest; cells whose most frequent label is UNLABELLED are left out.
    """
    votes = [
        end_cells(scan, grid, pose) * (UNLABELLED + 1) + scan.labels
        for scan, pose in zip(scans, grid_T_sensor, strict=True)
        if scan.labels is not None and scan.labels.min(initial=UNLABELLED) < UNLABELLED
    ]
    if not votes:
        return np.zeros(0, np.int64), np.zeros(0, np.uint8)
    pairs, count = np.unique(np.concatenate(votes), return_counts=True)
    pairs, count = pairs[pairs >= 0], count[pairs >= 0]
    cells, labels = np.divmod(pairs, UNLABELLED + 1)
    order = np.lexsort((labels, -count, cells))
    winners = order[np.flatnonzero(np.diff(cells[order], prepend=-1))]
    winners = winners[labels[winners] != UNLABELLED]
    return cells[winners], labels[winners].astype(np.uint8)


def check_labels(labels: NDArray[np.uint8], classes: Sequence[str], time_s: float) -> None:
    """Raise RecordingError for a label, `time_s` after the first scan, that is not an index into `classes`."""
    if labels.size and labels.max() >= len(classes):
        raise RecordingError(
            f"a label names class {labels.max()} at {time_s:.3f} s, and the recording has"
            f" {len(classes)} classes: it is damaged"
        )

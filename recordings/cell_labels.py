"""The class of each occupied cell, where the beams that end in it are labelled."""

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
    """Cells (N,) and labels (N,) of the returns: the label of most beams that end in a cell, the lowest of equals."""
    votes = [
        end_cells(scan, grid, pose) * (UNLABELLED + 1) + scan.labels
        for scan, pose in zip(scans, grid_T_sensor, strict=True)
        if scan.labels is not None and scan.labels.min(initial=UNLABELLED) < UNLABELLED
    ]
    if not votes:
        return np.zeros(0, np.int64), np.zeros(0, np.uint8)
    ballots, count = np.unique(np.concatenate(votes), return_counts=True)
    ballots, count = ballots[ballots >= 0], count[ballots >= 0]
    cells, labels = np.divmod(ballots, UNLABELLED + 1)
    order = np.lexsort((labels, -count, cells))
    winners = order[np.flatnonzero(np.diff(cells[order], prepend=-1))]
    winners = winners[labels[winners] != UNLABELLED]
    return cells[winners], labels[winners].astype(np.uint8)


def check_labels(labels: NDArray[np.uint8], classes: Sequence[str], stamp_ns: int) -> None:
    """Raises RecordingError for a label that is none of `classes`."""
    if labels.size and labels.max() >= len(classes):
        raise RecordingError(
            f"a label names class {labels.max()} at {stamp_ns / 1e9:.3f} s, and the recording has"
            f" {len(classes)} classes: it is damaged"
        )

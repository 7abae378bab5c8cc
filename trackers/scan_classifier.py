"""The classifier of single scans: its planes, its shape and its labelled cells."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import torch
from torch import Tensor

from gridtrack.common.grid import GridFrame, LabelledFrame
from gridtrack.trackers.cell_classifier import CellClassifier
from gridtrack.trackers.cell_training import CellCollector, LabelledCells

PLANES = 2
"""Visible and occupied."""
LAYERS = 3


def scan_classifier(channels: int, classes: int) -> CellClassifier:
    """An untrained classifier of the 15 x 15 cells around a cell, as the baseline of Ondruska et al. (2016)."""
    return CellClassifier(PLANES, (channels,) * (LAYERS - 1), classes)


def planes_of(frame: GridFrame) -> Tensor:
    """Visible and occupied as one array (2, M, M) uint8."""
    return torch.from_numpy(np.stack([frame.visible, frame.occupied]).astype(np.uint8))


def scan_cells(
    labelled: Iterable[tuple[Sequence[str], Iterable[LabelledFrame]]], classes: Sequence[str]
) -> LabelledCells:
    """The planes of frames and their cells of one of `classes`; `labelled`: pairs of class names and frames."""
    collector = CellCollector(classes)
    for names, frames in labelled:
        for item in frames:
            collector.add(planes_of(item.frame), item, names)
    return collector.cells()

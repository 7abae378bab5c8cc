"""The classifier of single scans: its planes, its shape and its labelled cells."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import torch
from torch import Tensor

from gridtrack.common.grid import GridFrame, LabelledFrame
from gridtrack.trackers.cell_classifier import CellClassifier
from gridtrack.trackers.cell_training import CellCollector, LabelledCells
from gridtrack.trackers.contract import FrameSource
from gridtrack.trackers.resolution import cell_input

LAYERS = 3


def scan_classifier(channels: int, classes: int, *, general: bool = False) -> CellClassifier:
    """An untrained classifier of the 15 x 15 cells around a cell, as the baseline of Ondruska et al. (2016).

    Its planes are those of `planes_of`, for `general` weights with the cell size.
    """
    return CellClassifier(3 if general else 2, (channels,) * (LAYERS - 1), classes)


def planes_of(frame: GridFrame, cell_m: float | None = None) -> Tensor:
    """Visible and occupied as one array (2, M, M) uint8; with `cell_m` (3, M, M) float16, the last its logarithm."""
    planes = torch.from_numpy(np.stack([frame.visible, frame.occupied]).astype(np.uint8))
    if cell_m is None:
        return planes
    return torch.cat([planes.half(), torch.full((1, *planes.shape[1:]), cell_input(cell_m), dtype=torch.float16)])


def scan_cells(
    labelled: Iterable[tuple[FrameSource, Iterable[LabelledFrame]]], classes: Sequence[str], *, general: bool = False
) -> LabelledCells:
    """The planes of frames and their cells of one of `classes`; `labelled`: pairs of sources and frames of them."""
    collector = CellCollector(classes)
    for source, frames in labelled:
        for item in frames:
            collector.add(planes_of(item.frame, source.grid.cell_m if general else None), item, source.classes)
    return collector.cells()

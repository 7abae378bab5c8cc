"""Cells that something entered, in the windows of a training: found from the frames alone, as `fit` has no truth.

Windows are (B, T, 2, M, M) bool, visible and occupied. What stands for most of a window, and the cells round it, in
which range noise comes and goes, is left out.
"""

from __future__ import annotations

import torch
from torch import Tensor

LOOKBACK_STEPS = 10
"""A cell was entered that was free, with its neighbours, so many steps before."""
NEAR_CELLS = 4
"""Greatest distance in rows and in columns from an entered cell to one near it."""
STANDING_SHARE = 0.3
"""Of the frames that see a cell, the share above which it is occupied by what stands."""


def entered_cells(windows: Tensor) -> Tensor:
    """Cells (B, T, M, M) bool that something entered within LOOKBACK_STEPS; none in the first of these steps."""
    return _entered(windows, _standing(windows))


def near_entered_cells(windows: Tensor) -> Tensor:
    """Cells (B, T, M, M) bool at most NEAR_CELLS from one that was entered, in the same frame."""
    standing = _standing(windows)
    return _widened(_entered(windows, standing), NEAR_CELLS) & ~standing


def _entered(windows: Tensor, standing: Tensor) -> Tensor:
    visible, occupied = windows.unbind(dim=2)
    entered = torch.zeros_like(occupied)
    if windows.shape[1] > LOOKBACK_STEPS:
        free_before = visible[:, :-LOOKBACK_STEPS] & ~_widened(occupied[:, :-LOOKBACK_STEPS], 1)
        entered[:, LOOKBACK_STEPS:] = occupied[:, LOOKBACK_STEPS:] & free_before
    return entered & ~standing


def _standing(windows: Tensor) -> Tensor:
    """Cells (B, 1, M, M) bool of what stands, and those round them."""
    seen, filled = windows.view(torch.uint8).sum(dim=1, dtype=torch.int32).unbind(dim=1)
    return _widened((filled > STANDING_SHARE * seen)[:, None], 1)


def _widened(cells: Tensor, by: int) -> Tensor:
    """`cells` (B, T, M, M) bool and all that are at most `by` rows and columns away."""
    for axis in (-2, -1):
        wide, size = cells.clone(), cells.shape[axis]
        for shift in range(1, min(by, size - 1) + 1):
            wide.narrow(axis, shift, size - shift).logical_or_(cells.narrow(axis, 0, size - shift))
            wide.narrow(axis, 0, size - shift).logical_or_(cells.narrow(axis, shift, size - shift))
        cells = wide
    return cells

"""Where something arrives, in the windows of a training: found from the frames alone, as `fit` has no truth.

Windows are (B, T, 2, M, M) bool, visible and occupied. What stands for most of a window, and the cells round it, in
which range noise comes and goes, is left out.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import max_pool2d

LOOKBACK_STEPS = 10
"""Something arrived in a cell that was free, with its neighbours, so many steps before."""
NEAR_CELLS = 4
"""Greatest distance in rows and in columns from an arrival to a cell near it."""
STANDING_SHARE = 0.3
"""Of the frames that see a cell, the share above which it is occupied by what stands."""


def arrivals(windows: Tensor) -> Tensor:
    """Cells (B, T, M, M) bool in which something arrived within LOOKBACK_STEPS; none in the first of these steps."""
    visible, occupied = windows.unbind(dim=2)
    arrived = torch.zeros_like(occupied)
    if windows.shape[1] <= LOOKBACK_STEPS:
        return arrived
    free_before = visible[:, :-LOOKBACK_STEPS] & ~_widened(occupied[:, :-LOOKBACK_STEPS], 1)
    arrived[:, LOOKBACK_STEPS:] = occupied[:, LOOKBACK_STEPS:] & free_before
    return arrived & ~_standing(windows)[:, None]


def near_arrivals(windows: Tensor) -> Tensor:
    """Cells (B, T, M, M) bool at most NEAR_CELLS from an arrival of the same frame."""
    return _widened(arrivals(windows), NEAR_CELLS) & ~_standing(windows)[:, None]


def _standing(windows: Tensor) -> Tensor:
    """Cells (B, M, M) bool of what stands, and those round them."""
    visible, occupied = windows.unbind(dim=2)
    return _widened((occupied.sum(dim=1) > STANDING_SHARE * visible.sum(dim=1))[:, None], 1)[:, 0]


def _widened(cells: Tensor, by: int) -> Tensor:
    """`cells` (B, T, M, M) bool and all that are at most `by` rows and columns away."""
    return max_pool2d(cells.float(), 2 * by + 1, stride=1, padding=by) > 0

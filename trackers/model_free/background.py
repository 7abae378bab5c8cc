"""The static background: how often each cell was occupied while it was visible, and what that explains."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import GridFrame, Mask

PRIOR_FRAMES = 20.0
"""Weight of the base rate against a cell's own record, in frames."""


def fit_background(frames: Iterable[GridFrame], shape: tuple[int, int]) -> NDArray[np.float32]:
    """P(occupied | visible) of each cell, (M, M) float32, over the given frames.

    The posterior mean under a Beta prior worth PRIOR_FRAMES frames whose mean is the base rate, the occupied share
    of all visible cells: a cell never seen, or never seen occupied, keeps a small probability and not zero.
    """
    visible, occupied = np.zeros(shape), np.zeros(shape)
    for frame in frames:
        visible += frame.visible
        occupied += frame.occupied
    base_rate = occupied.sum() / max(visible.sum(), 1.0)
    return np.asarray((occupied + PRIOR_FRAMES * base_rate) / (visible + PRIOR_FRAMES), np.float32)


def explained_cells(background: NDArray[np.float32], above: float) -> Mask:
    """The cells (M, M) whose returns the background explains: often occupied themselves, or beside one that is.

    The neighbours belong to it because range noise moves returns from a wall by a cell.
    """
    wall = np.pad(background >= above, 1)
    size = background.shape[0]
    explained = np.zeros_like(background, dtype=bool)
    for row in range(3):
        for column in range(3):
            explained |= wall[row : row + size, column : column + size]
    return explained


def without_foreseen(
    background: NDArray[np.float32], wall_above: float, unforeseen_share: float
) -> NDArray[np.float32]:
    """The background (M, M) as the forecast needs it: walls as they are, and of the traffic through open cells only
    the share that no track announces, since what is tracked is forecast by its track.
    """
    return np.where(background >= wall_above, background, background * np.float32(unforeseen_share))

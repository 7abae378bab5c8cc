"""The static background: how often each cell was occupied while it was visible, what that explains, and forecasts."""

from __future__ import annotations

import math
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


class Background:
    """The fitted background as it is held now: what has come to stand sinks into it, and what has left leaves it.

    `fitted` (M, M) float32. The record of each cell goes on from the fitted one, worth PRIOR_FRAMES frames, and forgets
    with the time constant `sink_s` while the cell is visible.

    An open cell that no track announces is a Markov chain of two states, whose stationary rate is the fitted one. Seen
    empty, it holds the share `unforeseen_share` of that rate at once and comes back to all of it with the time constant
    `return_s`: ahead in time, and while it is hidden.
    """

    def __init__(
        self,
        fitted: NDArray[np.float32],
        period_s: float,
        explained_above: float,
        unforeseen_share: float,
        return_s: float,
        sink_above: float,
        sink_s: float,
    ) -> None:
        self.fitted, self.sink_above = fitted, sink_above
        self.explained = explained_cells(fitted, explained_above)
        """The cells (M, M) whose returns are no object's."""
        self._wall = fitted >= explained_above
        self._step = np.float32(math.exp(-period_s / return_s))
        self._announced = np.float32(1.0 - unforeseen_share)
        self._known = np.zeros_like(fitted)
        self._keep = np.float32(math.exp(-period_s / sink_s))
        self._visible, self._occupied = np.zeros_like(fitted), np.zeros_like(fitted)

    def observe(self, frame: GridFrame) -> None:
        """Take in a frame."""
        keep = np.where(frame.visible, self._keep, np.float32(1.0))
        self._visible = self._visible * keep + frame.visible
        self._occupied = self._occupied * keep + frame.occupied
        self._known = np.where(frame.visible, self._announced, self._known * self._step)

    def probabilities(self, steps: int) -> NDArray[np.float32]:
        """P(occupied) (steps+1, M, M) float32 of what no track announces, at steps 0..steps.

        Walls, and cells occupied in more than the share `sink_above` of late, are map and forecast by their record.
        """
        record = (self.fitted * np.float32(PRIOR_FRAMES) + self._occupied) / (PRIOR_FRAMES + self._visible)
        ahead = self._step ** np.arange(steps + 1, dtype=np.float32)
        traffic = self.fitted * (np.float32(1.0) - self._known * ahead[:, None, None])
        return np.where(self._wall | (record > self.sink_above), record, traffic).astype(np.float32)

"""The static background: how often each cell was occupied while it was visible, what that explains, and forecasts."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import GridFrame, Mask, with_neighbours
from gridtrack.trackers.model_free.settings import PipelineSettings
from gridtrack.trackers.site_rate import posterior_rate

GONE_SHARE = 0.1
"""What had stopped has left when this share of its cells, and all beside them, are seen empty."""


class BackgroundMap(NamedTuple):
    """What was counted at a place, each (M, M) float32."""

    rate: NDArray[np.float32]
    """P(occupied | visible) of each cell."""
    solid: NDArray[np.float32]
    """P(it or one of its eight neighbours is occupied | visible): next to 1 where a wall stands, and nowhere else.

    A place where vehicles queue may be occupied as often as the edge of a wall, over which range noise moves returns by
    a cell; but it is seen empty now and then, together with all that is about it.
    """


def fit_background(frames: Iterable[GridFrame], shape: tuple[int, int]) -> BackgroundMap:
    """The map over the given frames.

    Each is a posterior mean (`posterior_rate`).
    """
    visible, occupied, about = np.zeros((3, *shape))
    for frame in frames:
        visible += frame.visible
        occupied += frame.occupied
        about += frame.visible & with_neighbours(frame.occupied)
    return BackgroundMap(posterior_rate(occupied, visible), posterior_rate(about, visible))


def unknown_place(fitted: BackgroundMap) -> BackgroundMap:
    """The map of a place of which only the middle one of the fitted rates is known: no cell differs from another."""
    return BackgroundMap(np.full_like(fitted.rate, np.median(fitted.rate)), np.zeros_like(fitted.solid))


class Background:
    """The fitted background as it is held now: what has come to stand sinks into it, and what has left leaves it.

    Returns in cells that `fitted` holds solid in more than the share `explained_above` of the frames are no object's,
    nor are those in cells that a track was merged into, until it is seen to leave. The record of each cell goes on
    from the fitted rate, worth `map_s` of its own, and forgets with the time constant `sink_s` while it is visible; a
    frame stands for the time since the one before.

    An open cell that no track announces is a Markov chain of two states, whose stationary rate is the fitted one. Seen
    empty, it holds the share `unforeseen_share` of that rate at once and comes back to all of it with the time constant
    `return_s`: ahead in time, and while it is hidden: `hidden_s` (M, M) is how long ago each cell was seen, at first
    infinitely long.
    """

    def __init__(self, fitted: BackgroundMap, period_s: float, settings: PipelineSettings) -> None:
        self.rate, self.settings, self.period_s = fitted.rate, settings, period_s
        self.hidden_s = np.full_like(fitted.rate, np.inf)
        self._walls: Mask = fitted.solid >= settings.explained_above
        self._stopped: list[Mask] = []
        self._fitted_frames = np.float32(settings.map_s / period_s)
        self._visible, self._occupied = np.zeros_like(fitted.rate), np.zeros_like(fitted.rate)

    @property
    def explained(self) -> Mask:
        """The cells (M, M) whose returns are no object's."""
        return np.asarray(np.logical_or.reduce([self._walls, *map(with_neighbours, self._stopped)]))

    def observe(self, frame: GridFrame, periods: int = 1) -> None:
        """Take in a frame, so many periods after the one before."""
        lost = -math.expm1(-self.period_s / self.settings.sink_s)
        kept = (1.0 - lost) ** periods
        keep, counts = np.where(frame.visible, np.float32(kept), np.float32(1.0)), np.float32((1.0 - kept) / lost)
        self._visible = self._visible * keep + counts * frame.visible.astype(np.float32)
        self._occupied = self._occupied * keep + counts * frame.occupied.astype(np.float32)
        self.hidden_s = np.where(frame.visible, np.float32(0.0), self.hidden_s + np.float32(periods * self.period_s))
        empty = frame.visible & ~with_neighbours(frame.occupied)
        self._stopped = [cells for cells in self._stopped if empty[cells].mean() < GONE_SHARE]

    def take_in(self, cells: Mask) -> None:
        """Hold the returns in these cells (M, M) and beside them to be background from now on."""
        self._stopped.append(cells)

    def probabilities(self, steps: int) -> NDArray[np.float32]:
        """P(occupied) (steps+1, M, M) float32 of what no track announces, at steps 0..steps.

        Walls, and cells occupied in more than the share `sink_above` of late, are map and forecast by their record.
        """
        fitted = self._fitted_frames
        record = (self.rate * fitted + self._occupied) / (fitted + self._visible)
        recorded = self.explained | (record > self.settings.sink_above)
        return_s, announced = np.float32(self.settings.return_s), np.float32(1.0 - self.settings.unforeseen_share)
        settled, known = np.where(recorded, record, self.rate), announced * np.exp(-self.hidden_s / return_s)
        known[recorded] = 0.0
        left = np.exp(-np.arange(steps + 1, dtype=np.float32) * np.float32(self.period_s) / return_s)
        probabilities = np.multiply.outer(-left, settled * known)
        probabilities += settled
        return np.asarray(probabilities)

"""The static background: occupancy rates counted at the site, the cells they explain, and the background forecast."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import GridFrame, Mask, with_neighbours
from gridtrack.trackers.model_free.settings import PipelineSettings
from gridtrack.trackers.site_rate import posterior_rate

DEPARTED_SHARE = 0.1
"""A merged object has departed when this share of its cells is seen empty, together with all their neighbours."""


class BackgroundMap(NamedTuple):
    """Rates counted at a site, each (M, M) float32."""

    occupancy_rate: NDArray[np.float32]
    """P(occupied | visible) of each cell."""
    neighbourhood_rate: NDArray[np.float32]
    """P(the cell or one of its eight neighbours is occupied | visible): near 1 at walls only.

    Where vehicles queue a cell may be occupied as often as at the edge of a wall, where range noise moves returns by a
    cell. But where vehicles queue, a cell and all its neighbours are at times seen empty together.
    """


def fit_background(frames: Iterable[GridFrame], shape: tuple[int, int]) -> BackgroundMap:
    """The map (`shape` is (M, M)) of the given frames; each rate is a posterior mean (`posterior_rate`)."""
    visible, occupied, neighbourhood = np.zeros((3, *shape))
    for frame in frames:
        visible += frame.visible
        occupied += frame.occupied
        neighbourhood += frame.visible & with_neighbours(frame.occupied)
    return BackgroundMap(posterior_rate(occupied, visible), posterior_rate(neighbourhood, visible))


def uninformed_map(fitted: BackgroundMap) -> BackgroundMap:
    """The map for a start without site memory: the median of the fitted rates in every cell, and no walls."""
    median = np.full_like(fitted.occupancy_rate, np.median(fitted.occupancy_rate))
    return BackgroundMap(median, np.zeros_like(fitted.neighbourhood_rate))


class Background:
    """The fitted background, adapted online: stopped objects are added to it and departed ones removed.

    Returns are background in cells whose fitted `neighbourhood_rate` is at least `explained_above`, and in the cells of
    tracks that were merged into the background, until the object departs. The recent record of each cell starts from
    the fitted rate, with the weight of `map_weight_s` of observation, and forgets with the time constant `adaptation_s`
    while the cell is visible; a frame counts for the time since the previous frame.

    A cell outside the background that no track covers is a two-state Markov chain with the fitted rate as stationary
    probability. When it is seen empty, its P(occupied) drops to the share `untracked_share` of that rate and recovers
    with the time constant `rate_recovery_s`, both ahead in time and while the cell is hidden. `hidden_s` (M, M) is the
    time since each cell was last seen; infinite at first.
    """

    def __init__(self, fitted: BackgroundMap, period_s: float, settings: PipelineSettings) -> None:
        self.occupancy_rate, self.settings, self.period_s = fitted.occupancy_rate, settings, period_s
        self.hidden_s = np.full_like(fitted.occupancy_rate, np.inf)
        self._walls: Mask = fitted.neighbourhood_rate >= settings.explained_above
        self._stopped: list[Mask] = []
        self._map_frames = np.float32(settings.map_weight_s / period_s)
        self._visible, self._occupied = np.zeros_like(fitted.occupancy_rate), np.zeros_like(fitted.occupancy_rate)

    @property
    def explained(self) -> Mask:
        """The cells (M, M) whose returns belong to the background."""
        return np.asarray(np.logical_or.reduce([self._walls, *map(with_neighbours, self._stopped)]))

    def observe(self, frame: GridFrame, periods: int = 1) -> None:
        """Update the record with a frame, `periods` after the previous one."""
        lost = -math.expm1(-self.period_s / self.settings.adaptation_s)
        kept = (1.0 - lost) ** periods
        keep, counts = np.where(frame.visible, np.float32(kept), np.float32(1.0)), np.float32((1.0 - kept) / lost)
        self._visible = self._visible * keep + counts * frame.visible.astype(np.float32)
        self._occupied = self._occupied * keep + counts * frame.occupied.astype(np.float32)
        self.hidden_s = np.where(frame.visible, np.float32(0.0), self.hidden_s + np.float32(periods * self.period_s))
        empty = frame.visible & ~with_neighbours(frame.occupied)
        self._stopped = [cells for cells in self._stopped if empty[cells].mean() < DEPARTED_SHARE]

    def add_stopped(self, cells: Mask) -> None:
        """From now on, returns in these cells (M, M) and their neighbours belong to the background."""
        self._stopped.append(cells)

    def probabilities(self, steps: int) -> NDArray[np.float32]:
        """P(occupied) (steps+1, M, M) float32 without tracks, at steps 0..steps.

        Background cells, and cells whose record exceeds `static_above`, keep the rate of their record; other cells
        recover to the fitted rate.
        """
        record = (self.occupancy_rate * self._map_frames + self._occupied) / (self._map_frames + self._visible)
        static = self.explained | (record > self.settings.static_above)
        stationary = np.where(static, record, self.occupancy_rate)
        recovery_s, tracked = np.float32(self.settings.rate_recovery_s), np.float32(1.0 - self.settings.untracked_share)
        reduced = tracked * np.exp(-self.hidden_s / recovery_s)
        reduced[static] = 0.0
        remaining = np.exp(-np.arange(steps + 1, dtype=np.float32) * np.float32(self.period_s) / recovery_s)
        probabilities = np.multiply.outer(-remaining, stationary * reduced)
        probabilities += stationary
        return np.asarray(probabilities)

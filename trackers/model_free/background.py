"""The static background: occupancy rates counted at the site, the cells they explain, and the background forecast."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import GridFrame, Mask, Shift, rolled, with_neighbours
from gridtrack.trackers.cell_records import FadingRecord, HiddenTime, OpenSpace
from gridtrack.trackers.model_free.settings import PipelineSettings
from gridtrack.trackers.site_map import count_anywhere, count_frames, posterior_rate

OUTSIDE_MAP = 1.0
"""The neighbourhood rate of a cell outside the map; a counted one is lower."""
OUTSIDE_FRAMES = 1.0
"""Weight of the occupancy rate in the record of a cell outside the map, in frames."""
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


def fit_background(sources: Sequence[Iterable[GridFrame]], cell_m: float) -> tuple[BackgroundMap, bool]:
    """The map of the given frames, and whether a sensor moves; each rate is a posterior mean (`count_frames`)."""
    counts, moves = count_frames(
        sources, cell_m, lambda frame: (frame.visible, frame.occupied, frame.visible & with_neighbours(frame.occupied))
    )
    visible, occupied, neighbourhood = counts
    fitted = BackgroundMap(posterior_rate(occupied, visible), posterior_rate(neighbourhood, visible))
    return (without_map(fitted) if moves else fitted), moves


def general_background(sources: Sequence[Iterable[GridFrame]]) -> BackgroundMap:
    """The rates of a cell at an unknown place, each (1, 1): its background is learned from the stream."""
    visible, occupied = count_anywhere(sources, lambda frame: (frame.visible, frame.occupied))
    rate = posterior_rate(occupied, visible)
    return BackgroundMap(rate, np.full_like(rate, OUTSIDE_MAP))


def outside_of(fitted: BackgroundMap) -> NDArray[np.float32]:
    """Values (2, 1, 1) of the cells outside the map: the median rate, and OUTSIDE_MAP."""
    return np.array([np.median(fitted.occupancy_rate), OUTSIDE_MAP], np.float32)[:, None, None]


def without_map(fitted: BackgroundMap) -> BackgroundMap:
    """The map for a start without memory of the place: every cell is outside the map."""
    return BackgroundMap(*np.broadcast_to(outside_of(fitted), (2, *fitted.occupancy_rate.shape)).copy())


class Background:
    """The fitted background, adapted online: stopped objects are added to it and departed ones removed.

    Returns are background in cells with a fitted `neighbourhood_rate` of at least `explained_above`, and in the cells
    of tracks that were merged into the background, until the object departs. Outside the map returns are background in
    cells that have hardly ever been open (`OpenSpace`). The recent record of each cell starts from the fitted rate,
    with the weight of `map_weight_s` of observation, and forgets with the time constant `adaptation_s` while the cell
    is visible; a frame counts for the time since the previous frame.

    A cell outside the background that no track covers is a two-state Markov chain with the fitted rate as stationary
    probability. When it is seen empty, its P(occupied) drops to the share `untracked_share` of that rate and recovers
    with the time constant `rate_recovery_s`, both ahead in time and while the cell is hidden. `hidden_s` (M, M) is the
    time since each cell was last seen; infinite at first.
    """

    def __init__(self, fitted: BackgroundMap, period_s: float, settings: PipelineSettings) -> None:
        self.settings, self.period_s = settings, period_s
        shape = fitted.occupancy_rate.shape
        self._hidden = HiddenTime(shape)
        self._stopped: list[Mask] = []
        self._open_space = OpenSpace(shape, period_s)
        self._record = FadingRecord(shape, period_s, settings.adaptation_s)
        self._set_map(fitted)

    @property
    def hidden_s(self) -> NDArray[np.float32]:
        """Time since each cell (M, M) was last seen, seconds; infinite if never."""
        return self._hidden.seconds

    def _set_map(self, fitted: BackgroundMap) -> None:
        self.occupancy_rate = fitted.occupancy_rate
        self._walls: Mask = fitted.neighbourhood_rate >= self.settings.explained_above
        self._outside: Mask = fitted.neighbourhood_rate == OUTSIDE_MAP
        map_frames = np.float32(self.settings.map_weight_s / self.period_s)
        self._map_frames = np.where(self._outside, np.float32(OUTSIDE_FRAMES), map_frames)

    def scroll(self, shift: Shift, fitted: BackgroundMap) -> None:
        """Move the record with the window, in which the map is now `fitted`; cells that come in were never seen."""
        self._set_map(fitted)
        for record in (self._hidden, self._record, self._open_space):
            record.scroll(shift)
        stopped = [rolled(cells, shift, False) for cells in self._stopped]
        self._stopped = [cells for cells in stopped if cells.any()]

    @property
    def explained(self) -> Mask:
        """The cells (M, M) in which returns belong to the background."""
        walls = self._walls
        if self._outside.any():
            closed = self._open_space.closed(1.0 - self.settings.explained_above)
            walls = np.where(self._outside, closed, walls)
        return np.asarray(np.logical_or.reduce([walls, *map(with_neighbours, self._stopped)]))

    def observe(self, frame: GridFrame, periods: int = 1) -> None:
        """Update the record with a frame, `periods` after the previous one."""
        self._record.observe(frame.visible, frame.occupied, periods)
        self._hidden.observe(frame.visible, periods * self.period_s)
        if self._outside.any():
            self._open_space.observe(frame, periods)
        if self._stopped:
            empty = frame.visible & ~with_neighbours(frame.occupied)
            self._stopped = [cells for cells in self._stopped if empty[cells].mean() < DEPARTED_SHARE]

    def add_stopped(self, cells: Mask) -> None:
        """From now on, returns in these cells (M, M) and their neighbours belong to the background."""
        self._stopped.append(cells)

    def probabilities(self, steps: int) -> NDArray[np.float32]:
        """P(occupied) (steps+1, M, M) float32 without tracks, at steps 0..steps.

        Background cells, and cells with a record above `static_above`, keep the rate of their record; other cells
        recover to the fitted rate.
        """
        occupied = self.occupancy_rate * self._map_frames + self._record.marked
        record = occupied / (self._map_frames + self._record.visible)
        static = self.explained | (record > self.settings.static_above)
        stationary = np.where(static, record, self.occupancy_rate)
        recovery_s, tracked = np.float32(self.settings.rate_recovery_s), np.float32(1.0 - self.settings.untracked_share)
        reduced = tracked * np.exp(-self.hidden_s / recovery_s)
        reduced[static] = 0.0
        remaining = np.exp(-np.arange(steps + 1, dtype=np.float32) * np.float32(self.period_s) / recovery_s)
        probabilities = np.multiply.outer(-remaining, stationary * reduced)
        probabilities += stationary
        return np.asarray(probabilities)

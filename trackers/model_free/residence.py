"""Residence time: the remaining time of a return in its place, given its age, as a life table fitted to the site.

The returns of a walker do not move continuously with the body: a foot rests for about half a second and then swings
past the other; a pedestrian who has stood for three seconds will probably stay. For cars the table contains both queues
and moving sides.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec, Mask, Shift, rolled, shift_between
from gridtrack.trackers.cell_records import OpenSpace
from gridtrack.trackers.contract import FrameSource
from gridtrack.trackers.training.weights import Weights, probabilities

Ages = NDArray[np.int64]
OpenCells = Callable[[GridFrame], Mask]
"""The open cells (M, M) of the window of a frame, where returns have moved in. Called for each frame of a stream."""

GENERAL_PERIOD_S = 0.05
"""The period of a life table for streams of any period."""
SPAN_S = 3.0
"""Range of the table, both in age and in time ahead; the last age includes all older returns."""
NOT_OCCUPIED = -1
"""Age of a cell that is not occupied."""
PRIOR_RETURNS = 10.0
"""Weight of the prior "the return will be gone", in returns."""


def table_shape(period_s: float) -> tuple[int, int]:
    """Ages and steps of the life table: 0..SPAN_S each, in frames."""
    span = max(1, round(SPAN_S / period_s))
    return span + 1, span + 1


def next_ages(ages: Ages, occupied: Mask, oldest: int, periods: int = 1) -> Ages:
    """The number of periods, at most `oldest`, for which each occupied cell (M, M) or a neighbour has been occupied.

    NOT_OCCUPIED elsewhere. `ages` (M, M): of the previous frame, `periods` earlier.
    """
    before = _neighbourhood_maximum(ages)
    grown = np.where(before == NOT_OCCUPIED, 0, np.minimum(before + periods, oldest))
    return np.where(occupied, grown, NOT_OCCUPIED)


class OpenSoFar:
    """OpenCells without a map: cells that were open in more than `share` of the earlier frames (`OpenSpace`)."""

    def __init__(self, grid: GridSpec, period_s: float, share: float) -> None:
        self._space, self._share, self._cell_m = OpenSpace(grid.shape, period_s), share, grid.cell_m
        self._window: SE2 | None = None

    def __call__(self, frame: GridFrame) -> Mask:
        """The open cells (M, M) of the window of a frame, from earlier frames."""
        window = self._window or frame.world_T_grid
        if shift := shift_between(window, frame.world_T_grid, self._cell_m):
            self._space.scroll(shift)
        self._window = frame.world_T_grid
        closed = self._space.closed(self._share)
        self._space.observe(frame, 1)
        return ~closed


def fit_residence(
    stretches: Iterable[Iterable[GridFrame]],
    open_cells: Callable[[], OpenCells],
    shape: tuple[int, int],
    cell_m: float,
) -> NDArray[np.float32]:
    """Life table of `shape` (A, S), float32: P(a return is in place after s steps | its age is a frames).

    Counted over the returns in open cells, of `open_cells()` for each stretch. The table does not increase with s.
    """
    counts = [count_residence(frames, open_cells(), shape, cell_m) for frames in stretches]
    return _life_table(np.sum(counts, axis=0))


def general_residence(sources: Iterable[FrameSource], open_share: float) -> NDArray[np.float32]:
    """The life table with steps of GENERAL_PERIOD_S, counted at many places with their own cells and periods.

    A cell is open if it was open in more than `open_share` of the earlier frames.
    """
    shape = table_shape(GENERAL_PERIOD_S)
    total = np.zeros((2, *shape))
    for source in sources:
        opened = OpenSoFar(source.grid, source.period_s, open_share)
        counts = count_residence(source, opened, table_shape(source.period_s), source.grid.cell_m)
        total += [resampled(count, source.period_s, GENERAL_PERIOD_S) for count in counts]
    return _life_table(total)


def resampled(table: NDArray[np.floating], from_s: float, to_s: float) -> NDArray[np.float64]:
    """A table (A, S) by age and time ahead with steps of `from_s`, at steps of `to_s`, interpolated linearly."""
    at = np.meshgrid(*(np.arange(n) * to_s / from_s for n in table_shape(to_s)), indexing="ij")
    return np.asarray(map_coordinates(np.asarray(table, np.float64), at, order=1, mode="nearest"))


def count_residence(
    frames: Iterable[GridFrame], opened: OpenCells, shape: tuple[int, int], cell_m: float
) -> NDArray[np.float64]:
    """Counts (2, A, S) of returns in open cells by age, if the cell is visible s steps later: all, and still in place.

    A return is in place if its cell or one of the eight neighbours is occupied.
    """
    oldest = shape[0] - 1
    counts = np.zeros((2, *shape))
    past: deque[Ages] = deque(maxlen=shape[1])
    window: SE2 | None = None
    for frame in frames:
        shift = Shift() if window is None else shift_between(window, frame.world_T_grid, cell_m)
        window = frame.world_T_grid
        if shift:
            past = deque((rolled(ages, shift, NOT_OCCUPIED) for ages in past), shape[1])
        occupied = frame.occupied & opened(frame)
        before = past[0] if past else np.full(occupied.shape, NOT_OCCUPIED)
        past.appendleft(next_ages(before, occupied, oldest))
        near = _neighbourhood_maximum(occupied.astype(np.int64)) > 0
        for step, ages in enumerate(past):
            counted = (ages != NOT_OCCUPIED) & frame.visible
            counts[0, :, step] += np.bincount(ages[counted], minlength=oldest + 1)
            counts[1, :, step] += np.bincount(ages[counted & near], minlength=oldest + 1)
    return counts


def _life_table(counts: NDArray[np.float64]) -> NDArray[np.float32]:
    """The table (A, S) of counts (2, A, S) of returns at risk and of returns in place."""
    at_risk, stayed = counts
    return np.minimum.accumulate(stayed / (at_risk + PRIOR_RETURNS), axis=1).astype(np.float32)


def residence_of(weights: Weights, period_s: float) -> NDArray[np.float32]:
    """The life table of `weights` for a stream of this period. Raises WeightsError."""
    if not weights.card.general:
        return probabilities(weights, "residence", table_shape(period_s))
    table = probabilities(weights, "residence", table_shape(GENERAL_PERIOD_S))
    return resampled(table, GENERAL_PERIOD_S, period_s).astype(np.float32)


def probability_in_place(
    table: NDArray[np.float32], ages: NDArray[np.int64], unseen: NDArray[np.int64], steps: int
) -> NDArray[np.float32]:
    """P(a return is in place) at steps 0..steps, (N, steps+1), for returns last seen `unseen` (N,) frames ago.

    `ages` (N,) are their ages at that time. The last column of the table also counts beyond it.
    """
    ahead = np.minimum(unseen[:, None] + np.arange(steps + 1), table.shape[1] - 1)
    return np.asarray(table[np.minimum(ages, table.shape[0] - 1)[:, None], ahead])


def _neighbourhood_maximum(values: Ages) -> Ages:
    """The largest value in the 3 x 3 neighbourhood of each cell (M, M)."""
    rows = values.copy()
    rows[1:] = np.maximum(rows[1:], values[:-1])
    rows[:-1] = np.maximum(rows[:-1], values[1:])
    largest = rows.copy()
    largest[:, 1:] = np.maximum(largest[:, 1:], rows[:, :-1])
    largest[:, :-1] = np.maximum(largest[:, :-1], rows[:, 1:])
    return largest

"""The width of objects without a covariance: the one with the least log loss on a validation stretch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.recordings.observation import cells_in_window
from gridtrack.recordings.outputs.object_table import Numbers, ObjectList, TwistFrame
from gridtrack.recordings.outputs.rasterise import draw_object

DEFAULT_WIDTH_M = 0.2
"""The width without a validation stretch."""
TRIED_WIDTHS_M = (0.0, 0.1, 0.2, 0.3, 0.45, 0.7)
FITTED_LEADS_S = (0.5, 1.0, 2.0)
MAX_FITTED_LISTS = 60
"""Limit of the lists that the width is fitted on, evenly spaced."""
SUREST = 1e-3
"""P(occupied) counts as at least this far from 0 and 1: drawn objects are surer than they can know."""


class Placed(NamedTuple):
    """Objects of one stamp, P(occupied) (M, M) of the static map then, and the window, `world_T_grid`."""

    objects: ObjectList
    static: NDArray[np.float32]
    window: SE2


def drawn(
    placed: Placed, twist_frame: TwistFrame, lead_s: Numbers, grid: GridSpec, width_m: float
) -> NDArray[np.float32]:
    """P(occupied) (T, M, M) of the objects over the static map, at `lead_s` (T,)."""
    planes = np.repeat(placed.static[None], len(lead_s), axis=0)
    for one in placed.objects.objects:
        draw_object(planes, one, one.velocities[twist_frame], lead_s, grid, placed.window, width_m)
    return planes


class WidthFit:
    """The log loss of each of TRIED_WIDTHS_M on the visible cells of later frames."""

    def __init__(self, lists: Sequence[Placed], twist_frame: TwistFrame, grid: GridSpec, horizon_s: float) -> None:
        every = max(1, -(-len(lists) // MAX_FITTED_LISTS))
        self._lists, self._twist_frame, self._grid = lists[::every], twist_frame, grid
        self._leads_s = [lead for lead in FITTED_LEADS_S if lead <= horizon_s]
        self.losses = np.zeros(len(TRIED_WIDTHS_M))
        """Sums over the cells, nats."""
        self.forecasts = 0

    def add(self, frame: GridFrame, period_s: float) -> None:
        """Add the loss of the planes that predict this frame, to the nearest period."""
        for placed in self._lists:
            ahead_s = (frame.stamp_ns - placed.objects.stamp_ns) / 1e9
            if any(-0.5 * period_s < ahead_s - lead <= 0.5 * period_s for lead in self._leads_s):
                marks = np.stack([frame.visible, frame.occupied])
                visible, occupied = cells_in_window(marks, frame.world_T_grid, placed.window, self._grid)
                for number, width_m in enumerate(TRIED_WIDTHS_M):
                    plane = drawn(placed, self._twist_frame, np.array([ahead_s]), self._grid, width_m)[0]
                    self.losses[number] += log_loss(plane[visible], occupied[visible])
                self.forecasts += 1

    @property
    def best_m(self) -> float:
        """The width with the least loss."""
        return TRIED_WIDTHS_M[int(self.losses.argmin())]


def log_loss(probabilities: NDArray[np.float32], occupied: NDArray[np.bool_]) -> float:
    """The sum of the log losses of cells (K,), nats."""
    of_outcome = np.where(occupied, probabilities, 1.0 - probabilities).astype(np.float64)
    return float(-np.log(of_outcome.clip(SUREST, 1.0 - SUREST)).sum())

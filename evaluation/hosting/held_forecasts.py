"""The memory of the forecasts of one tracker that the host holds, such as those that wait for their frames."""

from __future__ import annotations

import weakref
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridtrack.trackers.contract import Forecast


class HeldForecasts:
    """Counts the bytes of forecasts until the last reference to their arrays is gone."""

    def __init__(self, max_bytes: int) -> None:
        self.max_bytes = max_bytes
        self.held_bytes = 0

    @property
    def left_bytes(self) -> int:
        """How many bytes the next forecast may have."""
        return max(0, self.max_bytes - self.held_bytes)

    def add(self, forecast: Forecast) -> None:
        """Count the arrays of `forecast` from now on; those that share their memory once."""
        planes = (forecast.occupancy, forecast.semantics, forecast.velocity, forecast.futures)
        owners = {id(owner): owner for owner in map(_owner, filter(lambda plane: plane is not None, planes))}
        for owner in owners.values():
            self.held_bytes += owner.nbytes
            weakref.finalize(owner, self._release, owner.nbytes)

    def _release(self, count: int) -> None:
        self.held_bytes -= count


def _owner(array: Any) -> NDArray[Any]:
    """The array whose memory `array` is a view of; itself where it is none."""
    while isinstance(array.base, np.ndarray):
        array = array.base
    return np.asarray(array)

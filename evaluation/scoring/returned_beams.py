"""The beams of an observed frame that end on something in the window of a forecast."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import GridSpec
from gridtrack.common.raycast import directions_of, end_cells, turned
from gridtrack.recordings.observation import Observation


@dataclass(frozen=True, slots=True)
class ReturnedBeams:
    """N beams that returned from inside the window, of all sensors, in cells from the window's lower-left corner.

    `starts` (N, 2) float64: x, y of the sensor; `directions` (N, 2) float64: unit vectors; `ranges` (N,) float64:
    measured; `longest` (N,) float64: the sensor's maximum range; `cells` (N,) int64, row * M + column: where they end.
    """

    starts: NDArray[np.float64]
    directions: NDArray[np.float64]
    ranges: NDArray[np.float64]
    longest: NDArray[np.float64]
    cells: NDArray[np.int64]

    @classmethod
    def none(cls) -> ReturnedBeams:
        """Those of a frame without scans."""
        return cls(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.zeros(0, np.int64))


def returned_beams(observation: Observation, grid: GridSpec) -> ReturnedBeams:
    """The beams of an observation that end in its window; none where it has no scans."""
    found = [ReturnedBeams.none()]
    for scan, pose in zip(observation.scans, observation.grid_T_sensor, strict=True):
        cells = end_cells(scan, grid, pose)
        inside = np.flatnonzero(cells >= 0)
        start = (np.array([pose.x, pose.y]) - grid.origin) / grid.cell_m
        directions = turned(directions_of(scan.angle_min, scan.angle_increment, scan.ranges.size), pose.theta)
        ranges = scan.ranges[inside].astype(np.float64) / grid.cell_m
        longest = np.full(inside.size, scan.range_max / grid.cell_m)
        found.append(
            ReturnedBeams(np.tile(start, (inside.size, 1)), directions[inside], ranges, longest, cells[inside])
        )
    return ReturnedBeams(
        *(
            np.concatenate([getattr(one, name) for one in found])
            for name in ("starts", "directions", "ranges", "longest", "cells")
        )
    )

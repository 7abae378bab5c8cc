"""How long one scan takes to become a grid frame: `python -m benchmarks.raycast`. The aim: at most 0.1 ms."""

from __future__ import annotations

import time

import numpy as np

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridSpec
from gridtrack.common.raycast import cast_scan
from gridtrack.common.scan import Scan

REPEATS = 5000


def median_ms(scan: Scan, grid: GridSpec) -> float:
    visible, occupied = np.zeros(grid.shape, np.bool_), np.zeros(grid.shape, np.bool_)
    took = np.empty(REPEATS)
    for i in range(REPEATS):
        visible[:], occupied[:] = False, False
        begun = time.perf_counter()
        cast_scan(scan, grid, SE2(), visible, occupied)
        took[i] = time.perf_counter() - begun
    return float(np.median(took)) * 1e3


def main() -> None:
    random = np.random.default_rng(0)
    step = np.radians(270.0) / 1080
    print(f"median of {REPEATS}, 1081 beams over 270 degrees, ranges 2 to 30 m")
    for grid in (GridSpec(100, 0.2), GridSpec(200, 0.1), GridSpec(400, 0.1)):
        ranges = random.uniform(2.0, 30.0, 1081).astype(np.float32)
        scan = Scan(0, ranges, -np.radians(135.0), step, range_min=0.1, range_max=30.0)
        print(f"  {grid.size} x {grid.size} cells of {grid.cell_m:g} m: {median_ms(scan, grid):.3f} ms")


if __name__ == "__main__":
    main()

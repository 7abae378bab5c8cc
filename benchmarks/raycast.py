"""Time from one scan to its grid frame.

`python -m benchmarks.raycast` (ten seconds). Aim: at most 0.1 ms.
"""

from __future__ import annotations

import argparse

import numpy as np

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridSpec
from gridtrack.common.raycast import cast_scan
from gridtrack.common.scan import Scan

from benchmarks.timing import median_ms

REPEATS = 5000


def cast_ms(scan: Scan, grid: GridSpec) -> float:
    """The median time of one cast into an empty frame."""
    visible, occupied = np.zeros((2, *grid.shape), np.bool_)

    def clear() -> None:
        visible[:], occupied[:] = False, False

    return median_ms(lambda: cast_scan(scan, grid, SE2(), visible, occupied), REPEATS, clear)


def main() -> None:
    argparse.ArgumentParser(description=__doc__.partition("\n")[0]).parse_args()
    random = np.random.default_rng(0)
    step = np.radians(270.0) / 1080
    print(f"median of {REPEATS}, 1081 beams over 270 degrees, ranges 2 to 30 m")
    for grid in (GridSpec(100, 0.2), GridSpec(200, 0.1), GridSpec(400, 0.1)):
        ranges = random.uniform(2.0, 30.0, 1081).astype(np.float32)
        scan = Scan(0, ranges, -np.radians(135.0), step, range_min=0.1, range_max=30.0)
        print(f"  {grid.size} x {grid.size} cells of {grid.cell_m:g} m: {cast_ms(scan, grid):.3f} ms")


if __name__ == "__main__":
    main()

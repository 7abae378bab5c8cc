"""Speed of small parts: Python imports, casting a scan, the statistics of a comparison.

`python -m benchmarks.parts` (half a minute). Aims: a scan becomes a frame within 0.1 ms; intervals and differences for
10 trackers x 21 steps x 8 strata from 20 recordings take at most 10 s.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence

import numpy as np

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridSpec
from gridtrack.common.raycast import cast_scan
from gridtrack.common.scan import Scan
from gridtrack.evaluation.referee.strata import STRATA
from gridtrack.evaluation.scores.definition import Sums, TrialFacts
from gridtrack.evaluation.scores.f1 import F1
from gridtrack.evaluation.scores.thresholds import half
from gridtrack.evaluation.statistics.jackknife import difference, holm, interval, replicates

from benchmarks.timing import median_ms
from studies.support.results_file import study_parser

PROCESSES = {
    "an empty Python process": ("-c", "pass"),
    "import gridtrack": ("-c", "import gridtrack"),
    "the imports of a plugin": ("-c", "from gridtrack import Tracker, Forecast, GridFrame"),
    "gridtrack --help": ("-m", "gridtrack.cli", "--help"),
}
GRIDS = (GridSpec(100, 0.2), GridSpec(200, 0.1), GridSpec(400, 0.1))


def print_processes(runs: int) -> None:
    """Whole processes."""
    for name, words in PROCESSES.items():
        ms = median_ms(
            lambda words=words: subprocess.run([sys.executable, *words], check=True, capture_output=True), runs
        )
        print(f"{name}: {ms:.0f} ms")


def print_raycast(runs: int) -> None:
    """Casts of a scan into an empty frame."""
    ranges = np.random.default_rng(0).uniform(2.0, 30.0, 1081).astype(np.float32)
    step = np.radians(270.0) / 1080
    scan = Scan(0, ranges, -np.radians(135.0), step, range_min=0.1, range_max=30.0)
    print("1081 beams over 270 degrees, ranges 2 to 30 m")
    for grid in GRIDS:
        frame = np.zeros((2, *grid.shape), np.bool_)
        ms = median_ms(
            lambda grid=grid, frame=frame: cast_scan(scan, grid, SE2(), *frame),
            runs,
            lambda frame=frame: frame.fill(False),
        )
        print(f"  {grid.size} x {grid.size} cells of {grid.cell_m:g} m: {ms:.3f} ms")


def print_statistics(runs: int) -> None:
    """Intervals of all trackers, and their differences from the first."""
    parts = F1.parts(TrialFacts(0.2, 20, STRATA, half(20, STRATA)))
    trackers = np.random.default_rng(0).poisson(50.0, (10, 20, 21, len(STRATA), len(parts))).astype(np.float64)

    def statistics_of_all() -> None:
        found = []
        for counts in trackers:
            by_unit = Sums(counts, parts)
            found.append(replicates(F1.value, lambda one=by_unit: iter([one]), Sums(counts.sum(axis=0), parts)))
            for output in F1.outputs:
                if output.name in found[-1]:
                    interval(found[-1][output.name], output.scale)
        gaps = [difference(one["f1"], found[0]["f1"]) for one in found[1:]]
        holm(np.concatenate([gap.p[[4, 8, 20], :2].ravel() for gap in gaps]))

    print(f"10 trackers, the intervals of F1 and the differences: {median_ms(statistics_of_all, runs):.0f} ms")


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__)
    parser.add_argument("--runs", type=int, default=9, help="of a process; more of the faster parts")
    runs = parser.parse_args(arguments).runs
    print_processes(runs)
    print_raycast(500 * runs)
    print_statistics(-(-runs // 3))


if __name__ == "__main__":
    main()

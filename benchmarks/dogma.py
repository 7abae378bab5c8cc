"""Speed of the particle grid: one update and one 20-step forecast at the junction, by the number of particles.

`python -m benchmarks.dogma` (two minutes). Aim: both together within 60 ms at p95 with 100,000 particles on
100 x 100 cells, on one thread.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import GridFrame
from gridtrack.recordings.stream import open_stream
from gridtrack.trackers.contract import StreamSpec
from gridtrack.trackers.dogma.filter import DogmaSettings
from gridtrack.trackers.dogma.tracker import DogmaTracker

from benchmarks.timing import p50_p95
from studies.support.results_file import ResultTable, measured_table, study_parser, write_table
from studies.support.shipped import JUNCTION, STEPS, shipped_stream

FRAMES, WARM_UP = 240, 20
DEFAULT = DogmaSettings.model_fields["particles"].default
"""Particles of the shipped tracker."""


def measure(stream: StreamSpec, frames: list[GridFrame], particles: int) -> NDArray[np.float64]:
    """Milliseconds (4, N) of each update, each forecast, both, and the processor time of both."""
    tracker = DogmaTracker(stream, DogmaSettings(particles=particles))
    times = []
    for frame in frames:
        start, processor_start = time.perf_counter(), time.process_time()
        tracker.update(frame)
        updated = time.perf_counter()
        tracker.predict(STEPS)
        done, processor_done = time.perf_counter(), time.process_time()
        times.append((updated - start, done - updated, done - start, processor_done - processor_start))
    return np.asarray(1e3 * np.array(times[WARM_UP:]).T)


def table_of(found: dict[int, NDArray[np.float64]]) -> ResultTable:
    """Ratios of median times (4, N) to the times with the default number of particles."""
    standard = np.median(found[DEFAULT], axis=1)
    rows = []
    for particles, times in found.items():
        update, forecast, both, processor = np.median(times, axis=1)
        ratios = update / standard[0], forecast / standard[1], both / standard[2], processor / both
        rows.append([f"{particles:,}", *(f"{ratio:.2f}" for ratio in ratios)])
    return measured_table(
        ("particles", "update", "20-step forecast", "both", "processor time of both, of their time"), rows
    )


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__, "docs/results/trackers/dogma.json")
    parser.add_argument("--particles", type=int, nargs="+", default=[25_000, 50_000, DEFAULT, 200_000])
    given = parser.parse_args(arguments)
    source = open_stream(JUNCTION / "test-101.tracks")
    frames, stream = list(islice(source, FRAMES)), shipped_stream("dogma", source)
    print(f"ms, p50 / p95, of an update and a {STEPS}-step forecast; 'processor' is the processor time of both")
    print(f"{'particles':>9} {'update':>15} {'forecast':>15} {'both':>15} {'processor':>15}")
    found = {}
    for number in given.particles:
        found[number] = measure(stream, frames, number)
        print(f"{number:>9} " + " ".join(f"{p50_p95(times):>15}" for times in found[number]))
    if DEFAULT in found:
        values = {"both, ms": p50_p95(found[DEFAULT][2])}
        write_table(given.out, "time", table_of(found), "python -m benchmarks.dogma", values)


if __name__ == "__main__":
    main()

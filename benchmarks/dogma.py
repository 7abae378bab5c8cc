"""Speed of the particle grid: one update and one 20-step forecast at the junction, by the number of particles.

`python -m benchmarks.dogma` (two minutes). Aim: both together within 60 ms at p95 with 100,000 particles on
100 x 100 cells, on one thread.
"""

from __future__ import annotations

import argparse
import time
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import GridFrame
from gridtrack.recordings.stream import open_stream
from gridtrack.trackers.contract import StreamSpec
from gridtrack.trackers.dogma.settings import DogmaSettings
from gridtrack.trackers.dogma.tracker import DogmaTracker

from benchmarks.timing import p50_p95
from studies.support.shipped import JUNCTION, STEPS, shipped_stream

FRAMES, WARM_UP = 240, 20


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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--particles", type=int, nargs="+", default=[25_000, 50_000, 100_000, 200_000])
    source = open_stream(JUNCTION / "test-101.tracks")
    frames, stream = list(islice(source, FRAMES)), shipped_stream("dogma", source)
    particles = parser.parse_args().particles
    print(f"ms, p50 / p95, of an update and a {STEPS}-step forecast; 'processor' is the processor time of both")
    print(f"{'particles':>9} {'update':>15} {'forecast':>15} {'both':>15} {'processor':>15}")
    for number in particles:
        print(f"{number:>9} " + " ".join(f"{p50_p95(times):>15}" for times in measure(stream, frames, number)))


if __name__ == "__main__":
    main()

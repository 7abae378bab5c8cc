"""Speed of the particle grid: one update and one 20-step forecast at the junction, by the number of particles.

Run it by itself: `python -m benchmarks.dogma`. Aim: both together within 60 ms at p95 with 100,000 particles on
100 x 100 cells, on one thread.
"""

from __future__ import annotations

import time
from itertools import islice

import numpy as np

from gridtrack.common.grid import GridFrame
from gridtrack.evaluation.comparison.learned import find_weights
from gridtrack.recordings import packaged_recording
from gridtrack.recordings.stream import open_stream
from gridtrack.trackers.contract import StreamSpec, stream_of
from gridtrack.trackers.dogma.settings import DogmaSettings
from gridtrack.trackers.dogma.tracker import DogmaTracker

RECORDING = packaged_recording("leg_tracker").parents[1] / "junction" / "test-101.tracks"
FRAMES, WARM_UP, STEPS = 240, 20, 20


def measure(stream: StreamSpec, frames: list[GridFrame], particles: int) -> np.ndarray:
    """Milliseconds of each update, each forecast and both (3, N), and of both the processor's own time (4, N)."""
    tracker = DogmaTracker(stream, DogmaSettings(particles=particles))
    times = []
    for frame in frames:
        start, start_own = time.perf_counter(), time.process_time()
        tracker.update(frame)
        updated = time.perf_counter()
        tracker.predict(STEPS)
        done, done_own = time.perf_counter(), time.process_time()
        times.append((updated - start, done - updated, done - start, done_own - start_own))
    return 1e3 * np.array(times[WARM_UP:]).T


def main() -> None:
    source = open_stream(RECORDING)
    frames = list(islice(source, FRAMES))
    learned = find_weights("dogma", source.site, None)
    assert learned is not None, "no weights of dogma for the junction"
    stream = stream_of(source, learned.path)
    print(
        f"ms, p50 / p95, of an update and a {STEPS}-step forecast; 'own' is processor time, which a busy machine spares"
    )
    print(f"{'particles':>9} {'update':>15} {'forecast':>15} {'both':>15} {'both, own':>15}")
    for particles in (25_000, 50_000, 100_000, 200_000):
        columns = [np.percentile(times, [50, 95]) for times in measure(stream, frames, particles)]
        print(f"{particles:>9} " + " ".join(f"{f'{p50:.1f} / {p95:.1f}':>15}" for p50, p95 in columns))


if __name__ == "__main__":
    main()

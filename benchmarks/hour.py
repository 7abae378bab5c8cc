"""An hour of frames through a whole tracker: memory, time of an update and of a forecast, and recoveries as it goes.

Run it by itself: `python -m benchmarks.hour [TRACKER...]` (kalman, factor-graph and dogma unless named). A minute of
the junction is looped sixty times without a reset; at each seam everything that moves jumps. A forecast of 20 steps is
asked for every two seconds.
"""

from __future__ import annotations

import sys
import time

import numpy as np
import psutil

from gridtrack.evaluation.comparison.learned import find_weights
from gridtrack.recordings import packaged_recording
from gridtrack.recordings.stream import open_stream
from gridtrack.trackers import registry
from gridtrack.trackers.contract import Tracker, stream_of

RECORDING = packaged_recording("leg_tracker").parents[1] / "junction" / "test-101.tracks"
LOOPS, REPORT_EVERY, FORECAST_EVERY, STEPS = 60, 10, 16, 20


def main() -> None:
    stream = open_stream(RECORDING)
    frames = list(stream)
    for name in sys.argv[1:] or ["kalman", "factor-graph", "dogma"]:
        learned = find_weights(name, stream.site, None)
        kind = registry.load(name)
        tracker: Tracker = kind(stream_of(stream, learned.path if learned else None), kind.Options())
        tracker.reset(0)
        process = psutil.Process()
        print(f"{name}: minutes, MiB, update p50 / p95 ms, forecast p50 / p95 ms, recoveries")
        for first in range(0, LOOPS, REPORT_EVERY):
            updates, forecasts = [], []
            for number, frame in enumerate(frames * REPORT_EVERY):
                began = time.perf_counter()
                tracker.update(frame)
                updates.append(time.perf_counter() - began)
                if number % FORECAST_EVERY == 0:
                    began = time.perf_counter()
                    tracker.predict(STEPS)
                    forecasts.append(time.perf_counter() - began)
            minutes = round((first + REPORT_EVERY) * len(frames) * stream.period_s / 60)
            memory = process.memory_info().rss / 2**20
            times = [
                f"{p50:6.1f} / {p95:.1f}"
                for p50, p95 in (1e3 * np.percentile(t, [50, 95]) for t in (updates, forecasts))
            ]
            print(f"{minutes:6} {memory:8.1f}   {'   '.join(times)}   {tracker.recoveries}", flush=True)


if __name__ == "__main__":
    main()

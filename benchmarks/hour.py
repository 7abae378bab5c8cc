"""One hour of frames through a whole tracker: memory, times of updates and forecasts, and recoveries over the hour.

`python -m benchmarks.hour [TRACKER...]` (kalman, factor-graph and dogma by default; twenty minutes). One minute of the
junction is repeated sixty times without a reset; at each repetition every moving body jumps. A forecast of 20 steps is
made every two seconds.
"""

from __future__ import annotations

import argparse
import time

import psutil

from gridtrack.recordings.stream import open_stream

from benchmarks.timing import p50_p95
from studies.support.shipped import JUNCTION, STEPS, shipped_tracker

REPORT_EVERY, FORECAST_EVERY = 10, 16


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("trackers", nargs="*", default=["kalman", "factor-graph", "dogma"])
    parser.add_argument("--minutes", type=int, default=60)
    arguments = parser.parse_args()
    stream = open_stream(JUNCTION / "test-101.tracks")
    frames = list(stream)
    for name in arguments.trackers:
        tracker, process = shipped_tracker(name, stream), psutil.Process()
        print(f"{name}: minutes, MiB, update p50 / p95 ms, forecast p50 / p95 ms, recoveries")
        for first in range(0, arguments.minutes, REPORT_EVERY):
            updates, forecasts = [], []
            repeats = min(REPORT_EVERY, arguments.minutes - first)
            for number, frame in enumerate(frames * repeats):
                began = time.perf_counter()
                tracker.update(frame)
                updates.append(1e3 * (time.perf_counter() - began))
                if number % FORECAST_EVERY == 0:
                    began = time.perf_counter()
                    tracker.predict(STEPS)
                    forecasts.append(1e3 * (time.perf_counter() - began))
            minutes = round((first + repeats) * len(frames) * stream.period_s / 60)
            memory = process.memory_info().rss / 2**20
            times = f"{p50_p95(updates):>14}   {p50_p95(forecasts):>14}"
            print(f"{minutes:6} {memory:8.1f}   {times}   {tracker.recoveries}", flush=True)


if __name__ == "__main__":
    main()

"""One hour of frames through a tracker: memory, times of updates and forecasts, and recoveries.

`python -m benchmarks.hour [TRACKER...] [--out FILE]` (default: MINUTES; forty minutes on an idle core). One minute of
the junction is repeated without a reset, so that every moving body jumps at each repetition. A forecast of 20 steps is
made every two seconds. Each tracker runs in a process of its own.
"""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from multiprocessing.connection import Connection

import psutil

from gridtrack.recordings.stream import open_stream

from benchmarks.timing import p50_p95
from studies.support.results_file import ResultTable, measured_table, study_parser, write_table
from studies.support.shipped import JUNCTION, STEPS, shipped_tracker

PART_MINUTES, FORECAST_EVERY = 10, 16
MINUTES = {
    "persistence": 60,
    "kalman": 60,
    "factor-graph": 60,
    "dogma": 60,
    "dilated-convgru": 20,
    "deep-tracking-rnn": 20,
}
COLUMNS = ("tracker", "minutes", "MiB", "update, ms", "forecast, ms", "recoveries")


@dataclass(frozen=True)
class Part:
    """Ten minutes of frames: memory at the end, and times of the calls."""

    minutes: int
    memory_mib: float
    updates_ms: Sequence[float]
    forecasts_ms: Sequence[float]
    recoveries: int


def stream_frames(name: str, minutes: int, parts: Connection) -> None:
    """Stream these minutes and send each Part."""
    stream = open_stream(JUNCTION / "test-101.tracks")
    frames = list(stream)
    tracker, process = shipped_tracker(name, stream), psutil.Process()
    for first in range(0, minutes, PART_MINUTES):
        updates, forecasts = [], []
        repeats = min(PART_MINUTES, minutes - first)
        for number, (repeat, frame) in enumerate(product(range(first, first + repeats), frames)):
            later = replace(frame, stamp_ns=frame.stamp_ns + repeat * len(frames) * stream.period_ns)
            began = time.perf_counter()
            tracker.update(later)
            updates.append(1e3 * (time.perf_counter() - began))
            if number % FORECAST_EVERY == 0:
                began = time.perf_counter()
                tracker.predict(STEPS)
                forecasts.append(1e3 * (time.perf_counter() - began))
        memory = process.memory_info().rss / 2**20
        parts.send(Part(first + repeats, memory, updates, forecasts, tracker.recoveries))
    parts.close()


def parts_of(name: str, minutes: int) -> list[Part]:
    """The parts of a tracker; each is printed when it ends."""
    context, found = multiprocessing.get_context("spawn"), []
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=stream_frames, args=(name, minutes, sender))
    process.start()
    sender.close()
    try:
        while True:
            found.append(receiver.recv())
            print(" ".join(row_of(name, found[-1])), flush=True)
    except EOFError:
        process.join()
    if process.exitcode:
        raise SystemExit(f"{name}: ended with exit code {process.exitcode}")
    return found


def row_of(name: str, part: Part) -> list[str]:
    """A row of COLUMNS; times are the median and the 95th percentile."""
    times = p50_p95(part.updates_ms), p50_p95(part.forecasts_ms)
    return [name, str(part.minutes), f"{part.memory_mib:.0f}", *times, str(part.recoveries)]


def table_of(parts: dict[str, list[Part]]) -> ResultTable:
    """The first and the last part of each tracker."""
    return measured_table(COLUMNS, [row_of(name, part) for name, own in parts.items() for part in (own[0], own[-1])])


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__, "docs/results/robustness.json")
    parser.add_argument("trackers", nargs="*", help="default: all")
    parser.add_argument("--minutes", type=int, help="of frames; default: an hour, for networks twenty minutes")
    given = parser.parse_args(arguments)
    names = given.trackers or MINUTES
    parts = {name: parts_of(name, given.minutes or MINUTES[name]) for name in names}
    write_table(given.out, "frames", table_of(parts), "python -m benchmarks.hour")


if __name__ == "__main__":
    main()

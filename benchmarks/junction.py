"""Time to simulate, check and render 75 minutes of the junction, and the traffic in them.

`python -m benchmarks.junction [SEED...]` (six minutes per seed; needs the extra `sim`). Seeds 1 to 10 check that the
traffic never gridlocks, nobody walks through walls or the scanner, and each class moves. Aims: 6 minutes on two cores,
no faults, each class moving in 30 % of the frames, buses in 5 %.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

from gridtrack.recordings import open_recording
from gridtrack.simulation.junction import simulate_junction
from gridtrack.simulation.tracks_file import write_recording
from gridtrack.simulation.traffic import check_traffic

from studies.support.results_file import study_parser

Result = TypeVar("Result")


def timed(call: Callable[[], Result]) -> tuple[Result, float, float]:
    """The result of a call, its duration and its processor time with children, seconds."""
    start, before = time.perf_counter(), os.times()
    result = call()
    after = os.times()
    return result, time.perf_counter() - start, sum(after[:4]) - sum(before[:4])


def print_seed(seed: int, minutes: float) -> None:
    tracks, simulated_s, busy_s = timed(lambda: simulate_junction(minutes, seed))
    traffic, checked_s, _ = timed(lambda: check_traffic(tracks))
    with tempfile.TemporaryDirectory() as folder:
        small, whole = Path(folder) / "junction.tracks", Path(folder) / "junction.mcap"
        write_recording(small, tracks)
        _, rendered_s, _ = timed(lambda: write_recording(whole, tracks))
        scans, read_s, _ = timed(lambda: sum(1 for _ in open_recording(whole).scans()))
        sizes = f"{small.stat().st_size / 1e6:.2f} MB as tracks, {whole.stat().st_size / 1e6:.0f} MB as scans"
    print(
        f"seed {seed}: simulated in {simulated_s:.0f} s ({busy_s:.0f} s of one core), checked in {checked_s:.0f} s,"
        f" rendered and written in {rendered_s:.0f} s ({scans / rendered_s:.0f} scans/s), read at"
        f" {scans / read_s:.0f} scans/s; {sizes}"
    )
    print(traffic, flush=True)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__)
    parser.add_argument("seeds", type=int, nargs="*", default=[1])
    parser.add_argument("--minutes", type=float, default=75.0)
    given = parser.parse_args(arguments)
    for seed in given.seeds:
        print_seed(seed, given.minutes)


if __name__ == "__main__":
    main()

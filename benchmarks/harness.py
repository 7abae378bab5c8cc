"""Cost of the harness beside the trackers: time per frame, time over the demo, memory by length of the recording.

`python -m benchmarks.harness [TRACKER...]` (some minutes). Aims: 5 ms per frame beside the tracker's own time, printed
for `blank`; 1.1 x the trackers' own time in all (default: every tracker that has weights); and the same memory for a
recording ten times as long.
"""

from __future__ import annotations

import multiprocessing
import resource
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from gridtrack.common.scan import Scan
from gridtrack.evaluation.runs.plan import resolve
from gridtrack.evaluation.runs.runner import run
from gridtrack.evaluation.runs.settings import CompareSettings
from gridtrack.evaluation.runs.summary import RunSummary
from gridtrack.evaluation.runs.trial_record import TrialRecord
from gridtrack.recordings import open_recording, write_native

from studies.support.results_file import study_parser
from studies.support.shipped import DEMO

LOOPS = 10


class NoProgress:
    """A progress display that shows nothing."""

    def note(self, text: str) -> None:
        """Show nothing."""

    def planned(self, frames: Mapping[str, int], then: Sequence[str] = ()) -> None:
        """Show nothing."""

    def started(self, trial: str, frames: int) -> None:
        """Show nothing."""

    def advanced(self, trial: str) -> None:
        """Show nothing."""

    def ended(self, trial: str, record: TrialRecord) -> None:
        """Show nothing."""


def compare(recording: str, trackers: Sequence[str]) -> RunSummary:
    """The summary of a run, one trial at a time."""
    with tempfile.TemporaryDirectory() as folder:
        rows = {"trackers": tuple(trackers), "no_floors": True}
        settings = CompareSettings(recordings=(recording,), out=Path(folder), jobs=1, **rows)
        return run(resolve(settings), (), NoProgress())


def looped(times: int) -> Iterator[Scan]:
    """The scans of the demo recording, repeated."""
    recording = open_recording(DEMO)
    length_ns = recording.survey.last_ns - recording.survey.first_ns + 100_000_000
    for loop in range(times):
        for scan in recording.scans():
            yield replace(scan, stamp_ns=scan.stamp_ns + loop * length_ns)


def peak_memory_mb(recording: str) -> float:
    """Peak memory of a process that runs `blank` over the whole recording."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(_run_and_measure, (recording,))


def _run_and_measure(recording: str) -> float:
    compare(recording, ("blank",))
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def print_times(trackers: Sequence[str]) -> None:
    summary = compare(str(DEMO), trackers)
    own_total = wall_total = 0.0
    for label, entry in summary.trackers.items():
        for trial in entry.recordings.values():
            if trial.outcome != "ok":
                print(f"{label:20} {trial.outcome}")
                continue
            own, wall = trial.times.update_s + trial.times.predict_s, trial.times.wall_s
            own_total, wall_total = own_total + own, wall_total + wall
            beside_ms = 1e3 * (wall - own) / trial.times.frames
            print(f"{label:20} {own:8.2f} s own, {wall:8.2f} s in all, {beside_ms:5.2f} ms per frame beside it")
    print(f"{'together':20} {own_total:8.2f} s own, {wall_total:8.2f} s in all: {wall_total / own_total:.2f} x")


def print_memory() -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "looped.mcap"
        with path.open("wb") as file:
            write_native(file, open_recording(DEMO).info.model_copy(update={"stretches": {}}), looped(LOOPS))
        once, often = peak_memory_mb(f"{DEMO}@0s-126s"), peak_memory_mb(str(path))
    print(f"peak memory of the referee: {once:.0f} MiB for the demo, {often:.0f} MiB for one {LOOPS} times as long")


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__)
    parser.add_argument("trackers", nargs="*", help="default: every tracker that has weights")
    print_times(parser.parse_args(arguments).trackers)
    print_memory()


if __name__ == "__main__":
    main()

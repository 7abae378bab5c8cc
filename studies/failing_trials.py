"""Hundreds of failing trials, one after the other: do they leak resources, and how far do they exceed limits?

`python -m studies.failing_trials [--trials 504] [--sandbox]` runs the failing trackers of tests/plugins/bad_trackers.py
in turn, each in its own process as in a comparison, and counts the resources of this process after each round:
processes, descriptors, temporary folders, memory, and files in shared memory (nothing else may create any meanwhile).
Writes docs/results/robustness.json. Two seconds per trial on an idle core.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import psutil

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.evaluation.hosting.limits import Limits
from gridtrack.evaluation.hosting.outcome import TrialEnded
from gridtrack.evaluation.hosting.tracker_process import TrackerProcess
from gridtrack.trackers.contract import StreamSpec
from gridtrack.trackers.registry import TRACKER_GROUP
from gridtrack.trackers.selection import launch

from studies.support.plugins import every_class, write_distribution
from studies.support.results_file import ResultSection, measured_table, study_parser, write_section

SOURCE = Path("tests/plugins/bad_trackers.py")
FAULTS = (
    *("raises", "exits", "leaves", "kills-itself", "segfaults", "hangs", "stops-the-clock", "closes-its-pipe"),
    *("hogs", "hogs-in-a-child", "hides-in-a-memfd", "forks", "leaves-files", "prints-everywhere", "spams-stderr"),
    *("wrong-shape", "huge-shape", "needs-missing-module"),
)
LIMITS = Limits(update_s=3.0, memory_mb=400)
STREAM = StreamSpec(GridSpec(20, 0.2), 0.125)
TIME_SLACK_S, MEMORY_SLACK_MB, SLACK = 0.5, 256.0, 0.10
RESULTS = Path("docs/results/robustness.json")
COMMAND = "python -m studies.failing_trials"


@dataclass(frozen=True)
class Trial:
    """The outcome of a trial, the duration of its last call, and its peak memory."""

    outcome: str
    last_call_s: float
    peak_mb: float


@contextmanager
def installed(site: Path, temporary: Path) -> Iterator[None]:
    """Register the failing trackers in `site`, for this process and its children; temporary files go to `temporary`."""
    files = {SOURCE.name: SOURCE.read_text("utf-8")}
    write_distribution(site, "failing", every_class(SOURCE), files, group=TRACKER_GROUP)
    search_path, folder = os.environ.get("PYTHONPATH"), tempfile.tempdir
    sys.path.insert(0, str(site))
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, (str(site), search_path)))
    tempfile.tempdir = str(temporary)
    try:
        yield
    finally:
        sys.path.remove(str(site))
        os.environ["PYTHONPATH"] = search_path or ""
        tempfile.tempdir = folder


def options_of(fault: str, folder: Path, number: int) -> Mapping[str, object]:
    """The options of a trial."""
    if fault != "forks":
        return {}
    return {"pid_file": str(folder / str(number)), "how": ("fork", "setsid")[number % 2], "die": number % 3 == 0}


def run_trial(fault: str, options: Mapping[str, object], limits: Limits, log: Path) -> Trial:
    """Three frames and forecasts of a failing tracker."""
    visible = np.ones(STREAM.grid.shape, bool)
    empty = np.zeros((0, 2), np.float32)
    frame = GridFrame(0, visible, ~visible, SE2(), np.zeros((1, 2), np.float32), empty, np.zeros(0, np.uint8))
    process = TrackerProcess(launch(fault), STREAM, options, limits, log)
    outcome, began = "ok", time.monotonic()
    try:
        with process as tracker:
            tracker.reset(0)
            for _ in range(3):
                began = time.monotonic()
                tracker.update(frame)
                tracker.predict(2)
    except TrialEnded as ended:
        outcome = ended.outcome
    return Trial(outcome, time.monotonic() - began, process.peak_rss_mb)


def resources() -> dict[str, float]:
    """The resources that may leak."""
    own = psutil.Process()
    return {
        "processes": len(own.children(recursive=True)),
        "descriptors": own.num_fds(),
        "files in shared memory": len(list(Path("/dev/shm").iterdir())),
        "temporary folders": len(list(Path(tempfile.gettempdir()).iterdir())),
        "memory, MB": own.memory_info().rss / 2**20,
    }


def write_results(path: Path, trials: Mapping[str, list[Trial]], first: dict[str, float], sandbox: bool) -> None:
    """Write the resources, and the outcome of each fault."""
    last = resources()
    left = measured_table(
        ("what", "after a round", "at the end"),
        [[name, *(f"{found[name]:.0f}" for found in (first, last))] for name in first],
    )
    rows = []
    for fault, own in trials.items():
        outcomes = sorted({trial.outcome for trial in own})
        longest_s, peak_mb = max(trial.last_call_s for trial in own), max(trial.peak_mb for trial in own)
        rows.append([f"`{fault}`", str(len(own)), ", ".join(outcomes), f"{longest_s:.2f}", f"{peak_mb:.0f}"])
    faults = measured_table(("tracker", "trials", "outcome", "longest call, s", "largest memory, MB"), rows)
    every = [trial for own in trials.values() for trial in own]
    over_s = [trial.last_call_s - LIMITS.update_s for trial in every if trial.outcome == "timeout"]
    over_mb = [trial.peak_mb - LIMITS.memory_mb for trial in every if trial.outcome == "out-of-memory"]
    kept_s = all(over <= max(SLACK * LIMITS.update_s, TIME_SLACK_S) for over in over_s)
    kept_mb = all(over <= max(SLACK * LIMITS.memory_mb, MEMORY_SLACK_MB) for over in over_mb)
    values = {
        "trials": str(len(every)),
        "time over the limit, s": f"{max(over_s):.2f}" if over_s else "",
        "memory over the limit, MB": f"{max(over_mb):.0f}" if over_mb else "",
        "limits kept": "yes" if kept_s and kept_mb else "no",
    }
    tables = {"left": left, "faults": faults}
    name = "failing trials, sandbox" if sandbox else "failing trials"
    command = f"{COMMAND} --sandbox" if sandbox else COMMAND
    write_section(path, name, ResultSection(command=command, tables=tables, values=values))
    print(left.markdown(), faults.markdown(), values, sep="\n\n")


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__)
    parser.add_argument("--fault", action="append", choices=FAULTS, help="default: all of them")
    parser.add_argument("--trials", type=int, help="default: 28 rounds")
    parser.add_argument("--sandbox", action="store_true", help="confine the trackers")
    parser.add_argument("--results", type=Path, default=RESULTS, help="results file, default: %(default)s")
    given = parser.parse_args(arguments)
    faults = given.fault or FAULTS
    count = 28 * len(faults) if given.trials is None else given.trials
    if count < len(faults):
        parser.error(f"--trials {count}: a round has {len(faults)}")
    limits = LIMITS.model_copy(update={"sandbox": given.sandbox})
    trials: dict[str, list[Trial]] = defaultdict(list)
    first: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as folder:
        site, pids, temporary = (Path(folder, name) for name in ("site", "pids", "temporary"))
        for path in (site, pids, temporary):
            path.mkdir()
        with installed(site, temporary):
            for number in range(count):
                fault = faults[number % len(faults)]
                options = options_of(fault, Path("/tmp") if given.sandbox else pids, number)
                trials[fault].append(run_trial(fault, options, limits, Path(folder, "stderr.log")))
                if number + 1 == len(faults):
                    first = resources()
                if (number + 1) % len(faults) == 0:
                    print(f"{number + 1} of {count}: {resources()}", flush=True)
            write_results(given.results, trials, first, given.sandbox)


if __name__ == "__main__":
    main()

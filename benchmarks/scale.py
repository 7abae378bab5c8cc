"""Cost of a comparison as recordings become many: time, memory and disk, with each engine, and an estimate for more.

`python -m benchmarks.scale [--engine ENGINE]... [--recordings COUNT]... [--out FILE]` (a minute for ten recordings with
an engine on a free core; default: every engine with 1 and 10). Each recording is 20 s long, and the two trackers
compute almost nothing: this measures the cost beside the trackers. `compare` starts the Ray cluster; Slurm is started
for the measurement (Debian: apt install slurmctld slurmd slurm-client munge). The results file keeps earlier
measurements, and the estimate is computed from all of them.
"""

from __future__ import annotations

import math
import os
import resource
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import nullcontext, suppress
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Self

import numpy as np
import psutil

from gridtrack.common.geometry import SE2
from gridtrack.common.scan import Scan
from gridtrack.evaluation.hosting.host import adopt_orphans
from gridtrack.recordings import RecordingInfo, write_native

from studies.support.results_file import (
    ResultSection,
    ResultTable,
    measured_table,
    read_sections,
    study_parser,
    write_section,
)
from studies.support.slurm_machine import slurm_machine

ENGINES = ("local", "ray", "slurm")
TRACKERS = ("persistence", "blank")
RATE_HZ, SECONDS, BEAMS = 10, 20, 120
STRETCHES = {"train": (0.0, 4.0), "validation": (4.0, 9.0), "test": (9.0, None)}
REAP_S = 60.0
SAMPLE_S = 0.5
MB = 1e6
COLUMNS = (
    "engine",
    "recordings",
    "trials",
    "`compare`, s",
    "processor time, all processes, s",
    "of it the comparison's own process, s",
    "memory of the comparison's process, MB",
    "folder of the run, MB",
    "processor time of `report`, s",
    "page, MB",
    "processor time of `regress`, s",
)
SECTION = "cost"
PLAN_RECORDINGS, PLAN_TRACKERS, PLAN_MACHINES, PLAN_CORES = 10_000, 20, 50, 16
"""The plan to estimate; cores per machine."""


@dataclass(frozen=True, slots=True)
class Cost:
    """The cost of a comparison with an engine: seconds and MB, in the order of COLUMNS."""

    engine: str
    recordings: int
    trials: int
    compare_s: float
    processor_s: float
    host_s: float
    """Processor time of the comparison's own process; with `local` also of the trials, which it starts."""
    memory_mb: float
    """Peak of the comparison's own process, or of a larger tracker."""
    folder_mb: float
    report_s: float
    page_mb: float
    regress_s: float

    def row(self) -> list[str]:
        """The row of the table."""
        return [f"{value:.1f}" if isinstance(value, float) else str(value) for value in astuple(self)]

    @classmethod
    def of_row(cls, row: Sequence[str]) -> Cost:
        """The cost in a row of the table."""
        return cls(row[0], int(row[1]), int(row[2]), *map(float, row[3:]))


def scans(number: int) -> Iterator[Scan]:
    """A wall, and in front of it an object 0.3 m wide that moves to and fro, shifted in time in each recording."""
    angles = np.linspace(-math.pi / 3, math.pi / 3, BEAMS)
    for index in range(SECONDS * RATE_HZ):
        ranges = 3.0 / np.cos(angles)
        ranges[np.abs(angles - 0.8 * math.sin(number + index / 12)) < 0.08] = 1.6
        yield Scan(
            stamp_ns=(1 + number) * 1_000_000_000_000 + index * 1_000_000_000 // RATE_HZ,
            ranges=ranges.astype(np.float32),
            angle_min=float(angles[0]),
            angle_increment=float(angles[1] - angles[0]),
            range_min=0.05,
            range_max=8.0,
            world_T_sensor=SE2(0.0, 0.0, 0.0),
        )


def write_recordings(folder: Path, count: int) -> list[Path]:
    """Write `count` recordings into `folder`, one after the other in time."""
    paths = [folder / f"room-{number:05d}.mcap" for number in range(count)]
    info = RecordingInfo(site="room", grid="40x0.2@-1,-4", rate_hz=RATE_HZ, stretches=STRETCHES)
    for number, path in enumerate(paths):
        with path.open("wb") as file:
            write_native(file, info, scans(number))
    return paths


def measure(engine: str, count: int, folder: Path) -> Cost:
    """The cost of a comparison of `count` recordings, its report and its regression check, in an empty `folder`."""
    recordings, run, baseline = write_recordings(folder, count), folder / "run", folder / "baseline.json"
    words = ["compare", "--no-floors", *map(str, recordings), "--horizon", "1s", "--every", "0.5s", "--out", str(run)]
    words += [word for tracker in TRACKERS for word in ("--tracker", tracker)]
    words += ["--engine", engine, *(("--address", "local") if engine == "ray" else ())]
    with Descendants() as descendants:
        with slurm_machine() if engine == "slurm" else nullcontext() as configuration:
            compare_s, usage = _timed(words, **({"SLURM_CONF": str(configuration)} if configuration else {}))
        if engine != "local":
            _reap()
    _, report = _timed(["report", str(run)])
    _timed(["regress", str(run), "--baseline", str(baseline), "--update"])
    _, regress = _timed(["regress", str(run), "--baseline", str(baseline)])
    return Cost(
        engine,
        count,
        count * len(TRACKERS),
        compare_s,
        descendants.processor_s,
        _processor_s(usage),
        usage.ru_maxrss * 1024 / MB,
        _bytes_of(run) / MB,
        _processor_s(report),
        _bytes_of(run / "report") / MB,
        _processor_s(regress),
    )


class Descendants:
    """The processor time of all processes that are started in the block, seconds.

    The kernel adds up the time of processes that are waited for. Ray does not wait for its processes: their time is
    sampled.
    """

    def __init__(self) -> None:
        self.processor_s = 0.0
        self._seen: dict[psutil.Process, float] = {}
        self._left = threading.Event()
        self._sampler = threading.Thread(target=self._sample, daemon=True)

    def __enter__(self) -> Self:
        self._before_s = _processor_s(resource.getrusage(resource.RUSAGE_CHILDREN))
        self._sampler.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._left.set()
        self._sampler.join()
        waited_s = _processor_s(resource.getrusage(resource.RUSAGE_CHILDREN)) - self._before_s
        self.processor_s = max(waited_s, sum(self._seen.values()))

    def _sample(self) -> None:
        while not self._left.wait(SAMPLE_S):
            for process in psutil.Process().children(recursive=True):
                with suppress(psutil.NoSuchProcess):
                    times = process.cpu_times()
                    self._seen[process] = times.user + times.system


def _timed(words: Sequence[str], **environment: str) -> tuple[float, resource.struct_rusage]:
    """Wall time of a command of gridtrack, and the resources that it and its children used."""
    began = time.perf_counter()
    command = [sys.executable, "-m", "gridtrack.cli", *words]
    process = subprocess.Popen(command, env={**os.environ, **environment}, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        raise subprocess.CalledProcessError(process.returncode, command[:4])
    return time.perf_counter() - began, usage


def _reap() -> None:
    """Wait for the processes that a cluster leaves: adopted by this process, so that their time counts."""
    end = time.monotonic() + REAP_S
    while time.monotonic() < end:
        try:
            pid, _ = os.waitpid(-1, os.WNOHANG)
        except ChildProcessError:
            return
        if pid == 0:
            time.sleep(0.1)


def _processor_s(usage: resource.struct_rusage) -> float:
    return usage.ru_utime + usage.ru_stime


def _bytes_of(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def estimate(costs: Sequence[Cost]) -> ResultTable | None:
    """The cost of PLAN_RECORDINGS recordings, by the growth between the two largest sizes of an engine.

    None if there is only one size. The page is left out, because its size is limited.
    """
    local, slurm = ([cost for cost in costs if cost.engine == engine][-2:] for engine in ("local", "slurm"))
    if len(local) < 2 or len(slurm) < 2:
        return None
    trials, cores = PLAN_RECORDINGS * PLAN_TRACKERS, PLAN_MACHINES * PLAN_CORES
    trial_s, host_s = _per_trial(slurm, "processor_s"), _per_trial(slurm, "host_s")
    rows = [
        ["trials", f"{PLAN_RECORDINGS:,} x {PLAN_TRACKERS}", f"{trials:,}"],
        ["core hours of the nodes, slurm", f"{trials:,} x {trial_s:.2f} s", f"{trials * trial_s / 3600:.1f} h"],
        ["time of the nodes, slurm", f"the same / {cores} cores", f"{trials * trial_s / cores / 60:.1f} min"],
        ["the comparison's process, slurm", f"{trials:,} x {host_s:.2f} s", f"{trials * host_s / 3600:.1f} h"],
    ]
    for name, field, unit, scale, shown in (
        ("memory of the comparison's process", "memory_mb", "MB", 1e3, "GB"),
        ("folder of the run", "folder_mb", "MB", 1e3, "GB"),
        ("processor time of `report`", "report_s", "s", 3600.0, "h"),
        ("processor time of `regress`", "regress_s", "s", 3600.0, "h"),
    ):
        slope, measured = _per_trial(local, field), getattr(local[-1], field)
        result = measured + slope * (trials - local[-1].trials)
        arithmetic = f"{measured:.1f} {unit} + {trials - local[-1].trials:,} x {slope:.3f} {unit}"
        rows.append([f"{name}, local", arithmetic, f"{result / scale:.1f} {shown}"])
    return measured_table(("what", "arithmetic", "estimate"), rows)


def _per_trial(two: Sequence[Cost], field: str) -> float:
    """The increase of a cost with each further trial, from a smaller and a larger comparison; never below 0."""
    small, large = two
    return max(0.0, (getattr(large, field) - getattr(small, field)) / (large.trials - small.trials))


def kept_costs(path: Path | None) -> dict[tuple[str, int], Cost]:
    """Earlier measurements, by engine and number of recordings."""
    if path is None or not path.exists():
        return {}
    costs = map(Cost.of_row, read_sections(path)[SECTION].tables["table"].rows)
    return {(cost.engine, cost.recordings): cost for cost in costs}


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__, "docs/results/scale.json")
    parser.add_argument("--engine", action="append", choices=ENGINES)
    parser.add_argument("--recordings", action="append", type=int, metavar="COUNT")
    given = parser.parse_args(arguments)
    adopt_orphans()
    costs = kept_costs(given.out)
    for engine in given.engine or ENGINES:
        for count in given.recordings or (1, 10):
            load = os.getloadavg()[0]
            with tempfile.TemporaryDirectory(prefix="gridtrack-scale-") as folder:
                costs[engine, count] = measure(engine, count, Path(folder))
            print(f"load before: {load:.1f}; {dict(zip(COLUMNS, costs[engine, count].row(), strict=True))}", flush=True)
            if given.out:
                write_costs(given.out, sorted(costs.values(), key=lambda cost: (cost.engine, cost.recordings)))


def write_costs(path: Path, costs: Sequence[Cost]) -> None:
    """Write the measured costs, and the estimate if there are enough."""
    tables = {"table": measured_table(COLUMNS, [cost.row() for cost in costs])}
    table = estimate(costs)
    if table is not None:
        tables["estimate"] = table
    shared = {
        "usable cores": str(len(os.sched_getaffinity(0))),
        "load": f"{os.getloadavg()[0]:.1f}",
        "plan": f"{PLAN_RECORDINGS:,} recordings, {PLAN_TRACKERS} trackers and {PLAN_MACHINES} machines of"
        f" {PLAN_CORES} cores",
    }
    section = ResultSection(command="python -m benchmarks.scale", tables=tables, values=shared)
    write_section(path, SECTION, section)


if __name__ == "__main__":
    main()

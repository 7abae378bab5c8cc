"""Kills of gridtrack, a tracker and a supervisor at random moments: are results lost, are processes or files left?

`python -m studies.kill_points [--points 102] [--engine local]` compares three trackers on two stretches of a hall, once
undisturbed, then once for each kill: a process is killed (SIGKILL) at a random moment of the undisturbed duration, the
processes and temporary files that remain are counted, and `--resume` completes the run, whose files must have the
hashes of the undisturbed run. Writes docs/results/robustness.json. `--engine ray` and `--engine slurm` start a cluster
on this machine. Half a minute per kill on an idle core; Ctrl-C keeps the kills so far, and `--add` adds kills of
another seed.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from gridtrack.evaluation.hosting.host import adopt_orphans
from gridtrack.evaluation.runs.trial_record import read_trial_record

from studies.support.results_file import ResultSection, measured_table, read_sections, study_parser, write_section
from studies.support.slurm_machine import slurm_machine

HALL = "data/leg_tracker/leg_tracker.mcap"
STRETCHES, TRACKERS = ("95s-100s", "105s-110s"), ("persistence", "static-map", "kalman")
VICTIMS = {"gridtrack": "", "a tracker": "gridtrack.trackers.serve", "a supervisor": "supervisor.py"}
"""Words of the command line of each victim; gridtrack is the process that was started."""
COLUMNS = ("killed", "kills", "resumed to equal scores", "processes left", "temporary files left")
GONE_S = 10.0
"""Time for the children of a killed process to end."""
COMPARED = {"outcome", "frames_scored", "delivered", "thresholds"}
"""Parts of a trial's record that must be equal, like the hashes of its files."""
RESULTS = Path("docs/results/robustness.json")
COMMAND = "python -m studies.kill_points"


@dataclass(frozen=True)
class Kill:
    """The effect of one kill: remaining processes and temporary files, and differences of the resumed run."""

    victim: str
    moment_s: float
    processes: int
    files: int
    differs: tuple[str, ...]


def comparison(out: Path, engine: Sequence[str]) -> list[str]:
    """The command of the run in the folder `out`."""
    rows = [word for tracker in TRACKERS for word in ("--tracker", tracker)]
    recordings = [f"{HALL}@{stretch}" for stretch in STRETCHES]
    words = [
        "compare",
        "--no-floors",
        *recordings,
        *rows,
        "--horizon",
        "1s",
        "--every",
        "0.5s",
        "--resume",
        "--out",
        str(out),
    ]
    return [sys.executable, "-m", "gridtrack.cli", *words, *engine]


def start(out: Path, engine: Sequence[str], temporary: Path) -> subprocess.Popen[bytes]:
    """Start the comparison; its temporary files lie below `temporary`."""
    temporary.mkdir(parents=True, exist_ok=True)
    env = os.environ | {"TMPDIR": str(temporary)}
    return subprocess.Popen(comparison(out, engine), env=env, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def complete(out: Path, engine: Sequence[str], temporary: Path) -> dict[str, object]:
    """Complete the comparison; the parts of its trials that must be equal. Ends the program on failure."""
    with start(out, engine, temporary) as host:
        code = host.wait()
    if code:
        raise SystemExit(f"{out}: exit code {code} of `{' '.join(comparison(out, engine))}`")
    records = {path.parent.name: read_trial_record(path.parent) for path in sorted(out.glob("*/outcome.json"))}
    return {
        f"{name}: {part}": value
        for name, record in records.items()
        if record
        for part, value in {**record.model_dump(include=COMPARED), **record.files}.items()
    }


def victim_of(kind: str, host: psutil.Process, above: psutil.Process, until: float) -> psutil.Process | None:
    """A process of the kind, the host or below `above`; waits for one while the host lives."""
    while host.is_running() and host.status() != psutil.STATUS_ZOMBIE and time.monotonic() < until:
        if not VICTIMS[kind]:
            return host
        for process in above.children(recursive=True):
            try:
                if VICTIMS[kind] in " ".join(process.cmdline()):
                    return process
            except psutil.Error:  # it has ended
                continue
        time.sleep(0.005)
    return None


def kill_once(
    kind: str, moment_s: float, out: Path, engine: Sequence[str], steady: int, undisturbed: dict[str, object]
) -> Kill | None:
    """Kill a process of the kind `moment_s` after the start and complete the run; None if there was no such process.

    `steady`: the number of processes below this one that belong to the engine.
    """
    above, temporary = psutil.Process(), out.with_name(f"{out.name}-temporary")
    shutil.rmtree(out, ignore_errors=True)
    with start(out, engine, temporary) as started:
        host = psutil.Process(started.pid)
        time.sleep(moment_s)
        victim = victim_of(kind, host, above, time.monotonic() + 60.0)
        if victim is None:
            started.wait()
            return None
        victim.send_signal(signal.SIGKILL)
        started.wait()
    give_up = time.monotonic() + GONE_S
    while (left := alive(above) - steady) > 0 and time.monotonic() < give_up:
        time.sleep(0.05)
    files = len(list(temporary.iterdir()))
    resumed = complete(out, engine, temporary)
    differs = tuple(name for name in undisturbed if resumed.get(name) != undisturbed[name])
    shutil.rmtree(out)
    shutil.rmtree(temporary)
    return Kill(kind, moment_s, max(0, left), files, differs)


def alive(above: psutil.Process) -> int:
    """The number of processes below `above`, without adopted ones that have ended."""
    count = 0
    for process in above.children(recursive=True):
        try:
            if process.status() == psutil.STATUS_ZOMBIE and process.ppid() == above.pid:
                process.wait(0)
            else:
                count += 1
        except psutil.Error:
            continue
    return count


@contextmanager
def engine_words(engine: str) -> Iterator[list[str]]:
    """The options of the engine; a cluster is started if it needs one."""
    if engine == "local":
        yield ["--jobs", "2"]
        return
    if engine == "slurm":
        with slurm_machine() as configuration:
            os.environ["SLURM_CONF"] = str(configuration)
            yield ["--engine", "slurm"]
        return
    from ray.cluster_utils import Cluster

    cluster: Any = Cluster(initialize_head=True, head_node_args={"num_cpus": 0, "include_dashboard": False})
    for _ in range(2):
        cluster.add_node(num_cpus=1)
    try:
        yield ["--engine", "ray", "--address", cluster.address]
    finally:
        cluster.shutdown()


def write_results(engine: str, kills: Sequence[Kill], add: bool) -> None:
    """Write the table of one engine by victim; with `add` these kills are added to the earlier results."""
    name, rows = f"kills, {engine}", []
    earlier = read_sections(RESULTS)[name].tables["kills"].rows if add else [("0",) * len(COLUMNS)] * len(VICTIMS)
    for kind, before in zip(VICTIMS, earlier, strict=True):
        own = [kill for kill in kills if kill.victim == kind]
        counts = (
            len(own),
            sum(not kill.differs for kill in own),
            sum(kill.processes for kill in own),
            sum(kill.files for kill in own),
        )
        rows.append([kind, *(str(int(one) + count) for one, count in zip(before[1:], counts, strict=True))])
    table = measured_table(COLUMNS, rows)
    section = ResultSection(command=f"{COMMAND} --engine {engine}", tables={"kills": table})
    write_section(RESULTS, name, section)
    print(table.markdown())


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__)
    parser.add_argument("--points", type=int, default=102, help="number of kills, a third for each kind of process")
    parser.add_argument("--engine", choices=("local", "ray", "slurm"), default="local")
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    parser.add_argument("--add", action="store_true", help="add to the results of another --seed")
    given = parser.parse_args(arguments)
    adopt_orphans()
    random = np.random.default_rng(given.seed)
    kills: list[Kill] = []
    with tempfile.TemporaryDirectory() as folder, engine_words(given.engine) as engine:
        # a process that was started in the background ignores Ctrl-C, and Ray ends at a SIGTERM
        for ends in (signal.SIGINT, signal.SIGTERM):
            signal.signal(ends, signal.default_int_handler)
        steady = alive(psutil.Process())
        began = time.monotonic()
        undisturbed = complete(Path(folder, "undisturbed"), engine, Path(folder, "temporary"))
        duration_s = time.monotonic() - began
        with suppress(KeyboardInterrupt):
            while len(kills) < given.points:
                kind, moment_s = list(VICTIMS)[len(kills) % len(VICTIMS)], float(random.uniform(0.0, duration_s))
                kill = kill_once(kind, moment_s, Path(folder, "run"), engine, steady, undisturbed)
                if kill:
                    kills.append(kill)
                    print(f"{len(kills)} of {given.points}: {kill}", flush=True)
        print(f"undisturbed run: {duration_s:.1f} s")
    write_results(given.engine, kills, given.add)


if __name__ == "__main__":
    main()

"""gridtrack from Python: run a comparison, and read a run's folder as tables.

A comparison runs as the command `gridtrack compare` in a process of its own, so that the results are those of the
command line, and no tracker can find a recording's path in the process of a notebook.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict, Unpack

from gridtrack.cli.options import default_report_folder, run_folder_at
from gridtrack.cli.runs import INCOMPLETE
from gridtrack.common.errors import INTERRUPTED_EXIT_CODE, ConfigurationError, GridtrackError
from gridtrack.common.remote_files import is_url
from gridtrack.evaluation.results.run_record import RunRecord
from gridtrack.evaluation.results.summary import RunSummary
from gridtrack.reports.page import render_report, render_tables
from gridtrack.reports.run import read_results
from gridtrack.reports.score_frames import difference_frame, score_frame

if TYPE_CHECKING:
    import polars as pl

ERROR_PREFIX = "gridtrack: "
FORCES_COLOUR = ("FORCE_COLOR", "CLICOLOR_FORCE")
"""A notebook sets them; the progress would come as control characters in place of lines."""
ENDS_WITH_THE_NOTEBOOK = f"""
from gridtrack.evaluation.hosting.supervisor import PR_SET_PDEATHSIG, prctl
prctl(PR_SET_PDEATHSIG, {signal.SIGTERM:d})
from gridtrack.cli import main
main()
"""
"""The command line, as a program that is asked to end where the process that started it dies."""


class CompareOptions(TypedDict, total=False):
    """The options of `gridtrack compare` (`gridtrack compare --help`); durations and stretches as there, as text."""

    validation: str | Path
    reference: str
    horizon: str
    every: str
    segment: str
    warm_up: str
    grid: str
    rate: float
    jobs: int
    engine: str
    address: str
    slurm: str
    threads: int
    memory: int
    start_timeout: str
    update_timeout: str
    predict_timeout: str
    sandbox: bool
    seed: int
    weights: str | Path
    trackers_toml: str | Path
    resume: bool
    allow_leak: bool
    latency: bool
    deadline: bool
    degrade: str


@dataclass(frozen=True, repr=False)
class Run:
    """The folder of a run: its record, its results, and both as tables."""

    path: Path
    record: RunRecord
    """What was compared: the resolved configuration, versions, machine, hashes of inputs."""
    summary: RunSummary
    """All results, typed (docs/run-folder.md)."""
    url: str = ""
    """Where the run is in a store, of which `path` is the local copy."""

    @classmethod
    def load(cls, path: str | Path) -> Run:
        """Read the folder of a run that has ended, or its URL, of which a local copy is read.

        Raises GridtrackError for another folder, damaged files, or a store that cannot be read.
        """
        folder = run_folder_at(str(path))
        return cls(folder, *read_results(folder), url=str(path) if is_url(str(path)) else "")

    @cached_property
    def scores(self) -> pl.DataFrame:
        """Every score, a row for each recording, tracker, stratum and step, pooled ones as "all recordings".

        Columns: `recording`, `tracker` (its label), `outcome`, `stratum`, `step`, `horizon_s`, and each score of
        docs/scores.md by its name in summary.json, with the ends of its 95 % interval (`f1`, `f1_low`, `f1_high`, ...).
        Null where a score is undefined, or has no interval.
        """
        return score_frame(self.summary)

    @cached_property
    def differences(self) -> pl.DataFrame:
        """Paired differences from the reference at the headline horizons, a row for each test, with its verdict.

        Columns: `recording`, `tracker`, `reference`, `units`, and those of the test: `stratum`, `horizon_s`, `f1`,
        `f1_low`, `f1_high`, `f1_p`, `p_holm`, `verdict`, and the same of other scores.
        """
        return difference_frame(self.summary)

    def report(self, out: str | Path | None = None, recordings: str = "") -> Path:
        """Write the report page into the folder `out`, and return its path.

        Without `out` it is the run's own folder, or for a run in a store `NAME-report` in the working folder.
        `recordings`: names of those that the page shows, separated by commas, with `*` and `?`; empty: as many as fit.
        """
        folder = Path(out) if out is not None else default_report_folder([self._named])
        return render_report([self.path], folder, recordings)

    @property
    def _named(self) -> str:
        return self.url or str(self.path)

    def __repr__(self) -> str:
        return f"Run('{self._named}': {', '.join(self.summary.trackers)} on {', '.join(self.summary.recordings)})"

    def _repr_html_(self) -> str:
        """The main tables, for a notebook."""
        return render_tables(self.path)


def compare(
    *recordings: str | Path,
    trackers: str | Sequence[str] = (),
    out: str | Path = "runs/latest",
    **options: Unpack[CompareOptions],
) -> Run:
    """Run trackers on recordings, as `gridtrack compare` does, and return the run; its progress is printed to stderr.

    `recordings` as RECORDING[@RANGE], `trackers` as [LABEL=]NAME[:KEY=VALUE,...], one or several; none: every
    registered one. Trials that failed are in the run, with their outcomes. Raises GridtrackError with the reason where
    nothing was compared, and KeyboardInterrupt after an interrupt; `Run.load(out)` then has what was scored.
    """
    rows = [trackers] if isinstance(trackers, str) else trackers
    words = [*map(str, recordings), *(word for row in rows for word in ("--tracker", row))]
    words += ["--out", str(out), *_as_words(options)]
    code, reason = _run_command(["compare", *words])
    if code == INTERRUPTED_EXIT_CODE:
        raise KeyboardInterrupt
    if code not in (0, INCOMPLETE):
        raise GridtrackError(reason or f"gridtrack compare ended with code {code}")
    return Run.load(out)


def _as_words(options: CompareOptions) -> Iterator[str]:
    """The options as on the command line. Raises ConfigurationError for one that `compare` does not have."""
    for name, value in options.items():
        if name not in CompareOptions.__annotations__:
            known = ", ".join(CompareOptions.__annotations__)
            raise ConfigurationError(f"compare has no option '{name}'; it has {known}")
        option = f"--{name.replace('_', '-')}"
        if value is True:
            yield option
        elif value is not False and value is not None:
            yield from (option, str(value))


def _run_command(words: Sequence[str]) -> tuple[int, str]:
    """Run gridtrack's command line; its exit code, and the reason where it printed one. An interrupt is passed on.

    It has a session of its own: a terminal and Jupyter send an interrupt to the whole group of this process, and a
    second one makes the command lose the scores of the trials that run.
    """
    command = [sys.executable, "-c", ENDS_WITH_THE_NOTEBOOK, *words]
    environment = {name: value for name, value in os.environ.items() if name not in FORCES_COLOUR}
    with subprocess.Popen(
        command,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
        env=environment,
        start_new_session=True,
    ) as process:
        reason, interrupted = _relayed(process)
    if interrupted:
        raise KeyboardInterrupt
    return process.returncode, reason


def _relayed(process: subprocess.Popen[str]) -> tuple[str, bool]:
    """Print what the command prints until it ends; the reason where it printed one, and whether it was interrupted."""
    reason, interrupted = "", False
    while True:
        try:
            for line in process.stderr or ():
                reason = line.removeprefix(ERROR_PREFIX).strip() if line.startswith(ERROR_PREFIX) else reason
                sys.stderr.write(line)
            process.wait()
        except KeyboardInterrupt:
            interrupted = True
            process.send_signal(signal.SIGINT)
        else:
            return reason, interrupted

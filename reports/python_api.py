"""gridtrack from Python: run a comparison, and read the folder of a run as tables."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import polars as pl
from rich.console import Console

from gridtrack.common.errors import printable
from gridtrack.common.remote_files import folder_name, is_url, local_folder
from gridtrack.evaluation.hosting.host import shielded_host
from gridtrack.evaluation.runs.run_record import RunRecord
from gridtrack.evaluation.runs.summary import PointEstimate, RunSummary
from gridtrack.reports.comparison import comparison
from gridtrack.reports.page import render_report, render_tables
from gridtrack.reports.run import output_name, read_results, shown_summary


@dataclass(frozen=True, repr=False)
class Run:
    """The folder of a run: its record, its results, and both as tables."""

    path: Path
    record: RunRecord
    """The record of the comparison: the resolved configuration, versions, machine, hashes of inputs."""
    summary: RunSummary
    """All results, typed (docs/run-folder.md)."""
    url: str = ""
    """The URL of a run in a store; `path` is then its local copy."""

    @classmethod
    def load(cls, path: str | Path) -> Run:
        """Read the folder of a run that has ended, or a local copy of the run at a URL.

        Raises GridtrackError for another folder, damaged files, or a store that cannot be read.
        """
        folder = local_folder(str(path), "runs", _print_note)
        return cls(folder, *read_results(folder), url=str(path) if is_url(str(path)) else "")

    @cached_property
    def scores(self) -> pl.DataFrame:
        """Every score, a row for each recording, tracker, stratum and step; pooled scores have "all recordings".

        Columns: `recording`, `tracker` (its label), `outcome`, `stratum`, `step`, `horizon_s`, and each score of
        docs/scores.md by its name in summary.json, with the ends of its 95 % interval (`f1`, `f1 low`, `f1 high`, ...).
        Null if a score is undefined, or has no interval.
        """
        return score_frame(self.summary)

    @cached_property
    def differences(self) -> pl.DataFrame:
        """Paired differences from the reference at the headline horizons, a row for each test, with its verdict.

        Columns: `recording`, `tracker`, `reference`, `units`, and the results of the test: `stratum`, `horizon_s`,
        `f1`, `f1 low`, `f1 high`, `f1 p`, `p_holm`, `verdict`, and the same of other scores.
        """
        return difference_frame(self.summary)

    def report(self, out: str | Path | None = None, recordings: str = "") -> Path:
        """Write the report page into the folder `out`, and return its path.

        Without `out` it is the run's own folder, or for a run in a store `NAME-report` in the working folder.
        `recordings`: names of the recordings on the page, separated by commas, with `*` and `?`; empty: as many as fit.
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


def compare(*recordings: str | Path, trackers: str | Sequence[str] = (), **settings: Any) -> Run:
    """Run trackers on recordings, as `gridtrack compare` does, and return the run; its progress is printed to stderr.

    `recordings` as RECORDING[@RANGE], `trackers` as [LABEL=]NAME[:KEY=VALUE,...], one or several; none: every
    registered one. `settings` are the other fields of `CompareSettings`: out, horizon_s, every_s, limits, ... Trackers
    run in their own processes, and everything else in this one, which other processes cannot read meanwhile. Failed
    trials are in the run, with their outcomes. Raises GridtrackError if nothing can be compared, and KeyboardInterrupt
    after an interrupt; `Run.load` then has the scores so far.
    """
    values = {
        "recordings": [str(recording) for recording in recordings],
        "trackers": [trackers] if isinstance(trackers, str) else list(trackers),
        **settings,
    }
    # a notebook asks for colours, and bars would come as control characters
    console = Console(stderr=True, force_jupyter=False, force_terminal=sys.stderr.isatty())
    with shielded_host("gridtrack compare", alone=False), comparison(values, _print_note, console=console) as done:
        interrupted, out = done.interrupted, done.out
    if interrupted:
        raise KeyboardInterrupt
    return Run.load(out)


def default_report_folder(runs: Sequence[str]) -> Path | None:
    """The default folder of a report: for a run in a store `NAME-report` in the working folder, for several runs
    `NAME-side-by-side`; None: the run's own folder."""
    if not is_url(runs[0]):
        return None
    return Path(f"{folder_name(runs[0])}-{'report' if len(runs) == 1 else 'side-by-side'}")


def _print_note(line: str) -> None:
    print(f"gridtrack: {printable(line)}", file=sys.stderr)


def score_frame(summary: RunSummary) -> pl.DataFrame:
    """Every score, a row for each recording, tracker, stratum and step; pooled scores have "all recordings".

    A column for each output, `f1` or `f1.recall`, and `... low` and `... high` for the ends of its interval.
    """
    shown = shown_summary(summary)
    keys = {"recording": pl.String, "tracker": pl.String, "outcome": pl.String, "stratum": pl.String}
    names = [output_name(*one) for one in shown.outputs]
    values = {f"{name}{end}": pl.Float64 for name in names for end in ("", " low", " high")}
    schema = {**keys, "step": pl.Int64, "horizon_s": pl.Float64, **values}
    return pl.DataFrame(list(_score_rows(shown)), schema=schema, orient="row")


def _score_rows(shown: RunSummary) -> Iterator[tuple[Any, ...]]:
    keys = [(score.name, output.name) for score, output in shown.outputs]
    for label, row in shown.trackers.items():
        for recording, trial in row.recordings.items():
            for stratum in trial.strata:
                for step, horizon_s in enumerate(shown.recordings[recording].horizons_s):
                    points = (trial.at(stratum, *key, step) for key in keys)
                    values = (value for one in points for value in (one.value, one.low, one.high))
                    yield recording, label, trial.outcome, stratum, step, horizon_s, *values


def difference_frame(summary: RunSummary) -> pl.DataFrame:
    """The headline tests, a row each: a tracker against the reference on a recording, or on all.

    Columns: `recording`, `tracker`, `reference`, `units`, `stratum`, `horizon_s`, `step`, `p_holm` and `verdict` of the
    headline score, and of each tested output the difference, `... low`, `... high` and its uncorrected `... p`.
    """
    tested = [(score, output) for score, output in summary.outputs if output.tested]
    texts = ("recording", "tracker", "reference", "stratum", "verdict")
    columns = ("recording", "tracker", "reference", "units", "stratum", "horizon_s", "step", "p_holm", "verdict")
    schema: dict[str, Any] = {
        name: pl.String if name in texts else pl.Int64 if name in ("units", "step") else pl.Float64 for name in columns
    }
    schema |= {f"{output_name(*one)}{end}": pl.Float64 for one in tested for end in ("", " low", " high", " p")}
    rows = [
        (
            *(one.recordings, one.tracker, one.reference, one.units),
            *(test.stratum, test.horizon_s, test.step, test.p_holm, test.verdict),
            *_values(one.at(test.stratum, score.name, output.name, test.step) for score, output in tested),
        )
        for one in summary.differences
        for test in one.tests
    ]
    return pl.DataFrame(rows, schema=schema, orient="row")


def _values(points: Iterable[PointEstimate]) -> Iterator[float | None]:
    for one in points:
        yield from (one.value, one.low, one.high, one.p)

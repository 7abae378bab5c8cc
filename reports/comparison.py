"""A comparison from its settings to its report, as the command line and Python run it."""

from __future__ import annotations

import json
import re
import shlex
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console

from gridtrack.common.config import validated
from gridtrack.common.errors import INTERRUPTED_EXIT_CODE, printable
from gridtrack.common.options import option_words
from gridtrack.common.remote_files import URL, is_url, local_folder
from gridtrack.evaluation.runs.following import following
from gridtrack.evaluation.runs.plan import ComparisonPlan, resolve
from gridtrack.evaluation.runs.runner import run
from gridtrack.evaluation.runs.settings import CompareSettings
from gridtrack.evaluation.runs.stored_run import stored_run
from gridtrack.evaluation.runs.summary import RunSummary, TrialSummary
from gridtrack.evaluation.runs.trial_record import missing_measurements, read_trial_record
from gridtrack.recordings.stretches import fetched
from gridtrack.reports.page import render_report
from gridtrack.reports.run_progress import LiveTable, RunProgress

INCOMPLETE = 3
"""Exit code if a trial is not complete, or lacks a requested measurement."""
ROW_WEIGHTS_URL = re.compile(rf'(?<=[:,])\s*weights\s*=\s*("?)(?P<url>{URL.pattern}[^",]*)\1')
"""`weights=URL` among the options of a tracker."""


@dataclass(frozen=True)
class Comparison:
    """A comparison that has ended; its run and its report are in `folder`."""

    folder: Path
    summary: RunSummary
    interrupted: bool
    not_measured: bool = False
    """A complete trial lacks a requested measurement, or no cell was occupied on a recording."""
    out: str = ""
    """The folder as the user named it, or its URL."""

    @property
    def report(self) -> str:
        """The path of the report page, or its URL."""
        return f"{self.out.rstrip('/')}/report/index.html"

    @property
    def exit_code(self) -> int:
        """0 if every trial is complete and has the requested measurements."""
        if self.interrupted:
            return INTERRUPTED_EXIT_CODE
        trials = (trial for row in self.summary.trackers.values() for trial in row.recordings.values())
        complete = not self.not_measured and all(trial.outcome == "ok" for trial in trials)
        return 0 if complete else INCOMPLETE


@contextmanager
def comparison(
    values: Mapping[str, Any],
    note: Callable[[str], None],
    command: Sequence[str] | None = None,
    console: Console | None = None,
) -> Iterator[Comparison]:
    """Run a comparison with the settings `values`, by field of CompareSettings, and write its report.

    Recordings, weights and the folder of the run may be URLs: the run of a URL is uploaded when the block ends, and its
    local folder is then removed. `command` is stored with the results; None: the command line of these settings.
    Progress is shown on `console`, by default stderr. Raises GridtrackError if nothing can be compared.
    """
    out = str(values.get("out", CompareSettings.model_fields["out"].default))
    local = {name: value for name, value in local_values(values, note).items() if name != "out" or not is_url(out)}
    settings = validated(CompareSettings, local, "gridtrack compare")
    command = command or ["gridtrack", "compare", *option_words(CompareSettings, values)]
    with _run_folder(out, settings, command, note) as folder:
        settings = settings.model_copy(update={"out": folder})
        ended = (_follow if settings.follow else _run)(settings, command, note, console)
        yield replace(ended, out=out)


def local_values(values: Mapping[str, Any], note: Callable[[str], None]) -> dict[str, Any]:
    """`values` with local copies in place of the URLs of recordings and weights. Raises StoreError."""
    fetch: dict[str, Callable[[str], Any]] = {
        "recordings": partial(fetched, note=note),
        "trackers": partial(_with_local_weights, note=note),
        "validation": partial(fetched, note=note),
        "weights": partial(local_folder, kind="weights", note=note),
    }

    def local(name: str, value: Any) -> Any:
        if name in fetch and isinstance(value, list | tuple):
            return [local(name, one) for one in value]
        return fetch[name](value) if name in fetch and isinstance(value, str) else value

    return {name: local(name, value) for name, value in values.items()}


def _with_local_weights(row: str, note: Callable[[str], None]) -> str:
    """[LABEL=]NAME[:KEY=VALUE,...] with a local copy in place of the URL of weights. Raises StoreError."""

    def local(match: re.Match[str]) -> str:
        return f"weights={json.dumps(str(local_folder(match['url'], 'weights', note)), ensure_ascii=False)}"

    return ROW_WEIGHTS_URL.sub(local, row)


def _run_folder(
    out: str, settings: CompareSettings, command: Sequence[str], note: Callable[[str], None]
) -> AbstractContextManager[Path]:
    """The local folder in which the run is made; the folder of a run in a store is uploaded at the end."""
    if not is_url(out):
        return nullcontext(settings.out)
    resume = shlex.join(command if settings.resume else [*command, "--resume"])
    return stored_run(out, resume=settings.resume, again=None if settings.follow else resume, note=note)


def _run(
    settings: CompareSettings, command: Sequence[str], note: Callable[[str], None], console: Console | None
) -> Comparison:
    """Compare on finished recordings."""
    plan = resolve(settings, note=note)
    with RunProgress(console) as progress:
        summary = run(plan, command, progress)
        render_report([settings.out])
    not_measured = not summary.interrupted and _note_missing(plan, summary, note)
    return Comparison(plan.settings.out, summary, summary.interrupted, not_measured)


def _follow(
    settings: CompareSettings, command: Sequence[str], note: Callable[[str], None], console: Console | None
) -> Comparison:
    """Compare on a recording that is still being written."""
    with following(settings, note=lambda text: print(printable(text), file=sys.stderr)) as followed:
        with LiveTable(console) as table:
            followed.follow(table)
        with RunProgress(console) as progress:
            summary = followed.finish(command, progress)
            render_report([settings.out])
    return Comparison(settings.out, summary, summary.interrupted or followed.interrupted)


def _note_missing(plan: ComparisonPlan, summary: RunSummary, note: Callable[[str], None]) -> bool:
    """Note each recording without an occupied cell, and each requested measurement that a complete trial lacks. Returns
    whether there are any."""
    records = [read_trial_record(plan.settings.out / trial.name) for trial in plan.trials]
    complete = [record for record in records if record and record.outcome == "ok"]
    missing = [line for record in complete for line in missing_measurements(plan.settings, record)]
    missing += [
        f"{name}: no cell was occupied in any scored frame: `gridtrack recording info` shows whether the laser measured"
        " anything, and --grid sets the window around it"
        for name in summary.recordings
        if _nothing_occupied([row.recordings[name] for row in summary.trackers.values() if name in row.recordings])
    ]
    for line in missing:
        note(f"not measured: {line}")
    return bool(missing)


def _nothing_occupied(trials: Sequence[TrialSummary]) -> bool:
    """Whether trials of one recording were scored, but F1 is undefined at every step: no cell was occupied."""
    curves = [found.value for trial in trials if (found := trial.estimate("visible", "f1", "f1")) is not None]
    return bool(curves) and all(value is None for curve in curves for value in curve)

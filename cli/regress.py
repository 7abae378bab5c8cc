"""`regress`: whether a run is worse than a baseline, for continuous integration."""

from __future__ import annotations

import json
import sys
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import typer

from gridtrack.cli.options import DEBUG_OPTION, JsonOption, TrackersTomlOption, run_folder_at, settings_options
from gridtrack.common.config import validated
from gridtrack.common.errors import ConfigurationError, GridtrackError, one_line, printable
from gridtrack.common.files import naming_full_disk, write_text
from gridtrack.evaluation.regression.baseline import BaselineError, baseline_of, read_baseline, write_baseline
from gridtrack.evaluation.regression.confirmation import confirmed
from gridtrack.evaluation.regression.history import (
    History,
    HistoryEntry,
    digest_of_frames,
    judged_by_history,
    new_entry,
    read_history,
    require_newest,
    since_best,
    since_first,
    write_entry,
)
from gridtrack.evaluation.regression.measurement import Baseline, Measurement, Unmeasured
from gridtrack.evaluation.regression.measuring import measure_run
from gridtrack.evaluation.regression.rerun import Trials, run_again
from gridtrack.evaluation.regression.settings import GateSettings
from gridtrack.evaluation.regression.turns import timed_in_turns
from gridtrack.evaluation.regression.verdict import Verdict, compare_with_baseline
from gridtrack.reports.history import history_svg
from gridtrack.reports.run_progress import RunProgress
from gridtrack.reports.verdict_tables import data_of, junit_of, junit_of_unmeasured, markdown_of, markdown_of_unmeasured
from gridtrack.reports.verdict_text import text_of, text_of_update
from gridtrack.trackers.selection import Launch, launch, read_trackers_toml

app = typer.Typer(add_completion=False)
WORSE, UNMEASURED = 1, 3
MAX_CRASH_CHARS = 300
"""Length limit of the description of an unexpected error."""


@app.command()
@settings_options(GateSettings)
def regress_command(
    values: dict[str, Any],
    runs: Annotated[
        list[Path],
        typer.Argument(
            metavar="RUN",
            help="A run's folder, or its URL; with --update several, one for each training or seed",
            parser=run_folder_at,
        ),
    ],
    baseline: Annotated[Path, typer.Option(metavar="FILE", help="The baseline")],
    update: Annotated[bool, typer.Option("--update", help="Write the run, or several, as the new baseline")] = False,
    junit: Annotated[Path | None, typer.Option(metavar="FILE", help="Write the verdict as JUnit XML")] = None,
    markdown: Annotated[Path | None, typer.Option(metavar="FILE", help="Write the verdict as Markdown")] = None,
    confirm: Annotated[
        bool, typer.Option("--confirm", help="Run worse rows a second time; a row is worse if it is worse again")
    ] = False,
    speed_base: Annotated[
        list[str] | None,
        typer.Option(metavar="LABEL=NAME", help="Time a tracker of the run in turns with the tracker NAME, its base"),
    ] = None,
    trackers_toml: TrackersTomlOption = None,
    history: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Judge by the best entry of this folder too, add the verdict to it, and draw scores over commits",
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Compare a run with a baseline: is any tracker worse?

    A baseline of several trainings has their spread too. Exit code:
    0 no tracker is worse
    1 a tracker is worse
    2 wrong use
    3 not measured: a trial failed, is missing, or has no partner in the baseline
    """
    _refuse_contradictions(
        values,
        runs,
        update,
        {"--confirm": confirm, "--speed-base": speed_base, "--junit": junit, "--markdown": markdown, "--json": as_json},
    )
    settings = validated(GateSettings, values, "gridtrack regress")
    if trackers_toml and not (speed_base or confirm):
        raise ConfigurationError("--trackers-toml: it is for the programs that --speed-base or --confirm starts")
    starting = Starting(confirm, _bases(speed_base or (), trackers_toml), trackers_toml)
    past, reports = Past(history, read_history(history)) if history else None, Reports(junit, markdown, as_json)
    raise typer.Exit(_check(runs, baseline, settings, None if update else starting, past, reports))


def _check(
    runs: Sequence[Path],
    baseline: Path,
    settings: GateSettings,
    starting: Starting | None,
    past: Past | None,
    reports: Reports,
) -> int:
    """Judge a run and report the verdict, or without `starting` write a new baseline. Returns the exit code."""
    try:
        if starting is None:
            _update_baseline(runs, baseline, settings, past)
            return 0
        stored = read_baseline(baseline)
        verdict = _judge(runs[0], stored, settings, starting, past)
        reports.write(verdict)
    except Exception as error:
        reasons = _reasons_unmeasured(error)
        if not reasons:
            raise
        reports.write_unmeasured(reasons)
        if past and starting:
            past.add(new_entry(past.entries, baseline, reasons))
        return UNMEASURED
    if past:
        past.add(new_entry(past.entries, baseline, verdict, digest_of_frames(stored)))
    return WORSE if verdict.worse else 0


def _refuse_contradictions(
    values: Mapping[str, Any], runs: Sequence[Path], update: bool, only_judging: Mapping[str, object]
) -> None:
    """Raises ConfigurationError for options that exclude or need each other."""
    if "speed_margin" in values and "speed_reference" not in values and not only_judging["--speed-base"]:
        raise ConfigurationError(
            "--speed-margin: speed is judged only with --speed-reference LABEL or --speed-base LABEL=NAME"
        )
    if update and (given := next((option for option, value in only_judging.items() if value), None)):
        raise ConfigurationError(f"{given}: --update judges nothing; leave one of the two out")
    if len(runs) > 1 and not update:
        raise ConfigurationError(f"{len(runs)} runs: one is judged at a time; --update makes a baseline of several")


@dataclass(frozen=True)
class Past:
    """The history of a check: its folder and its entries."""

    folder: Path
    entries: History

    def add(self, entry: HistoryEntry) -> None:
        """Write an entry, and draw the history again."""
        path = write_entry(self.folder, entry)
        drawing = self.folder / "history.svg"
        try:
            write_text(drawing, history_svg([*(earlier for _, earlier in self.entries), entry]))
            drawn = f"drawing: {drawing}"
        except ConfigurationError as error:
            drawn = f"no drawing: {error}"
        typer.echo(f"history: {path}; {drawn}", err=True)


def _update_baseline(runs: Sequence[Path], baseline: Path, settings: GateSettings, past: Past | None) -> None:
    """Write `runs` as the baseline. Print its content, the scores worse than in the replaced baseline, and with a
    history the changes since its first and its best entry."""
    if len({run.resolve() for run in runs}) < len(runs):
        raise ConfigurationError("a run is given twice: each run of a baseline is a training or a seed of its own")
    first = measure_run(runs[0], None, settings.scores)
    new = baseline_of([first, *(measure_run(run, first, settings.scores) for run in runs[1:])])
    stored = _replaced(baseline)
    replaced = _against_replaced(runs[0], stored, settings) if isinstance(stored, Baseline) else stored
    if past is None:
        kept = stored.history if isinstance(stored, Baseline) else ""
        write_baseline(baseline, new.model_copy(update={"history": kept}))
        typer.echo(text_of_update(baseline, new, replaced, {}))
        return
    verdict = compare_with_baseline(new, first, GateSettings(scores=settings.scores))
    means = tuple(replace(row, run=row.baseline) for row in verdict.rows)
    frames = digest_of_frames(new)
    since = {
        which: [found for row in means if (found := of(past.entries, frames, row))]
        for which, of in (("first", since_first), ("best", since_best))
    }
    entry = new_entry(past.entries, baseline, replace(verdict, rows=means), frames, update=True)
    write_baseline(baseline, new.model_copy(update={"history": entry.digest}))
    typer.echo(text_of_update(baseline, new, replaced, since))
    past.add(entry)


def _replaced(baseline: Path) -> Baseline | str | None:
    """The replaced baseline, or why it cannot be read; None if there is none."""
    try:
        return read_baseline(baseline) if baseline.exists() else None
    except (BaselineError, Unmeasured) as reason:
        return str(reason)


def _against_replaced(run: Path, stored: Baseline, settings: GateSettings) -> Verdict | str:
    """The verdict on the run by the replaced baseline, or why there is none."""
    try:
        return _judge(run, stored, GateSettings(scores=settings.scores), Starting(), past=None)
    except Unmeasured as reason:
        return str(reason)


@dataclass(frozen=True)
class Starting:
    """The trackers that a check starts, with programs only from the user's `trackers_toml`.

    `confirm`: repeat worse rows. `bases`: by label, the tracker to time in turns with it.
    """

    confirm: bool = False
    bases: Mapping[str, Launch] = field(default_factory=dict)
    trackers_toml: Path | None = None


def _judge(run: Path, stored: Baseline, settings: GateSettings, starting: Starting, past: Past | None) -> Verdict:
    """The verdict on the run in the folder `run`, by a baseline and the best entry of a history."""
    if past:
        require_newest(past.folder, past.entries, stored)
    measured = measure_run(run, stored.first, settings.scores)
    verdict = compare_with_baseline(stored, measured, settings)
    if starting.confirm:

        def again(trials: Trials, timed: bool) -> list[Measurement]:
            with RunProgress() as progress:
                return run_again(run, trials, stored.first, timed, progress, settings.scores, starting.trackers_toml)

        verdict = confirmed(verdict, stored, measured, settings, again)
    if past:
        verdict = judged_by_history(verdict, past.entries, digest_of_frames(stored))
    if not starting.bases:
        return verdict
    turns = timed_in_turns(run, starting.bases, settings.turns_margin, starting.trackers_toml)
    return replace(verdict, turns=turns)


def _bases(texts: Sequence[str], trackers_toml: Path | None) -> dict[str, Launch]:
    """The base of each label in `LABEL=NAME`. Raises ConfigurationError and PluginError."""
    external = read_trackers_toml(trackers_toml) if trackers_toml else None
    bases: dict[str, Launch] = {}
    for text in texts:
        label, equals, name = text.rpartition("=")
        if not equals or not label or label in bases:
            raise ConfigurationError(f"--speed-base '{text}': expected LABEL=NAME, each label once")
        bases[label] = launch(name, external)
    return bases


def _reasons_unmeasured(error: Exception) -> Sequence[str]:
    """Why there is no verdict, one line each; none if `error` is wrong use, which the command line reports.

    A crash is a reason: its exit code must not be 1, which means worse. `--debug` prints its traceback.
    """
    if isinstance(error, Unmeasured):
        return error.reasons
    # an OSError with a file name is a path in an option that cannot be read or written
    if isinstance(error, GridtrackError) or (isinstance(error, OSError) and error.filename):
        return ()
    if DEBUG_OPTION in sys.argv:
        traceback.print_exception(error)
    crash = one_line(f"{type(error).__name__}: {error}", MAX_CRASH_CHARS)
    return [f"regress failed ({crash}); {DEBUG_OPTION} shows the traceback"]


@dataclass(frozen=True)
class Reports:
    """The outputs of a check: on the terminal as text or JSON, and in files."""

    junit: Path | None
    markdown: Path | None
    as_json: bool

    def write(self, verdict: Verdict) -> None:
        """Print a verdict and write its files."""
        _write_report(self.junit, junit_of, verdict)
        _write_report(self.markdown, markdown_of, verdict)
        typer.echo(json.dumps(data_of(verdict), indent=1) if self.as_json else text_of(verdict))

    def write_unmeasured(self, reasons: Sequence[str]) -> None:
        """Print the reasons why there is no verdict, and write them to the files."""
        _write_report(self.junit, junit_of_unmeasured, reasons)
        _write_report(self.markdown, markdown_of_unmeasured, reasons)
        if self.as_json:
            typer.echo(json.dumps({"verdict": "not measured", "reasons": list(reasons)}, indent=1))
        for reason in reasons:
            typer.echo(f"gridtrack: not measured: {printable(reason)}", err=True)


def _write_report(path: Path | None, rendered: Callable[[Any], str], content: Any) -> None:
    """Write to `path`; a pipe or a device, such as /dev/stdout, cannot be replaced and is written in place."""
    if path is None:
        return
    if path.exists() and not path.is_file():
        with naming_full_disk(path):
            path.write_text(rendered(content), "utf-8")
    else:
        write_text(path, rendered(content))

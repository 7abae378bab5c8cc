"""`regress`: whether a run is worse than a baseline, for continuous integration."""

from __future__ import annotations

import json
import sys
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gridtrack.cli.options import DEBUG_OPTION, JsonOption, TrackersTomlOption, run_folder_at
from gridtrack.common.errors import ConfigurationError, GridtrackError, one_line, printable

if TYPE_CHECKING:
    from gridtrack.evaluation.regression.history import History
    from gridtrack.evaluation.regression.measurement import Baseline, Measurement
    from gridtrack.evaluation.regression.settings import GateSettings
    from gridtrack.evaluation.regression.speed import TurnsRow
    from gridtrack.evaluation.regression.verdict import Verdict
    from gridtrack.trackers.selection import Launch

WORSE, UNMEASURED = 1, 3
MAX_CRASH_CHARS = 300
"""Length limit of the description of an unexpected error."""


def regress_command(
    runs: Annotated[
        list[Path],
        typer.Argument(
            metavar="RUN...",
            help="A run's folder, or its URL; with --update several, one for each training or seed",
            parser=run_folder_at,
        ),
    ],
    baseline: Annotated[Path, typer.Option(help="The baseline's file")],
    margin: Annotated[
        float | None,
        typer.Option(help="The largest fall in F1 that is not worse; of log loss, 10 times it as a share"),
    ] = None,
    tolerance: Annotated[
        list[str] | None, typer.Option(metavar="LABEL=F1", help="The margin of one tracker, such as a learned one")
    ] = None,
    update: Annotated[bool, typer.Option(help="Write the run, or several, as the new baseline")] = False,
    junit: Annotated[Path | None, typer.Option(help="Write the verdict as JUnit XML")] = None,
    markdown: Annotated[Path | None, typer.Option(help="Write the verdict as Markdown")] = None,
    speed_reference: Annotated[
        str | None, typer.Option(metavar="LABEL", help="Judge speed too, as a ratio to this tracker's times")
    ] = None,
    speed_margin: Annotated[
        float | None, typer.Option(help="The largest growth of that ratio that is not worse")
    ] = None,
    confirm: Annotated[
        bool, typer.Option("--confirm", help="Run what looks worse a second time; it is worse if it is worse again")
    ] = False,
    speed_base: Annotated[
        list[str] | None,
        typer.Option(metavar="LABEL=NAME", help="Time a tracker of the run in turns with the tracker NAME, its base"),
    ] = None,
    trackers_toml: TrackersTomlOption = None,
    history: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Add the verdict to this folder, and draw scores over commits")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Compare a run with a baseline: is any tracker worse? A baseline of several trainings holds their spread too.

    Exit code: 0 no worse, 1 worse, 2 wrong use, 3 not measured: a trial failed, is missing, or does not pair.
    """
    if speed_margin is not None and speed_reference is None and not speed_base:
        raise ConfigurationError(
            "--speed-margin: speed is judged only with --speed-reference LABEL or --speed-base LABEL=NAME"
        )
    if len(runs) > 1 and not update:
        raise ConfigurationError(f"{len(runs)} runs: one is judged at a time; --update makes a baseline of several")
    of_verdict = {
        "--confirm": confirm,
        "--speed-base": speed_base,
        "--history": history,
        "--junit": junit,
        "--markdown": markdown,
        "--json": as_json,
    }
    for option, given in of_verdict.items():
        if given and update:
            raise ConfigurationError(f"{option}: --update judges nothing; leave one of the two out")
    values = {
        "margin": margin,
        "tolerance": dict(map(_tolerance, tolerance or ())),
        "speed_reference": speed_reference,
        "speed_margin": speed_margin,
    }
    bases = _bases(speed_base or (), trackers_toml)
    earlier = _earlier(history)
    try:
        if update:
            _update_baseline(runs, baseline)
            return
        verdict = _judge(runs[0], baseline, _settings(values), confirm, bases)
        _report_verdict(verdict, junit, markdown, as_json)
    except Exception as error:
        reasons = _reasons_unmeasured(error)
        if not reasons:
            raise
        _report_unmeasured(reasons, junit, markdown, as_json)
        _remember(history, earlier, baseline, reasons)
        raise typer.Exit(UNMEASURED) from None
    _remember(history, earlier, baseline, verdict)
    if verdict.worse:
        raise typer.Exit(WORSE)


def regress_defaults() -> dict[str, str]:
    """The default of each option of `regress`, as text."""
    from gridtrack.evaluation.regression.settings import MARGIN, SPEED_MARGIN, TURNS_MARGIN
    from gridtrack.evaluation.statistics.jackknife import LEAST_UNITS

    return {
        "margin": f"{MARGIN:g} with {LEAST_UNITS} units or more, 0 with fewer",
        "speed_margin": f"{SPEED_MARGIN:g}, with --speed-base {TURNS_MARGIN:g}",
    }


def _update_baseline(runs: Sequence[Path], baseline: Path) -> None:
    """Write `runs` as the baseline; print its content, and what is worse than in the one that it replaces."""
    from gridtrack.evaluation.regression.baseline import write_baseline
    from gridtrack.evaluation.regression.measuring import measure_run
    from gridtrack.reports.verdict_text import text_of_update

    if len({run.resolve() for run in runs}) < len(runs):
        raise ConfigurationError("a run is given twice: each run of a baseline is a training or a seed of its own")
    first = measure_run(runs[0])
    measured = [first, *(measure_run(run, like=first) for run in runs[1:])]
    replaced = _against_replaced(runs[0], baseline) if baseline.exists() else None
    typer.echo(text_of_update(baseline, write_baseline(baseline, measured), replaced))


def _against_replaced(run: Path, baseline: Path) -> Verdict | str:
    """The verdict on the run by the baseline that is replaced, or why there is none."""
    from gridtrack.evaluation.regression.baseline import BaselineError
    from gridtrack.evaluation.regression.measurement import Unmeasured

    try:
        return _judge(run, baseline, _settings({}), confirm=False, bases={})
    except (BaselineError, Unmeasured) as reason:
        return str(reason)


def _settings(values: dict[str, Any]) -> GateSettings:
    """The settings of the gate from the options that were given."""
    from gridtrack.common.config import validated
    from gridtrack.evaluation.regression.settings import GateSettings

    given = {key: value for key, value in values.items() if value is not None}
    return validated(GateSettings, given, "gridtrack regress")


def _judge(run: Path, baseline: Path, settings: GateSettings, confirm: bool, bases: Mapping[str, Launch]) -> Verdict:
    """The verdict on the run in the folder `run`, with `confirm` after a second run of what looks worse, with `bases`
    with the times of trackers in turns with theirs."""
    from gridtrack.evaluation.regression.baseline import read_baseline
    from gridtrack.evaluation.regression.measuring import measure_run
    from gridtrack.evaluation.regression.verdict import compare_with_baseline

    stored = read_baseline(baseline)
    measured = measure_run(run, like=stored.first)
    verdict = compare_with_baseline(stored, measured, settings)
    if confirm:
        verdict = _confirmed(verdict, stored, measured, settings, run)
    if not bases:
        return verdict
    return replace(verdict, turns=_timed_in_turns(run, bases, settings))


def _timed_in_turns(run: Path, bases: Mapping[str, Launch], settings: GateSettings) -> tuple[TurnsRow, ...]:
    from gridtrack.evaluation.hosting.shielding import shield_host
    from gridtrack.evaluation.regression.turns import timed_in_turns

    shield_host("gridtrack regress")
    return timed_in_turns(run, bases, settings.turns_margin)


def _bases(texts: Sequence[str], trackers_toml: Path | None) -> dict[str, Launch]:
    """The base of each label in `LABEL=NAME`. Raises ConfigurationError and PluginError."""
    from gridtrack.trackers.selection import launch, read_trackers_toml

    if trackers_toml and not texts:
        raise ConfigurationError("--trackers-toml: it names the bases of --speed-base LABEL=NAME, and there is none")
    external = read_trackers_toml(trackers_toml) if trackers_toml else None
    bases: dict[str, Launch] = {}
    for text in texts:
        label, equals, name = text.rpartition("=")
        if not equals or not label or label in bases:
            raise ConfigurationError(f"--speed-base '{text}': expected LABEL=NAME, each label once")
        bases[label] = launch(name, external)
    return bases


def _earlier(folder: Path | None) -> History:
    """The history so far, read before anything is judged: one that cannot be trusted is told at once."""
    from gridtrack.evaluation.regression.history import read_history

    return read_history(folder) if folder else []


def _remember(folder: Path | None, earlier: History, baseline: Path, result: Verdict | Sequence[str]) -> None:
    """Add `result` to the history and draw it again."""
    from gridtrack.common.files import write_text
    from gridtrack.evaluation.regression.history import append_entry
    from gridtrack.reports.history import history_svg

    if folder is None:
        return
    path, entry = append_entry(folder, earlier, baseline, result)
    drawing = folder / "history.svg"
    try:
        write_text(drawing, history_svg([*(entry for _, entry in earlier), entry]))
        drawn = f"drawing: {drawing}"
    except ConfigurationError as error:
        drawn = f"no drawing: {error}"
    typer.echo(f"history: {path}; {drawn}", err=True)


def _confirmed(
    verdict: Verdict, baseline: Baseline, measured: Measurement, settings: GateSettings, run: Path
) -> Verdict:
    from gridtrack.evaluation.hosting.shielding import shield_host
    from gridtrack.evaluation.regression.confirmation import confirmed
    from gridtrack.evaluation.regression.rerun import Trials, run_again
    from gridtrack.reports.run_progress import RunProgress

    def again(trials: Trials, timed: bool) -> list[Measurement]:
        shield_host("gridtrack regress")
        with RunProgress() as progress:
            return run_again(run, trials, baseline.first, timed, progress)

    return confirmed(verdict, baseline, measured, settings, again)


def _reasons_unmeasured(error: Exception) -> Sequence[str]:
    """Why there is no verdict, one line each; none where `error` is wrong use, which the command line reports.

    A crash is a reason: its exit code must not be 1, which means worse. `--debug` prints its traceback.
    """
    from gridtrack.evaluation.regression.measurement import Unmeasured

    if isinstance(error, Unmeasured):
        return error.reasons
    # an OSError with a file name is a path in an option that cannot be read or written
    if isinstance(error, GridtrackError) or (isinstance(error, OSError) and error.filename):
        return ()
    if DEBUG_OPTION in sys.argv:
        traceback.print_exception(error)
    what = one_line(f"{type(error).__name__}: {error}", MAX_CRASH_CHARS)
    return [f"regress failed ({what}); {DEBUG_OPTION} shows the traceback"]


def _tolerance(text: str) -> tuple[str, float]:
    label, _, value = text.rpartition("=")
    try:
        return label, float(value)
    except ValueError:
        raise ConfigurationError(f"--tolerance '{text}': expected LABEL=F1, such as my-tracker=0.01") from None


def _report_verdict(verdict: Verdict, junit: Path | None, markdown: Path | None, as_json: bool) -> None:
    from gridtrack.reports.verdict_tables import data_of, junit_of, markdown_of
    from gridtrack.reports.verdict_text import text_of

    _write_report(junit, junit_of, verdict)
    _write_report(markdown, markdown_of, verdict)
    typer.echo(json.dumps(data_of(verdict), indent=1) if as_json else text_of(verdict))


def _report_unmeasured(reasons: Sequence[str], junit: Path | None, markdown: Path | None, as_json: bool) -> None:
    from gridtrack.reports.verdict_tables import junit_of_unmeasured, markdown_of_unmeasured

    _write_report(junit, junit_of_unmeasured, reasons)
    _write_report(markdown, markdown_of_unmeasured, reasons)
    if as_json:
        typer.echo(json.dumps({"verdict": "not measured", "reasons": list(reasons)}, indent=1))
    for reason in reasons:
        typer.echo(f"gridtrack: not measured: {printable(reason)}", err=True)


def _write_report(path: Path | None, rendered: Any, content: Any) -> None:
    """Write to `path`; a pipe or a device, such as /dev/stdout, cannot be replaced and is written in place."""
    from gridtrack.common.files import write_text

    if path is None:
        return
    if path.exists() and not path.is_file():
        path.write_text(rendered(content), "utf-8")
    else:
        write_text(path, rendered(content))

"""`compare` and `report`: run trackers on recordings, and write the report of a run."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from gridtrack.cli.compare_options import (
    AddressOption,
    AllowLeakOption,
    DeadlineOption,
    DegradeOption,
    EngineOption,
    FollowOption,
    IdleTimeoutOption,
    ReferenceOption,
    RowsOption,
    SegmentOption,
    SlurmOption,
    ValidationOption,
    WarmUpOption,
)
from gridtrack.cli.completion import complete_format
from gridtrack.cli.options import (
    GridOption,
    JsonOption,
    RateOption,
    RecordingsArgument,
    SandboxOption,
    TrackersTomlOption,
    WeightsOption,
    command_line,
    default_of,
    seconds,
    seconds_text,
)
from gridtrack.common.errors import INTERRUPTED_EXIT_CODE, ConfigurationError, printable

if TYPE_CHECKING:
    from gridtrack.evaluation.comparison.plan import ComparisonPlan
    from gridtrack.evaluation.comparison.settings import CompareSettings
    from gridtrack.evaluation.results.summary import RunSummary

INCOMPLETE = 3


def compare_command(
    recordings: RecordingsArgument,
    tracker: RowsOption = None,
    out: Annotated[Path | None, typer.Option(help="The run's folder")] = None,
    validation: ValidationOption = None,
    reference: ReferenceOption = None,
    horizon: Annotated[str | None, typer.Option(help="The longest horizon of a forecast")] = None,
    every: Annotated[str | None, typer.Option(help="Time between scored forecasts")] = None,
    segment: SegmentOption = None,
    warm_up: WarmUpOption = None,
    grid: GridOption = None,
    rate: RateOption = None,
    jobs: Annotated[int | None, typer.Option(help="Trials at the same time; default: one per processor core")] = None,
    engine: EngineOption = None,
    address: AddressOption = None,
    slurm: SlurmOption = None,
    threads: Annotated[int | None, typer.Option(help="Compute threads of each tracker")] = None,
    memory: Annotated[int | None, typer.Option(help="Memory limit of each tracker, MB")] = None,
    start_timeout: Annotated[str | None, typer.Option(help="Time limit for the start of a tracker")] = None,
    update_timeout: Annotated[str | None, typer.Option(help="Time limit for each frame")] = None,
    predict_timeout: Annotated[str | None, typer.Option(help="Time limit for each forecast")] = None,
    sandbox: SandboxOption = False,
    seed: Annotated[int | None, typer.Option(help="Seed of every tracker and of degraded input")] = None,
    weights: WeightsOption = None,
    trackers_toml: TrackersTomlOption = None,
    resume: Annotated[bool, typer.Option(help="Run only the trials that are missing in the run's folder")] = False,
    allow_leak: AllowLeakOption = False,
    latency: Annotated[bool, typer.Option(help="After the scores, measure the time of each tracker alone")] = False,
    deadline: DeadlineOption = False,
    degrade: DegradeOption = None,
    follow: FollowOption = False,
    idle_timeout: IdleTimeoutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Run trackers on recordings, each in its own process, score them, and write a report.

    Exit code: 0 all trials complete, 2 wrong use, 3 a trial is not complete or lacks a requested measurement, 130
    interrupted. With --follow Ctrl-C ends the recording, and the run of what was seen is complete; the code is 130.
    """
    limits = {
        "start_s": _seconds(start_timeout),
        "update_s": _seconds(update_timeout),
        "predict_s": _seconds(predict_timeout),
        "threads": threads,
        "memory_mb": memory,
        "sandbox": sandbox,
    }
    given = {
        "recordings": tuple(recordings),
        "trackers": tuple(tracker or ()),
        "out": out,
        "validation": validation,
        "reference": reference,
        "horizon_s": _seconds(horizon),
        "every_s": _seconds(every),
        "segment_s": _seconds(segment),
        "warm_up_s": _seconds(warm_up),
        "grid": grid,
        "rate_hz": rate,
        "jobs": jobs,
        "engine": engine,
        "address": address,
        "seed": seed,
        "weights": weights,
        "trackers_toml": trackers_toml,
        "allow_leak": allow_leak,
        "resume": resume,
        "latency": latency,
        "deadline": deadline,
        "follow": follow,
        "idle_timeout_s": _seconds(idle_timeout),
    }
    settings = _settings(given, limits, degrade, slurm)
    compared = _followed(settings) if settings.follow else _run(settings)
    _print_result(settings.out, compared, as_json)
    raise typer.Exit(compared.exit_code)


def _seconds(text: str | None) -> float | None:
    return None if text is None else seconds(text)


def _settings(given: dict[str, Any], limits: dict[str, Any], degrade: str | None, slurm: str | None) -> CompareSettings:
    """The settings with the values that the user gave; None is an option that was not given."""
    from gridtrack.common.config import validated
    from gridtrack.evaluation.comparison.settings import CompareSettings
    from gridtrack.evaluation.engines.slurm_settings import parse_slurm
    from gridtrack.evaluation.processes.limits import Limits
    from gridtrack.recordings.degradation import parse_degradation

    values = {key: value for key, value in given.items() if value is not None}
    if degrade is not None:
        values["degrade"] = parse_degradation(degrade)
    if slurm is not None:
        values["slurm"] = parse_slurm(slurm)
    kept = {key: value for key, value in limits.items() if value is not None}
    values["limits"] = validated(Limits, kept, "gridtrack compare")
    return validated(CompareSettings, values, "gridtrack compare")


class _Compared(NamedTuple):
    """A comparison that has ended."""

    summary: RunSummary
    interrupted: bool
    lacks_measurements: bool

    @property
    def exit_code(self) -> int:
        """0 where every trial is complete and has what was requested."""
        if self.interrupted:
            return INTERRUPTED_EXIT_CODE
        trials = (trial for row in self.summary.trackers.values() for trial in row.recordings.values())
        complete = not self.lacks_measurements and all(trial.outcome == "ok" for trial in trials)
        return 0 if complete else INCOMPLETE


def _run(settings: CompareSettings) -> _Compared:
    """Run a comparison of finished recordings."""
    from gridtrack.evaluation.comparison.plan import resolve
    from gridtrack.evaluation.comparison.runner import run
    from gridtrack.reports.run_progress import RunProgress

    plan = resolve(settings)
    with RunProgress() as progress:
        summary = run(plan, shlex.split(command_line()), progress)
    return _Compared(summary, summary.interrupted, not summary.interrupted and _warn_of_missing(plan))


def _followed(settings: CompareSettings) -> _Compared:
    """Follow a recording that is still being written, and score what was seen."""
    from gridtrack.evaluation.comparison.following import following
    from gridtrack.reports.live_table import LiveTable
    from gridtrack.reports.run_progress import RunProgress

    with following(settings, note=lambda text: typer.echo(printable(text), err=True)) as followed:
        with LiveTable() as table:
            followed.follow(table)
        with RunProgress() as progress:
            summary = followed.finish(shlex.split(command_line()), progress)
    return _Compared(summary, summary.interrupted or followed.interrupted, lacks_measurements=False)


def _print_result(out: Path, compared: _Compared, as_json: bool) -> None:
    """Write the report of the run in `out`, and print the result."""
    from gridtrack.evaluation.results.files import json_of
    from gridtrack.reports.page import render_report
    from gridtrack.reports.terminal import print_tables

    report = render_report([out])
    if as_json:
        typer.echo(json_of(compared.summary))
    else:
        print_tables(out)
        typer.echo(f"report: {report}")


def compare_defaults() -> dict[str, str]:
    """The default of each option of `compare`, as text."""
    from gridtrack.evaluation.comparison.settings import CompareSettings
    from gridtrack.evaluation.processes.limits import Limits

    return {
        "out": str(default_of(CompareSettings, "out")),
        "engine": str(default_of(CompareSettings, "engine")),
        "horizon": seconds_text(default_of(CompareSettings, "horizon_s")),
        "every": seconds_text(default_of(CompareSettings, "every_s")),
        "warm_up": seconds_text(default_of(CompareSettings, "warm_up_s")),
        "threads": str(default_of(Limits, "threads")),
        "memory": str(default_of(Limits, "memory_mb")),
        "start_timeout": seconds_text(default_of(Limits, "start_s")),
        "update_timeout": seconds_text(default_of(Limits, "update_s")),
        "predict_timeout": seconds_text(default_of(Limits, "predict_s")),
        "seed": str(default_of(CompareSettings, "seed")),
        "idle_timeout": seconds_text(default_of(CompareSettings, "idle_timeout_s")),
    }


def compare_helps() -> dict[str, str]:
    """The help of the options of `compare` that depends on the settings."""
    from gridtrack.recordings.degradation import Degradation

    kinds = ", ".join(field.alias or "" for field in Degradation.model_fields.values())
    return {
        "degrade": f"After the scores, score on degraded frames: {kinds}; a value is a probability, or a standard"
        " deviation in metres; one kind at a time, at a quarter, half and all of its value"
    }


def _warn_of_missing(plan: ComparisonPlan) -> bool:
    """Print the requested measurements that a complete trial lacks; whether there are any."""
    from gridtrack.evaluation.comparison.measurements import missing_measurements
    from gridtrack.evaluation.results.trial_record import read_trial_record

    records = [read_trial_record(plan.settings.out / trial.name) for trial in plan.trials]
    complete = [record for record in records if record and record.outcome == "ok"]
    missing = [line for record in complete for line in missing_measurements(plan.settings, record)]
    for line in missing:
        typer.echo(f"gridtrack: not measured: {printable(line)}", err=True)
    return bool(missing)


def report_command(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN...", help="The folder of a run")],
    out: Annotated[
        Path | None,
        typer.Option(
            help="The folder of the page, or the file of another format; default: report in the run's folder, or stdout"
        ),
    ] = None,
    as_format: Annotated[
        str,
        typer.Option("--format", help="html, markdown, latex, csv, junit, svg or pdf", autocompletion=complete_format),
    ] = "html",
    rows: Annotated[
        str, typer.Option(metavar="LABEL,...", help="Rows of another format; * and ? stand for any text and sign")
    ] = "",
    columns: Annotated[
        str,
        typer.Option(
            metavar="SCORE STRATUM HORIZON,...", help="Columns of another format, e.g. 'f1 in-motion 1s, nll visible'"
        ),
    ] = "",
    rerun: Annotated[
        bool,
        typer.Option("--rerun", help="The kept forecasts for the Rerun viewer, as RECORDING.rrd beside the page"),
    ] = False,
) -> None:
    """Write the report of a run again, or of several runs side by side: as a page, or in another format."""
    from gridtrack.reports.formats import PAGE, check_format, render_as
    from gridtrack.reports.page import render_report

    check_format(as_format)
    if rerun:
        if as_format != PAGE or columns:
            raise ConfigurationError("--rerun: forecasts have neither --format nor --columns: leave them out")
        _write_rerun(runs, out, rows)
        return
    if as_format != PAGE:
        _write_rendered(render_as(as_format, runs, rows, columns), out)
        return
    if rows or columns:
        raise ConfigurationError("--rows and --columns: the page shows every row; choose another --format")
    typer.echo(f"report: {render_report(runs, out)}")


def _write_rerun(runs: list[Path], out: Path | None, rows: str) -> None:
    """Write the kept forecasts of a run for the Rerun viewer."""
    from gridtrack.reports.rerun_run import write_rerun_run

    if len(runs) > 1:
        raise ConfigurationError("--rerun: one run at a time")
    written, notices = write_rerun_run(runs[0], out, rows)
    for notice in notices:
        typer.echo(f"gridtrack: {printable(notice)}", err=True)
    for path in written:
        typer.echo(f"open the forecasts with: {shlex.join(['rerun', printable(str(path))])}")


def _write_rendered(content: bytes, out: Path | None) -> None:
    """Write to `out`, or to stdout."""
    from gridtrack.common.files import atomic_write

    if out is None:
        typer.echo(content, nl=False)
        return
    if out.is_dir():
        raise ConfigurationError(f"{out}: is a folder: --out is the file of this format")
    with atomic_write(out) as file:
        file.write(content)

"""`compare`: run trackers on recordings."""

from __future__ import annotations

import shlex
from contextlib import AbstractContextManager, nullcontext
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
    print_note,
    seconds,
    seconds_text,
)
from gridtrack.common.errors import INTERRUPTED_EXIT_CODE, printable
from gridtrack.common.remote_files import is_url

if TYPE_CHECKING:
    from gridtrack.evaluation.runs.plan import ComparisonPlan
    from gridtrack.evaluation.runs.settings import CompareSettings
    from gridtrack.evaluation.runs.summary import RunSummary

INCOMPLETE = 3


def compare_command(
    recordings: RecordingsArgument,
    tracker: RowsOption = None,
    out: Annotated[str | None, typer.Option(metavar="FOLDER", help="The run's folder, or its URL")] = None,
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
        "out": None if out is None or is_url(out) else Path(out),
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
    with _folder_of_run(out, settings) as folder:
        local = settings.model_copy(update={"out": folder})
        compared = _followed(local) if settings.follow else _run(local)
        report = _print_result(folder, compared, as_json)
    if not as_json:
        in_store = f"{(out or '').rstrip('/')}/{report.relative_to(folder).as_posix()}"
        typer.echo(f"report: {report if folder == settings.out else in_store}")
    raise typer.Exit(compared.exit_code)


def _folder_of_run(out: str | None, settings: CompareSettings) -> AbstractContextManager[Path]:
    """The local folder in which a run is made; that of a run in a store is uploaded at the end."""
    if out is None or not is_url(out):
        return nullcontext(settings.out)
    from gridtrack.evaluation.runs.stored_run import stored_run

    again = command_line() if settings.resume else f"{command_line()} --resume"
    return stored_run(out, resume=settings.resume, again=None if settings.follow else again, note=print_note)


def _seconds(text: str | None) -> float | None:
    return None if text is None else seconds(text)


def _settings(given: dict[str, Any], limits: dict[str, Any], degrade: str | None, slurm: str | None) -> CompareSettings:
    """The settings with the values that the user gave; None is an option that was not given."""
    from gridtrack.common.config import validated
    from gridtrack.evaluation.engines.slurm_settings import parse_slurm
    from gridtrack.evaluation.hosting.limits import Limits
    from gridtrack.evaluation.runs.settings import CompareSettings
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
    from gridtrack.evaluation.runs.plan import resolve
    from gridtrack.evaluation.runs.runner import run
    from gridtrack.reports.run_progress import RunProgress

    plan = resolve(settings)
    with RunProgress() as progress:
        summary = run(plan, shlex.split(command_line()), progress)
    return _Compared(summary, summary.interrupted, not summary.interrupted and _warn_of_missing(plan))


def _followed(settings: CompareSettings) -> _Compared:
    """Follow a recording that is still being written, and score what was seen."""
    from gridtrack.evaluation.runs.following import following
    from gridtrack.reports.run_progress import LiveTable, RunProgress

    with following(settings, note=lambda text: typer.echo(printable(text), err=True)) as followed:
        with LiveTable() as table:
            followed.follow(table)
        with RunProgress() as progress:
            summary = followed.finish(shlex.split(command_line()), progress)
    return _Compared(summary, summary.interrupted or followed.interrupted, lacks_measurements=False)


def _print_result(out: Path, compared: _Compared, as_json: bool) -> Path:
    """Write the report of the run in `out`, print the result, and return the path of the report."""
    from gridtrack.evaluation.runs.result_files import json_of
    from gridtrack.reports.page import render_report
    from gridtrack.reports.terminal import print_result

    report = render_report([out])
    if as_json:
        typer.echo(json_of(compared.summary))
    else:
        print_result(out)
    return report


def compare_defaults() -> dict[str, str]:
    """The default of each option of `compare`, as text."""
    from gridtrack.evaluation.hosting.limits import Limits
    from gridtrack.evaluation.runs.settings import CompareSettings

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
    from gridtrack.evaluation.runs.measurements import missing_measurements
    from gridtrack.evaluation.runs.trial_record import read_trial_record

    records = [read_trial_record(plan.settings.out / trial.name) for trial in plan.trials]
    complete = [record for record in records if record and record.outcome == "ok"]
    missing = [line for record in complete for line in missing_measurements(plan.settings, record)]
    for line in missing:
        print_note(f"not measured: {line}")
    return bool(missing)

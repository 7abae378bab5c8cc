"""`compare` and `report`: run trackers on recordings, and render what came of it."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gridtrack.cli.options import (
    GridOption,
    JsonOption,
    RateOption,
    RecordingsArgument,
    WeightsOption,
    command_line,
    seconds,
)
from gridtrack.common.errors import printable

if TYPE_CHECKING:
    from gridtrack.evaluation.comparison.plan import ComparisonPlan

INCOMPLETE, INTERRUPTED = 3, 130


def compare_command(
    recordings: RecordingsArgument,
    tracker: Annotated[
        list[str] | None, typer.Option(metavar="[LABEL=]NAME[:KEY=VALUE,...]", help="Repeat; default: all")
    ] = None,
    out: Annotated[Path, typer.Option(help="The run's folder")] = Path("runs/latest"),
    validation: Annotated[
        str | None, typer.Option(help="RECORDING[@RANGE] to choose thresholds on; default: the recording's own")
    ] = None,
    reference: Annotated[
        str | None, typer.Option(metavar="LABEL", help="The row that others are set against; default: persistence")
    ] = None,
    horizon: Annotated[str, typer.Option(help="How far to forecast")] = "2.5s",
    every: Annotated[str, typer.Option(help="Time between scored forecasts")] = "1s",
    grid: GridOption = None,
    rate: RateOption = None,
    jobs: Annotated[int | None, typer.Option(help="Trials side by side; default: one a core")] = None,
    threads: Annotated[int, typer.Option(help="Compute threads of each tracker")] = 1,
    memory: Annotated[int, typer.Option(help="Memory limit of each tracker, MB")] = 4096,
    start_timeout: Annotated[str, typer.Option(help="A tracker's time to start")] = "180s",
    update_timeout: Annotated[str, typer.Option(help="Its time for each frame")] = "5s",
    predict_timeout: Annotated[str, typer.Option(help="Its time for each forecast")] = "30s",
    seed: int = 0,
    weights: WeightsOption = None,
    trackers_toml: Annotated[Path | None, typer.Option(help="Trackers of other environments and programs")] = None,
    resume: Annotated[bool, typer.Option(help="Run only what is missing in the folder")] = False,
    latency: Annotated[bool, typer.Option(help="Afterwards time each tracker alone")] = False,
    deadline: Annotated[
        bool, typer.Option(help="Afterwards time each tracker alone, and score what it would have done in time")
    ] = False,
    degrade: Annotated[
        str | None,
        typer.Option(
            metavar="KIND=VALUE,...",
            help="Afterwards show degraded frames: beam-dropout=0.2, range-noise=0.05 (m), frame-drop=0.1,"
            " pose-jitter=0.05 (m); each by itself, at a quarter, half and all of its value",
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Run trackers on recordings, each in its own process, score them, and write a report.

    Exit code: 0 all trials complete, 2 wrong use, 3 some trial is not or lacks a figure that was asked for, 130
    interrupted.
    """
    from gridtrack.evaluation.comparison.plan import resolve
    from gridtrack.evaluation.comparison.runner import run
    from gridtrack.evaluation.comparison.settings import CompareSettings
    from gridtrack.evaluation.processes.limits import Limits
    from gridtrack.recordings.degradation import parse_degradation
    from gridtrack.reports.page import render_report
    from gridtrack.reports.terminal import RunProgress, print_tables

    given: dict[str, Any] = {
        "recordings": tuple(recordings),
        "trackers": tuple(tracker or ()),
        "out": out,
        "validation": validation,
        "reference": reference,
        "horizon_s": seconds(horizon),
        "every_s": seconds(every),
        "grid": grid,
        "rate_hz": rate,
        "jobs": jobs,
        "seed": seed,
        "weights": weights,
        "trackers_toml": trackers_toml,
        "resume": resume,
        "latency": latency,
        "deadline": deadline,
        "degrade": parse_degradation(degrade) if degrade is not None else None,
    }
    may_take = {"start_s": start_timeout, "update_s": update_timeout, "predict_s": predict_timeout}
    limits = _settings(
        Limits, {**{key: seconds(text) for key, text in may_take.items()}, "threads": threads, "memory_mb": memory}
    )
    plan = resolve(_settings(CompareSettings, {**given, "limits": limits}))
    with RunProgress() as progress:
        summary = run(plan, shlex.split(command_line()), progress)
    report = render_report([out])
    if as_json:
        typer.echo(json.dumps(summary, indent=1))
    else:
        print_tables(out)
        typer.echo(f"report: {report}")
    if summary["interrupted"]:
        raise typer.Exit(INTERRUPTED)
    outcomes = [trial["outcome"] for entry in summary["trackers"].values() for trial in entry["recordings"].values()]
    if _tell_missing(plan) or any(outcome != "ok" for outcome in outcomes):
        raise typer.Exit(INCOMPLETE)


def _tell_missing(plan: ComparisonPlan) -> bool:
    """Tell of figures that were asked for and that a complete trial lacks; whether there are any."""
    from gridtrack.evaluation.comparison.measurements import missing_measurements
    from gridtrack.evaluation.scoring.record import read_record

    records = [read_record(plan.settings.out / trial.name) for trial in plan.trials]
    complete = [record for record in records if record and record.outcome == "ok"]
    missing = [line for record in complete for line in missing_measurements(plan.settings, record)]
    for line in missing:
        typer.echo(f"gridtrack: not measured: {printable(line)}", err=True)
    return bool(missing)


def _settings(model: Any, values: dict[str, Any]) -> Any:
    from gridtrack.common.config import validated

    return validated(model, values, "gridtrack compare")


def report_command(runs: Annotated[list[Path], typer.Argument(metavar="RUN...")], out: Path | None = None) -> None:
    """Render the report of a run again, or of several runs side by side."""
    from gridtrack.reports.page import render_report

    typer.echo(f"report: {render_report(runs, out)}")

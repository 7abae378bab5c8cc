"""`compare` and `report`: run trackers on recordings, and render what came of it."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Annotated, Any

import typer

from gridtrack.cli.options import AsJson, Grid, Rate, Recordings, Weights, command_line, seconds

INCOMPLETE, INTERRUPTED = 3, 130


def compare(
    recordings: Recordings,
    tracker: Annotated[
        list[str] | None, typer.Option(metavar="[LABEL=]NAME[:KEY=VALUE,...]", help="Repeat; default: all")
    ] = None,
    out: Annotated[Path, typer.Option(help="The run's folder")] = Path("runs/latest"),
    validation: Annotated[
        str | None, typer.Option(help="RECORDING[@RANGE] to choose thresholds on; default: the recording's own")
    ] = None,
    horizon: Annotated[str, typer.Option(help="How far to forecast")] = "2.5s",
    every: Annotated[str, typer.Option(help="Time between scored forecasts")] = "1s",
    grid: Grid = None,
    rate: Rate = None,
    jobs: Annotated[int | None, typer.Option(help="Trials side by side; default: one a core")] = None,
    threads: Annotated[int, typer.Option(help="Compute threads of each tracker")] = 1,
    memory: Annotated[int, typer.Option(help="Memory limit of each tracker, MB")] = 4096,
    seed: int = 0,
    weights: Weights = None,
    trackers_toml: Annotated[Path | None, typer.Option(help="Trackers of other environments and programs")] = None,
    resume: Annotated[bool, typer.Option(help="Run only what is missing in the folder")] = False,
    latency: Annotated[bool, typer.Option(help="Afterwards time each tracker alone")] = False,
    as_json: AsJson = False,
) -> None:
    """Run trackers on recordings, each in its own process, score them, and write a report.

    Exit code: 0 all trials complete, 2 wrong use, 3 some trial is not, 130 interrupted.
    """
    from gridtrack.evaluation.plan import CompareSettings, resolve
    from gridtrack.evaluation.runner import run
    from gridtrack.evaluation.tracker_process import Limits
    from gridtrack.reports.page import render_report
    from gridtrack.reports.terminal import RunProgress, print_tables

    given: dict[str, Any] = {
        "recordings": tuple(recordings),
        "trackers": tuple(tracker or ()),
        "out": out,
        "validation": validation,
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
    }
    limits = _settings(Limits, {"threads": threads, "memory_mb": memory})
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
    if any(outcome != "ok" for outcome in outcomes):
        raise typer.Exit(INCOMPLETE)


def _settings(model: Any, values: dict[str, Any]) -> Any:
    from gridtrack.common.config import validated

    return validated(model, values, "gridtrack compare")


def report(runs: Annotated[list[Path], typer.Argument(metavar="RUN...")], out: Path | None = None) -> None:
    """Render the report of a run again, or of several runs side by side."""
    from gridtrack.reports.page import render_report

    typer.echo(f"report: {render_report(runs, out)}")

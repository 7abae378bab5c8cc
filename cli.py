"""The command line: arguments in, library calls, print; a failure that a user can cause is one line and exit 2."""

from __future__ import annotations

import json
import shlex
import sys
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer

from gridtrack.common.errors import ConfigurationError, GridtrackError, plain

INCOMPLETE, INTERRUPTED = 3, 130

app = typer.Typer(no_args_is_help=True, add_completion=False, help="Occupancy-grid trackers under one referee.")
trackers_app = typer.Typer(no_args_is_help=True, help="The trackers: list, show, check.")
recording_app = typer.Typer(no_args_is_help=True, help="Recordings: info, import.")
app.add_typer(trackers_app, name="trackers")
app.add_typer(recording_app, name="recording")

Recordings = Annotated[list[str], typer.Argument(metavar="RECORDING[@RANGE]...", help="e.g. demo.mcap@30s-90s")]
Grid = Annotated[str | None, typer.Option(help="CELLSxMETRES[@X,Y], e.g. 100x0.2; default: the recording's")]
Rate = Annotated[float | None, typer.Option(help="Frames per second; default: the recording's")]
Weights = Annotated[Path | None, typer.Option(help="Folder of trained weights, before your own and the shipped ones")]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON")]


def main() -> None:
    """Run the command line; `--debug` shows tracebacks instead of one-line errors."""
    debug = "--debug" in sys.argv
    try:
        app([argument for argument in sys.argv[1:] if argument != "--debug"])
    except GridtrackError as error:
        if debug:
            raise
        _fail(str(error))
    except OSError as error:
        if debug:
            raise
        _fail(f"{error.filename}: {error.strerror}" if error.filename else str(error))


def _fail(reason: str) -> NoReturn:
    typer.echo(f"gridtrack: {plain(reason)}", err=True)
    sys.exit(2)


def seconds(text: str) -> float:
    """`2.5s` or `2.5` in seconds. Raises ConfigurationError."""
    try:
        return float(text.removesuffix("s"))
    except ValueError:
        raise ConfigurationError(f"'{text}': expected seconds, such as 2.5s") from None


def command_line() -> str:
    """The command as typed, to be kept with its results."""
    return shlex.join(["gridtrack", *sys.argv[1:]])


@app.command()
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


@app.command()
def report(runs: Annotated[list[Path], typer.Argument(metavar="RUN...")], out: Path | None = None) -> None:
    """Render the report of a run again, or of several runs side by side."""
    from gridtrack.reports.page import render_report

    typer.echo(f"report: {render_report(runs, out)}")


@app.command()
def train(
    tracker: Annotated[str, typer.Argument(metavar="NAME[:KEY=VALUE,...]")],
    recordings: Recordings,
    validation: Annotated[
        list[str] | None, typer.Option(help="RECORDING[@RANGE]; default: the recording's own validation stretch")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Folder of weights; default: your own")] = None,
    seed: Annotated[int, typer.Option(min=0, max=2**31 - 1)] = 1,
    grid: Grid = None,
    rate: Rate = None,
) -> None:
    """Let a tracker learn a site: weights, map and settings, with the command that made them."""
    from gridtrack.common.grid import GridSpec
    from gridtrack.evaluation.learned import users_folder
    from gridtrack.evaluation.train import train as train_tracker
    from gridtrack.trackers.selection import parse_selection

    chosen = parse_selection(tracker)
    card = train_tracker(
        chosen.name,
        recordings,
        validation or [],
        out or users_folder(),
        chosen.options,
        seed,
        command_line(),
        grid=GridSpec.parse(grid) if grid else None,
        rate_hz=rate,
        report=typer.echo,
    )
    typer.echo(f"weights: {card}")


@trackers_app.command("list")
def list_trackers(as_json: AsJson = False) -> None:
    """Every registered tracker, the broken ones with the reason. Each is asked in a process of its own."""
    from concurrent.futures import ThreadPoolExecutor

    from gridtrack.reports.terminal import print_rows
    from gridtrack.trackers import registry

    with ThreadPoolExecutor() as pool:
        rows = list(pool.map(_listed, registry.entries().values()))
    typer.echo(json.dumps(rows, indent=1)) if as_json else print_rows(rows)


def _listed(entry: Any) -> dict[str, str]:
    row = {"name": entry.name, "from": entry.distribution}
    try:
        return {**row, "state": "ready", "about": _first_line(_describe(entry.name).about)}
    except GridtrackError as error:
        return {**row, "state": "unavailable", "about": entry.problem or str(error)}


def _first_line(text: str) -> str:
    return text.partition("\n")[0]


def _describe(name: str) -> Any:
    from gridtrack.evaluation.tracker_process import Limits, describe
    from gridtrack.trackers.selection import launch

    return describe(launch(name), {}, Limits())


@trackers_app.command("show")
def show_tracker(name: str, as_json: AsJson = False) -> None:
    """What a tracker is, whether it learns, and its options with their defaults."""
    from gridtrack.reports.terminal import print_rows
    from gridtrack.trackers import registry

    entry, said = registry.find(name), _describe(name)
    about = {
        "name": name,
        "about": _first_line(said.about),
        "from": f"{entry.value} of {entry.distribution}",
        "learns": said.learns,
        "moving_sensor": said.moving_sensor,
    }
    schema = said.options_schema.get("properties", {})
    options = [
        {
            "option": key,
            "default": json.dumps(value),
            "about": " ".join(schema.get(key, {}).get("description", "").split()),
        }
        for key, value in said.options.items()
    ]
    if as_json:
        typer.echo(json.dumps({**about, "options": options}, indent=1))
        return
    for key, value in about.items():
        typer.echo(f"{key}: {value}")
    print_rows(options)


@trackers_app.command("check")
def check_tracker(
    tracker: Annotated[str, typer.Argument(metavar="NAME[:KEY=VALUE,...]")],
    recording: Annotated[
        str | None, typer.Option(help="Check on this recording's grid, rate and site; default: 100x0.2 at 8 Hz")
    ] = None,
    weights: Weights = None,
    trackers_toml: Annotated[Path | None, typer.Option(help="Trackers of other environments and programs")] = None,
    as_json: AsJson = False,
) -> None:
    """Try every promise of the plugin contract on a tracker, in its own process. Exit code 1 where one is broken."""
    from gridtrack.evaluation.contract_suite import check_tracker as check
    from gridtrack.evaluation.learned import find_weights
    from gridtrack.reports.terminal import print_rows
    from gridtrack.trackers.selection import launch, parse_selection, read_trackers_toml

    chosen = parse_selection(tracker)
    stream = _stream(recording)
    found = find_weights(chosen.name, stream.site, weights)
    launched = launch(chosen.name, read_trackers_toml(trackers_toml) if trackers_toml else None)
    results = check(launched, replace(stream, weights=found.path if found else None), chosen.options)
    rows = [asdict(result) for result in results]
    typer.echo(json.dumps(rows, indent=1)) if as_json else print_rows(rows)
    if any(result.verdict != "passed" for result in results):
        raise typer.Exit(1)


def _stream(recording: str | None) -> Any:
    from gridtrack.common.grid import GridSpec
    from gridtrack.common.stream import open_stream
    from gridtrack.trackers.contract import StreamSpec, stream_of

    return stream_of(open_stream(recording)) if recording else StreamSpec(GridSpec(), 0.125)


@recording_app.command("info")
def recording_info(recording: Path, topic: str | None = None, strict: bool = False, as_json: AsJson = False) -> None:
    """What a recording holds: topics, sensors, rate, gaps, range limits, and what is wrong with it."""
    from gridtrack.common.recordings import open_recording

    summary = open_recording(recording, topic=topic, strict=strict).summary()
    typer.echo(summary.model_dump_json(indent=1) if as_json else "\n".join(map(plain, str(summary).split("\n"))))


@recording_app.command("import")
def recording_import(
    source: Path,
    out: Annotated[Path, typer.Option(help="The .mcap to write")],
    topic: Annotated[str | None, typer.Option(help="Of a bag with several")] = None,
    site: Annotated[str | None, typer.Option(help="The place where the sensor stands")] = None,
    grid: Grid = None,
    rate: Rate = None,
    stretch: Annotated[list[str] | None, typer.Option(metavar="NAME=RANGE", help="e.g. train=0s-75s")] = None,
    licence: str = "",
    credit: str = "",
    labels: Annotated[Path | None, typer.Option(help="CSV of per-beam classes")] = None,
    cloud_slice: Annotated[
        str | None, typer.Option(metavar="KEY=VALUE,...", help="Of point clouds: low_m=0.2,high_m=1.0")
    ] = None,
    strict: bool = False,
) -> None:
    """Write any recording (ROS 1 or 2 bag, ROS MCAP, CARMEN log) as a native one."""
    from gridtrack.common.config import parse_pairs, validated
    from gridtrack.common.recordings import CloudSlice, import_recording
    from gridtrack.common.stream import parse_named_stretch

    where = "--cloud-slice"
    recording = import_recording(
        source,
        out,
        topic=topic,
        site=site,
        grid=grid,
        rate_hz=rate,
        stretches=dict(parse_named_stretch(text) for text in stretch or ()),
        licence=licence,
        credit=credit,
        labels=labels,
        cloud_slice=validated(CloudSlice, parse_pairs(cloud_slice, where), where) if cloud_slice else None,
        strict=strict,
    )
    typer.echo(str(recording.summary()))


if __name__ == "__main__":
    main()

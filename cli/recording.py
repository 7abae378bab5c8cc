"""`recording info | import | outputs | view | layout`: content, import as a native recording, forecasts, viewing."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated, Any

import typer

from gridtrack.cli.options import (
    GridOption,
    JsonOption,
    RateOption,
    RecordingArgument,
    WholeRecordingArgument,
    print_note,
    settings_options,
)
from gridtrack.common.errors import INTERRUPTED_EXIT_CODE, ConfigurationError, printable
from gridtrack.common.grid import GridSpec
from gridtrack.recordings import ReadOptions, Recording, import_recording, open_recording
from gridtrack.recordings.importing import ImportSettings
from gridtrack.recordings.outputs.conversion import OutputSettings, write_outputs
from gridtrack.recordings.stream import open_stream

app = typer.Typer(add_completion=False, no_args_is_help=True)


@app.command("info")
@settings_options(ReadOptions)
def recording_info(values: dict[str, Any], recording: WholeRecordingArgument, as_json: JsonOption = False) -> None:
    """The content of a recording: topics, sensors, rate, gaps, range limits, and warnings."""
    _print_overview(open_recording(recording, **values), as_json)


def _print_overview(recording: Recording, as_json: bool) -> None:
    overview = recording.overview()
    typer.echo(overview.model_dump_json(indent=1) if as_json else "\n".join(map(printable, str(overview).split("\n"))))


@app.command("import")
@settings_options(ImportSettings)
def recording_import(
    values: dict[str, Any],
    source: WholeRecordingArgument,
    out: Annotated[Path, typer.Option(metavar="FILE", help="The .mcap to write")],
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the file OUT if it exists")] = False,
    as_json: JsonOption = False,
) -> None:
    """Write a recording of any format (ROS 1 or 2 bag, ROS or Foxglove MCAP, CARMEN log, ...) as a native one."""
    try:
        recording = import_recording(Path(source), out, overwrite=overwrite, **values)
    except KeyboardInterrupt:
        print_note(f"interrupted: {out} is unchanged, or complete")
        raise typer.Exit(INTERRUPTED_EXIT_CODE) from None
    _print_overview(recording, as_json)


@app.command("outputs")
@settings_options(OutputSettings)
def recording_outputs(
    values: dict[str, Any],
    recording: RecordingArgument,
    out: Annotated[Path, typer.Option(metavar="FILE", help="The .npz of forecasts to write")],
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the file OUT if it exists")] = False,
) -> None:
    """Write the recorded outputs of a stack, grids or objects, as forecasts for the tracker `recorded:file=OUT`."""
    forecasts, lines = write_outputs(recording, out, overwrite=overwrite, **values)
    for line in lines:
        print_note(line)
    rows, columns = forecasts.shape
    leads = forecasts.lead_s
    typer.echo(
        f"{printable(str(out))}: {len(forecasts)} forecasts {leads[0]:g} to {leads[-1]:g} s ahead ({len(leads)} times),"
        f" {rows} x {columns} cells of {forecasts.cell_m:g} m"
    )


@app.command("view")
def recording_view(
    recording: RecordingArgument,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The .rrd to write; default: named as the recording, here")
    ] = None,
    grid: GridOption = None,
    rate: RateOption = None,
    foreign_format: Annotated[
        str | None,
        typer.Option("--format", metavar="NAME", help="Recording format of another package, loaded only by this name"),
    ] = None,
) -> None:
    """Write frames, poses of the sensors and ground truth as a file for the Rerun viewer. It starts no viewer."""
    from rich.console import Console
    from rich.progress import Progress

    from gridtrack.reports.viewers import default_name, write_rerun_recording

    stream = open_stream(recording, grid=GridSpec.parse(grid) if grid else None, rate_hz=rate, format=foreign_format)
    path = out or Path(default_name(recording))
    if path.suffix != ".rrd":
        raise ConfigurationError(f"{path}: a Rerun recording is written as .rrd")
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bars:
        bar = bars.add_task("frames", total=len(stream))
        write_rerun_recording(stream, path, lambda: bars.advance(bar))
    for warning in stream.recording.warnings:
        print_note(warning)
    typer.echo(f"{len(stream)} frames; open them with: {shlex.join(['rerun', printable(str(path))])}")


@app.command("layout")
def recording_layout() -> None:
    """Print a layout of Foxglove, JSON, for native recordings and the forecasts.mcap of a run."""
    from gridtrack.reports.viewers import foxglove_layout

    typer.echo(foxglove_layout(), nl=False)

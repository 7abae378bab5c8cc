"""`recording info | import | view | layout`: what a recording holds, converting it to a native one, viewing it."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from gridtrack.cli.completion import complete_cloud_slice
from gridtrack.cli.options import (
    GridOption,
    JsonOption,
    RateOption,
    RecordingArgument,
    WholeRecordingArgument,
    print_note,
)
from gridtrack.common.errors import INTERRUPTED_EXIT_CODE, ConfigurationError, printable

if TYPE_CHECKING:
    from gridtrack.recordings import Recording

PoseTopicOption = Annotated[
    str | None,
    typer.Option(help="Topic with the poses of the robot, where the transforms are not right; none: it stands still"),
]
MountsOption = Annotated[
    list[str] | None,
    typer.Option("--mount", metavar="SENSOR=X,Y,ANGLE", help="Place of a sensor: front_laser=0.4,0.2,45deg[,mirrored]"),
]

ZeroRange = Annotated[
    Literal["free", "unknown"] | None,
    typer.Option(help="The meaning of a range of exactly 0.0: free up to the maximum range (no return), or unknown"),
]

app = typer.Typer(no_args_is_help=True, help="Recordings: info, import, view, layout.")


@app.command("info")
def recording_info(
    recording: WholeRecordingArgument,
    topic: str | None = None,
    pose_topic: PoseTopicOption = None,
    mount: MountsOption = None,
    zero_range: ZeroRange = None,
    strict: bool = False,
    as_json: JsonOption = False,
) -> None:
    """The content of a recording: topics, sensors, rate, gaps, range limits, and warnings."""
    from gridtrack.recordings import open_recording, parse_mount

    opened = open_recording(
        Path(recording),
        topic=topic,
        pose_topic=pose_topic,
        mounts=[parse_mount(text) for text in mount or ()],
        zero_range=zero_range,
        strict=strict,
    )
    _print_overview(opened, as_json)


def _print_overview(recording: Recording, as_json: bool) -> None:
    """Print what a recording holds."""
    overview = recording.overview()
    typer.echo(overview.model_dump_json(indent=1) if as_json else "\n".join(map(printable, str(overview).split("\n"))))


@app.command("import")
def recording_import(
    source: WholeRecordingArgument,
    out: Annotated[Path, typer.Option(help="The .mcap to write")],
    topic: Annotated[str | None, typer.Option(help="Of a bag with several")] = None,
    site: Annotated[str | None, typer.Option(help="The site of the sensor")] = None,
    grid: GridOption = None,
    rate: RateOption = None,
    stretch: Annotated[list[str] | None, typer.Option(metavar="NAME=RANGE", help="e.g. train=0s-75s")] = None,
    licence: str = "",
    credit: str = "",
    labels: Annotated[Path | None, typer.Option(help="CSV of per-beam classes")] = None,
    cloud_slice: Annotated[
        str | None,
        typer.Option(
            metavar="KEY=VALUE,...",
            help="Of point clouds: low_m=0.2,high_m=1.0; bearings without points are free up to range_max_m, or"
            " unknown with empty=unknown",
            autocompletion=complete_cloud_slice,
        ),
    ] = None,
    pose_topic: PoseTopicOption = None,
    mount: MountsOption = None,
    zero_range: ZeroRange = None,
    ego_motion: Annotated[
        Literal["recorded", "kiss-icp", "refined"] | None,
        typer.Option(
            help="Where the poses come from: recorded, as they are (the default); kiss-icp, from the scans alone;"
            " refined, from the scans with the recorded motion as a prior"
        ),
    ] = None,
    strict: bool = False,
    overwrite: Annotated[bool, typer.Option(help="Replace the file OUT where it exists")] = False,
    as_json: JsonOption = False,
) -> None:
    """Write a recording of any format (ROS 1 or 2 bag, ROS or Foxglove MCAP, CARMEN log, ...) as a native one."""
    from gridtrack.common.config import parse_pairs, validated
    from gridtrack.recordings import CloudSlice, import_recording, parse_mount
    from gridtrack.recordings.stretches import parse_named_stretch

    where = "--cloud-slice"
    try:
        recording = import_recording(
            Path(source),
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
            pose_topic=pose_topic,
            mounts=[parse_mount(text) for text in mount or ()],
            zero_range=zero_range,
            ego_motion=ego_motion or "recorded",
            strict=strict,
            overwrite=overwrite,
        )
    except KeyboardInterrupt:
        print_note(f"interrupted: {out} is as it was before, or written whole")
        raise typer.Exit(INTERRUPTED_EXIT_CODE) from None
    _print_overview(recording, as_json)


@app.command("view")
def recording_view(
    recording: RecordingArgument,
    out: Annotated[Path | None, typer.Option(help="The .rrd to write; default: named as the recording, here")] = None,
    grid: GridOption = None,
    rate: RateOption = None,
) -> None:
    """Write frames, poses of the sensors and ground truth as a file for the Rerun viewer. It starts no viewer."""
    from rich.console import Console
    from rich.progress import Progress

    from gridtrack.common.grid import GridSpec
    from gridtrack.recordings.stream import open_stream
    from gridtrack.reports.rerun_recording import default_name, write_rerun_recording

    stream = open_stream(recording, grid=GridSpec.parse(grid) if grid else None, rate_hz=rate)
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
    from gridtrack.reports.foxglove import foxglove_layout

    typer.echo(foxglove_layout(), nl=False)

"""`simulate`: recordings with ground truth, of a junction, of small worlds or of annotated tracks."""

from __future__ import annotations

import json
import shlex
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from gridtrack.cli.options import JsonOption, settings_options
from gridtrack.common.config import validated
from gridtrack.common.errors import ConfigurationError, RecordingError, printable
from gridtrack.common.options import seconds
from gridtrack.simulation import junction
from gridtrack.simulation.junction import drives
from gridtrack.simulation.stanford import Video, read_stanford
from gridtrack.simulation.tracks import Tracks
from gridtrack.simulation.tracks_file import check_suffix, read_tracks, write_recording
from gridtrack.simulation.traffic import Traffic, check_traffic

app = typer.Typer(add_completion=False, no_args_is_help=True)
FAULTY = 3
SDD = "sdd"
"""The format of the Stanford Drone Dataset's annotations."""

Out = Annotated[
    Path, typer.Option(metavar="FILE", help="The recording to write: .tracks, rendered on first use, or .mcap, scans")
]
OutFolder = Annotated[Path, typer.Option(metavar="FOLDER", help="Folder of the recordings")]


@app.command("junction")
def junction_command(
    minutes: Annotated[float, typer.Option(metavar="MINUTES", help="Duration of the recording")],
    out: Out,
    seed: Annotated[int, typer.Option(min=0, max=2**31 - 1, help="Seed of the traffic")] = 1,
    start: Annotated[
        str, typer.Option(metavar="SECONDS", help="Time omitted at the beginning, while the streets fill")
    ] = f"{junction.WARM_UP_S:g}s",
    sensor: Annotated[
        Literal["corner", "corners", "drive", "beside"],
        typer.Option(
            metavar="PLACE",
            help="Place of the laser: corner; corners, two opposite ones; drive, on a vehicle that drives through;"
            " beside, at rest beside the way of that vehicle",
        ),
    ] = "corner",
    carrier: Annotated[
        Literal["car", "robot"] | None,
        typer.Option(help="Vehicle that drives through: a car, or a delivery robot; default: car"),
    ] = None,
    odometry_noise: Annotated[
        float | None,
        typer.Option(
            metavar="FACTOR", help="Poses of a drive from wheel odometry, with its errors times this; default: 0, true"
        ),
    ] = None,
) -> None:
    """A laser at a signalled junction with pedestrians, cyclists, cars and buses (needs the extra `sim`).

    Exit code: 0 correct, 2 wrong use, 3 a road user moves through a wall, or gridlock.
    """
    check_suffix(out)
    start_s = seconds(start)
    if carrier is not None and sensor not in ("drive", "beside"):
        raise ConfigurationError(f"--carrier {carrier}: only with --sensor drive or --sensor beside")
    if odometry_noise is not None and sensor != "drive":
        raise ConfigurationError(f"--odometry-noise {odometry_noise:g}: only with --sensor drive")
    if not 0.0 <= (odometry_noise or 0.0) <= drives.MAX_ODOMETRY_NOISE:
        raise ConfigurationError(f"--odometry-noise {odometry_noise:g}: expected 0 to {drives.MAX_ODOMETRY_NOISE:g}")
    if sensor in ("corner", "corners"):
        view = junction.ONE_CORNER if sensor == "corner" else junction.TWO_CORNERS
        tracks = junction.simulate_junction(minutes, seed, start_s, view)
    else:
        drive = drives.simulate_drive(minutes, seed, start_s, carrier or "car")
        tracks = drive.beside() if sensor == "beside" else drive.carried(odometry_noise or 0.0)
    _write(out, tracks)


@app.command("junction-set")
def simulate_junction_set(out: OutFolder = Path("data/junction")) -> None:
    """The whole junction set as tracks: 65 minutes to train on, 5 to choose thresholds on, 20 times one to test."""
    for name, (minutes, seed, start_s) in junction.JUNCTION_SET.items():
        _write(out / f"{name}.tracks", junction.simulate_junction(minutes, seed, start_s))


@app.command("drive-set")
def simulate_drive_set(out: OutFolder) -> None:
    """Twenty drives of a minute as tracks, each with true poses, with wheel odometry, and with a laser beside its way;
    and the junction's test minutes with lasers on two corners.
    """
    for name, tracks in drives.drive_set():
        _write(out / f"{name}.tracks", tracks)


@app.command("worlds")
def simulate_worlds(
    out: OutFolder,
    count: Annotated[int, typer.Option(min=1, max=100_000, help="Number of worlds, with successive seeds")] = 1,
    minutes: Annotated[float, typer.Option(metavar="MINUTES", help="Duration of each world")] = 1.0,
    seed: Annotated[int, typer.Option(min=0, max=2**31 - 1, help="Seed of the first world")] = 1,
) -> None:
    """Small places indoors and outdoors, no two alike, each with its laser, as tracks (needs the extra `sim`).

    Each world depends on its own seed only. A world that is already in the folder is kept.
    """
    try:
        from gridtrack.simulation import worlds
    except ModuleNotFoundError as missing:
        if missing.name not in ("jupedsim", "shapely"):
            raise
        raise ConfigurationError("simulating worlds needs JuPedSim: pip install 'gridtrack[sim]'") from None
    for number in range(seed, seed + count):
        path = out / f"{worlds.world_name(number)}.tracks"
        if not path.exists():
            write_recording(path, worlds.simulate_world(number, minutes))
        elif read_tracks(path).info.recording.command != worlds.world_command(number, minutes):
            raise RecordingError(f"{path}: there is another recording of this name; take another folder")
        typer.echo(printable(f"{path}: {worlds.summary_of(read_tracks(path))}"))


@app.command("tracks")
@settings_options(Video, "site")
def simulate_tracks(
    values: dict[str, Any],
    source: Annotated[Path, typer.Argument(metavar="FILE", help="The annotations")],
    out: Out,
    site: Annotated[str | None, typer.Option(metavar="SITE", help="The site; default: the name of the result")] = None,
    layout: Annotated[
        str,
        typer.Option("--format", help=f"{SDD}: the Stanford Drone Dataset's annotations", autocompletion=lambda: [SDD]),
    ] = SDD,
) -> None:
    """A simulated laser among annotated road users: recorded paths, with ground truth for all of them.

    Exit code: 0 correct, 2 wrong use, 3 a road user moves through the laser.
    """
    if layout != SDD:
        raise ConfigurationError(f"--format {layout}: known is {SDD}, the Stanford Drone Dataset's")
    check_suffix(out)
    video = validated(Video, {"site": site or out.stem, **values}, "simulate tracks")
    _write(out, read_stanford(source, video, _command(source, out, video)))


def _command(source: Path, out: Path, video: Video) -> str:
    """The command line that repeats the simulation, without the folders of this machine."""
    options = {
        "scale": video.scale,
        "site": video.site,
        "rate": video.rate_hz,
        "grid": video.grid,
        "laser-at": video.laser_at and ",".join(f"{coordinate:.12g}" for coordinate in video.laser_at),
        "seed": video.seed,
        "licence": video.licence,
        "credit": video.credit,
    }
    words = ["gridtrack", "simulate", "tracks", "--format", SDD, source.name, "--out", out.name]
    for name, value in options.items():
        if value is not None and value != "":
            words += [f"--{name}", f"{value}"]
    return shlex.join(words)


@app.command("check")
def check_tracks(
    tracks: Annotated[list[Path], typer.Argument(metavar="TRACKS", help="Recordings as .tracks files")],
    as_json: JsonOption = False,
) -> None:
    """The traffic in the window of a .tracks file, and its faults: collisions with walls or the laser, gridlock.

    Exit code: 0 correct, 2 wrong use, 3 a fault was found.
    """
    found = {path: check_traffic(read_tracks(path)) for path in tracks}
    if as_json:
        records = [{"tracks": str(path), **asdict(traffic)} for path, traffic in found.items()]
        typer.echo(json.dumps(records, indent=1))
    else:
        for path, traffic in found.items():
            _print_traffic(path, traffic)
    if any(traffic.faults for traffic in found.values()):
        raise typer.Exit(FAULTY)


def _write(path: Path, tracks: Tracks) -> None:
    """Write a recording and print its traffic. Raises Exit for traffic with faults."""
    write_recording(path, tracks)
    traffic = check_traffic(tracks)
    _print_traffic(path, traffic)
    if traffic.faults:
        raise typer.Exit(FAULTY)


def _print_traffic(path: Path, traffic: Traffic) -> None:
    typer.echo("\n".join([printable(str(path)), *(f"  {printable(line)}" for line in str(traffic).splitlines())]))

"""`simulate`: recordings with ground truth, of a junction, of small worlds or of annotated tracks."""

from __future__ import annotations

import json
import shlex
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from gridtrack.cli.options import JsonOption, default_of, seconds, seconds_text, with_defaults
from gridtrack.common.errors import ConfigurationError, printable

if TYPE_CHECKING:
    from gridtrack.simulation.stanford import Video
    from gridtrack.simulation.tracks import Tracks
    from gridtrack.simulation.traffic import Traffic

app = typer.Typer(
    no_args_is_help=True, help="Recordings with ground truth: junction, junction-set, drive-set, worlds, tracks, check."
)
FAULTY = 3
SDD = "sdd"
"""The format of the Stanford Drone Dataset's annotations."""

Out = Annotated[Path, typer.Option(help="The recording to write: .tracks, rendered on first use, or .mcap, scans")]


def _junction_defaults() -> dict[str, str]:
    from gridtrack.simulation.junction import WARM_UP_S

    return {"start": seconds_text(WARM_UP_S), "carrier": "car", "odometry_noise": "0"}


def _tracks_defaults() -> dict[str, str]:
    from gridtrack.simulation.stanford import Video

    fields = {"rate": "rate_hz", "grid": "grid", "seed": "seed"}
    return {option: str(default_of(Video, field)) for option, field in fields.items()}


@app.command("junction", cls=with_defaults(_junction_defaults))
def junction_command(
    minutes: Annotated[float, typer.Option(help="Duration of the recording")],
    out: Out,
    seed: Annotated[int, typer.Option(min=0, max=2**31 - 1)] = 1,
    start: Annotated[
        str | None,
        typer.Option(help="Omitted at the beginning, while the streets fill"),
    ] = None,
    sensor: Annotated[
        Literal["corner", "corners", "drive", "beside"],
        typer.Option(
            help="A laser on the corner; two on opposite corners; one that drives through; one that stands beside the"
            " way of that drive"
        ),
    ] = "corner",
    carrier: Annotated[
        Literal["car", "robot"] | None,
        typer.Option(help="What drives through: a car, or a delivery robot  [default: car]"),
    ] = None,
    odometry_noise: Annotated[
        float | None,
        typer.Option(help="Poses of a drive are those of wheel odometry, with so many times its errors"),
    ] = None,
) -> None:
    """A laser at a signalled junction with pedestrians, cyclists, cars and buses (needs the extra `sim`).

    Exit code: 0 correct, 2 wrong use, 3 a road user moves through a wall, or gridlock.
    """
    from gridtrack.simulation.junction import ONE_CORNER, TWO_CORNERS, WARM_UP_S
    from gridtrack.simulation.junction import simulate_junction as simulate
    from gridtrack.simulation.junction.drives import MAX_ODOMETRY_NOISE, simulate_drive
    from gridtrack.simulation.tracks_file import check_suffix, write_recording

    check_suffix(out)
    start_s = WARM_UP_S if start is None else seconds(start)
    if carrier is not None and sensor not in ("drive", "beside"):
        raise ConfigurationError(f"--carrier {carrier}: only with --sensor drive or --sensor beside")
    if odometry_noise is not None and sensor != "drive":
        raise ConfigurationError(f"--odometry-noise {odometry_noise:g}: only with --sensor drive")
    if not 0.0 <= (odometry_noise or 0.0) <= MAX_ODOMETRY_NOISE:
        raise ConfigurationError(f"--odometry-noise {odometry_noise:g}: expected 0 to {MAX_ODOMETRY_NOISE:g}")
    if sensor in ("corner", "corners"):
        tracks = simulate(minutes, seed, start_s, ONE_CORNER if sensor == "corner" else TWO_CORNERS)
    else:
        drive = simulate_drive(minutes, seed, start_s, carrier or "car")
        tracks = drive.beside() if sensor == "beside" else drive.carried(odometry_noise or 0.0)
    write_recording(out, tracks)
    _report(out, tracks)


@app.command("junction-set")
def simulate_junction_set(
    out: Annotated[Path, typer.Option(help="Folder of the set")] = Path("data/junction"),
) -> None:
    """The whole junction set as tracks: 65 minutes to train on, 5 to choose thresholds on, 20 times one to test."""
    from gridtrack.simulation.junction import JUNCTION_SET
    from gridtrack.simulation.junction import simulate_junction as simulate
    from gridtrack.simulation.tracks_file import write_recording

    for name, (minutes, seed, start_s) in JUNCTION_SET.items():
        tracks = simulate(minutes, seed, start_s)
        write_recording(out / f"{name}.tracks", tracks)
        _report(out / f"{name}.tracks", tracks)


@app.command("drive-set")
def simulate_drive_set(out: Annotated[Path, typer.Option(help="Folder of the set")]) -> None:
    """Twenty drives of a minute as tracks, each with true poses, with wheel odometry, and with a laser beside its way;
    and the junction's test minutes with lasers on two corners.
    """
    from gridtrack.simulation.junction.drives import drive_set
    from gridtrack.simulation.tracks_file import write_recording

    for name, tracks in drive_set():
        write_recording(out / f"{name}.tracks", tracks)
        _report(out / f"{name}.tracks", tracks)


@app.command("worlds")
def simulate_worlds(
    out: Annotated[Path, typer.Option(help="Folder of the worlds")],
    count: Annotated[int, typer.Option(min=1, max=100_000, help="Number of worlds, with successive seeds")] = 1,
    minutes: Annotated[float, typer.Option(help="Duration of each")] = 1.0,
    seed: Annotated[int, typer.Option(min=0, max=2**31 - 1, help="Of the first world")] = 1,
) -> None:
    """Small places indoors and outdoors, no two alike, each with its laser, as tracks (needs the extra `sim`).

    Each world depends on its own seed only. A world that is already in the folder is kept.
    """
    from gridtrack.common.errors import RecordingError
    from gridtrack.simulation.tracks_file import read_tracks, write_recording

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


@app.command("tracks", cls=with_defaults(_tracks_defaults))
def simulate_tracks(
    source: Annotated[Path, typer.Argument(metavar="FILE")],
    out: Out,
    scale: Annotated[float, typer.Option(help="Metres to a pixel")],
    layout: Annotated[
        str,
        typer.Option("--format", help=f"{SDD}: the Stanford Drone Dataset's annotations", autocompletion=lambda: [SDD]),
    ] = SDD,
    site: Annotated[str | None, typer.Option(help="The site; default: the name of the result")] = None,
    rate: Annotated[float | None, typer.Option(help="Scans per second")] = None,
    grid: Annotated[str | None, typer.Option(help=r"CELLSxMETRES\[@X,Y] round the laser")] = None,
    laser_at: Annotated[
        str | None, typer.Option(metavar="X,Y", help="Metres from the image's upper left corner, y up; default: clear")
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Of the range noise")] = None,
    licence: str | None = None,
    credit: str | None = None,
) -> None:
    """A simulated laser among annotated road users: recorded paths, with ground truth for all of them.

    Exit code: 0 correct, 2 wrong use, 3 a road user moves through the laser.
    """
    from gridtrack.common.config import validated
    from gridtrack.simulation.stanford import Video, read_stanford
    from gridtrack.simulation.tracks_file import check_suffix, write_recording

    if layout != SDD:
        raise ConfigurationError(f"--format {layout}: known is {SDD}, the Stanford Drone Dataset's")
    check_suffix(out)
    given: dict[str, Any] = {
        "scale": scale,
        "site": site or out.stem,
        "rate_hz": rate,
        "grid": grid,
        "laser_at": laser_at and laser_at.split(","),
        "seed": seed,
        "licence": licence,
        "credit": credit,
    }
    video = validated(Video, {name: value for name, value in given.items() if value is not None}, "simulate tracks")
    tracks = read_stanford(source, video, _command(source, out, video))
    write_recording(out, tracks)
    _report(out, tracks)


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
    tracks: Annotated[list[Path], typer.Argument(metavar="TRACKS...")], as_json: JsonOption = False
) -> None:
    """The traffic in the window of a .tracks file, and its faults: collisions with walls or the laser, gridlock.

    Exit code: 0 correct, 2 wrong use, 3 a fault was found.
    """
    from gridtrack.simulation.tracks_file import read_tracks
    from gridtrack.simulation.traffic import check_traffic

    found = {path: check_traffic(read_tracks(path)) for path in tracks}
    if as_json:
        records = [{"tracks": str(path), **asdict(traffic)} for path, traffic in found.items()]
        typer.echo(json.dumps(records, indent=1))
    else:
        for path, traffic in found.items():
            _print_traffic(path, traffic)
    if any(traffic.faults for traffic in found.values()):
        raise typer.Exit(FAULTY)


def _report(path: Path, tracks: Tracks) -> None:
    from gridtrack.simulation.traffic import check_traffic

    traffic = check_traffic(tracks)
    _print_traffic(path, traffic)
    if traffic.faults:
        raise typer.Exit(FAULTY)


def _print_traffic(path: Path, traffic: Traffic) -> None:
    typer.echo("\n".join([printable(str(path)), *(f"  {printable(line)}" for line in str(traffic).splitlines())]))

"""`simulate`: recordings with ground truth, of a junction or of annotated tracks."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gridtrack.cli.options import seconds
from gridtrack.common.errors import ConfigurationError, printable

if TYPE_CHECKING:
    from gridtrack.simulation.tracks import Tracks

app = typer.Typer(no_args_is_help=True, help="Recordings with ground truth: junction, junction-set, tracks, check.")
FAULTY = 3

Out = Annotated[Path, typer.Option(help="The recording to write: .tracks, rendered on first use, or .mcap, scans")]


@app.command("junction")
def junction_command(
    minutes: Annotated[float, typer.Option(help="Duration of the recording")],
    out: Out,
    seed: Annotated[int, typer.Option(min=0, max=2**31 - 1)] = 1,
    start: Annotated[str, typer.Option(help="Omitted at the beginning, while the streets fill")] = "300s",
) -> None:
    """A laser at a signalled junction with pedestrians, cyclists, cars and buses (needs the extra `sim`).

    Exit code: 0 correct, 2 wrong use, 3 a road user moves through a wall, or gridlock.
    """
    from gridtrack.simulation.junction import simulate_junction as simulate
    from gridtrack.simulation.writing import check_suffix, write_recording

    check_suffix(out)
    tracks = simulate(minutes, seed, seconds(start))
    write_recording(out, tracks)
    _report(out, tracks)


@app.command("junction-set")
def simulate_junction_set(
    out: Annotated[Path, typer.Option(help="Folder of the set")] = Path("data/junction"),
) -> None:
    """The whole junction set as tracks: 65 minutes to train on, 5 to choose thresholds on, 20 times one to test."""
    from gridtrack.simulation.junction import JUNCTION_SET
    from gridtrack.simulation.junction import simulate_junction as simulate
    from gridtrack.simulation.writing import write_recording

    for name, (minutes, seed, start_s) in JUNCTION_SET.items():
        tracks = simulate(minutes, seed, start_s)
        write_recording(out / f"{name}.tracks", tracks)
        _report(out / f"{name}.tracks", tracks)


@app.command("tracks")
def simulate_tracks(
    source: Annotated[Path, typer.Argument(metavar="FILE")],
    out: Out,
    scale: Annotated[float, typer.Option(help="Metres to a pixel")],
    layout: Annotated[str, typer.Option("--format", help="sdd: the Stanford Drone Dataset's annotations")] = "sdd",
    site: Annotated[str | None, typer.Option(help="The site; default: the name of the result")] = None,
    rate: Annotated[float, typer.Option(help="Scans per second")] = 8.0,
    grid: Annotated[str, typer.Option(help="CELLSxMETRES[@X,Y] round the laser")] = "100x0.2",
    laser_at: Annotated[
        str | None, typer.Option(metavar="X,Y", help="Metres from the image's upper left corner, y up; default: clear")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the range noise")] = 0,
    licence: str = "",
    credit: str = "",
) -> None:
    """A simulated laser among annotated road users: recorded paths, with ground truth for all of them.

    Exit code: 0 correct, 2 wrong use, 3 a road user moves through the laser.
    """
    from gridtrack.common.config import validated
    from gridtrack.simulation.stanford import Video, read_stanford
    from gridtrack.simulation.writing import check_suffix, write_recording

    if layout != "sdd":
        raise ConfigurationError(f"--format {layout}: known is sdd, the Stanford Drone Dataset's")
    check_suffix(out)
    values: dict[str, Any] = {
        "scale": scale,
        "site": site or out.stem,
        "rate_hz": rate,
        "grid": grid,
        "laser_at": None if laser_at is None else laser_at.split(","),
        "seed": seed,
        "licence": licence,
        "credit": credit,
    }
    tracks = read_stanford(source, validated(Video, values, "simulate tracks"), _command(source, out, values))
    write_recording(out, tracks)
    _report(out, tracks)


def _command(source: Path, out: Path, values: dict[str, Any]) -> str:
    """The command line that repeats the simulation, without the folders of this machine."""
    names = {
        "scale": "scale",
        "site": "site",
        "rate_hz": "rate",
        "grid": "grid",
        "laser_at": "laser-at",
        "seed": "seed",
    }
    words = ["gridtrack", "simulate", "tracks", "--format", "sdd", source.name, "--out", out.name]
    for key, name in {**names, "licence": "licence", "credit": "credit"}.items():
        if values[key] is not None and values[key] != "":
            words += [f"--{name}", ",".join(values[key]) if key == "laser_at" else f"{values[key]}"]
    return shlex.join(words)


@app.command("check")
def check_tracks(tracks: Annotated[list[Path], typer.Argument(metavar="TRACKS...")]) -> None:
    """The traffic in the window of a .tracks file, and its faults: collisions with walls or the laser, gridlock.

    Exit code: 0 correct, 2 wrong use, 3 a fault was found.
    """
    from gridtrack.simulation.tracks import read_tracks

    for path in tracks:
        _report(path, read_tracks(path))


def _report(path: Path, tracks: Tracks) -> None:
    from gridtrack.simulation.traffic import examine

    traffic = examine(tracks)
    typer.echo("\n".join([printable(str(path)), *(f"  {printable(line)}" for line in str(traffic).splitlines())]))
    if traffic.faults:
        raise typer.Exit(FAULTY)

"""`simulate`: recordings whose truth is known, of a junction or of annotated tracks."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gridtrack.cli.options import seconds
from gridtrack.common.errors import plain

if TYPE_CHECKING:
    from gridtrack.common.simulation.tracks import Tracks

app = typer.Typer(no_args_is_help=True, help="Recordings whose truth is known: junction, junction-set, check.")
FAULTY = 3

Out = Annotated[Path, typer.Option(help="The recording to write: .tracks, rendered on first use, or .mcap, scans")]


@app.command("junction")
def simulate_junction(
    minutes: Annotated[float, typer.Option(min=0.01, max=24 * 60.0)],
    out: Out,
    seed: Annotated[int, typer.Option(min=0, max=2**31 - 1)] = 1,
    start: Annotated[str, typer.Option(help="Left out at the beginning, while the streets fill")] = "300s",
) -> None:
    """A laser at a signalled junction with pedestrians, cyclists, cars and buses (needs the extra `sim`).

    Exit code: 0 as it should be, 2 wrong use, 3 somebody walks through a wall or the traffic stands.
    """
    from gridtrack.common.simulation.junction import simulate_junction as simulate
    from gridtrack.common.simulation.writing import refuse_other_suffix, write_recording

    refuse_other_suffix(out)
    tracks = simulate(minutes, seed, seconds(start))
    write_recording(out, tracks)
    _report(out, tracks)


@app.command("junction-set")
def simulate_junction_set(
    out: Annotated[Path, typer.Option(help="Folder of the set")] = Path("data/junction"),
) -> None:
    """The whole junction set as tracks: 65 minutes to train on, 5 to choose thresholds on, 20 times one to test."""
    from gridtrack.common.simulation.junction import JUNCTION_SET
    from gridtrack.common.simulation.junction import simulate_junction as simulate
    from gridtrack.common.simulation.writing import write_recording

    for name, (minutes, seed) in JUNCTION_SET.items():
        tracks = simulate(minutes, seed)
        write_recording(out / f"{name}.tracks", tracks)
        _report(out / f"{name}.tracks", tracks)


@app.command("check")
def check_tracks(tracks: Annotated[list[Path], typer.Argument(metavar="TRACKS...")]) -> None:
    """Who moves through the window of a .tracks file, and whether anybody walks through walls or all stand.

    Exit code: 0 as it should be, 2 wrong use, 3 not.
    """
    from gridtrack.common.simulation.tracks import read_tracks

    for path in tracks:
        _report(path, read_tracks(path))


def _report(path: Path, tracks: Tracks) -> None:
    from gridtrack.common.simulation.traffic import examine

    traffic = examine(tracks)
    typer.echo("\n".join([plain(str(path)), *(f"  {plain(line)}" for line in str(traffic).splitlines())]))
    if traffic.faults:
        raise typer.Exit(FAULTY)

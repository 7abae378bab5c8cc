"""The command line: arguments in, library calls, print; a failure that a user can cause is one line and exit 2."""

from __future__ import annotations

import sys
from typing import Annotated, NoReturn

import typer

from gridtrack.cli import recordings, regress, runs, simulate, trackers
from gridtrack.common.errors import GridtrackError, plain

Debug = Annotated[
    bool, typer.Option("--debug", help="Anywhere on the line: show a traceback where an error would be one line")
]

app = typer.Typer(no_args_is_help=True, add_completion=False, help="Occupancy-grid trackers under one referee.")
app.command()(runs.compare)
app.command()(runs.report)
app.command()(regress.regress)
app.command()(trackers.train)
app.add_typer(trackers.app, name="trackers")
app.add_typer(recordings.app, name="recording")
app.add_typer(simulate.app, name="simulate")


@app.callback()
def everywhere(debug: Debug = False) -> None:
    """What every command takes; `main` reads it wherever it stands."""


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

"""The command line `gridtrack`: its commands, and every user error as one line on stderr with exit code 2."""

from __future__ import annotations

import signal
import sys
import traceback
from typing import Annotated, NoReturn

import typer

from gridtrack.cli import recordings, regress, report, runs, simulate, trackers
from gridtrack.cli.completion import words_as_typed
from gridtrack.cli.options import DEBUG_OPTION, print_note, with_defaults
from gridtrack.common.errors import ConfigurationError, GridtrackError
from gridtrack.common.names import check_utf8


def _print_version(requested: bool) -> None:
    if requested:
        import gridtrack

        typer.echo(f"gridtrack {gridtrack.__version__}")
        raise typer.Exit


DebugOption = Annotated[
    bool,
    typer.Option(DEBUG_OPTION, help="Show the traceback of an error; accepted before and after the name of a command"),
]
VersionOption = Annotated[
    bool, typer.Option("--version", help="Print the version and exit", callback=_print_version, is_eager=True)
]

STARTS_TRACKERS = ("compare", "train", "trackers")
"""Commands that run the code of trackers in processes below this one."""

app = typer.Typer(
    no_args_is_help=True,
    help="Compare trackers on occupancy grids: the same frames, the same scores, statistics with intervals.",
)
app.command("compare", cls=with_defaults(runs.compare_defaults, runs.compare_helps))(runs.compare_command)
app.command("report")(report.report_command)
app.command("regress", cls=with_defaults(regress.regress_defaults))(regress.regress_command)
app.command("train", cls=with_defaults(trackers.train_defaults))(trackers.train_command)
app.add_typer(trackers.app, name="trackers")
app.add_typer(recordings.app, name="recording")
app.add_typer(simulate.app, name="simulate")


@app.callback()
def common_options(debug: DebugOption = False, version: VersionOption = False) -> None:
    """Options of every command. `main` reads --debug itself, so that it can follow the name of a command."""


def main() -> None:
    """Run the command line. An error of the user is one line and exit code 2; `--debug` also shows its traceback.

    SIGTERM, with which a scheduler ends a job, does what Ctrl-C does: results so far are kept.
    """
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    arguments = [argument for argument in sys.argv[1:] if argument != DEBUG_OPTION]
    if arguments and arguments[0] in STARTS_TRACKERS:
        from gridtrack.evaluation.hosting.shielding import shield_host

        shield_host(f"gridtrack {arguments[0]}")
    try:
        for argument in sys.argv[1:]:
            check_utf8(argument, ConfigurationError)
        with words_as_typed():
            app(arguments)
    except GridtrackError as error:
        _fail(error, str(error))
    except OSError as error:
        _fail(error, f"{error.filename}: {error.strerror}" if error.filename else str(error))


def _fail(error: Exception, reason: str) -> NoReturn:
    if DEBUG_OPTION in sys.argv:
        traceback.print_exception(error)
    print_note(reason)
    sys.exit(2)

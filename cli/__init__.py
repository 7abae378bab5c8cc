"""The command line `gridtrack`: its commands, and every user error as one line on stderr with exit code 2.

A recording in which nothing was measured, and a crash, such as of a broken library, have exit code 3: 1 is the verdict
"worse" of `regress`.
"""

from __future__ import annotations

import signal
import sys
import traceback
from contextlib import AbstractContextManager, nullcontext
from importlib import import_module
from typing import Annotated, Any, NoReturn

import typer
from typer import TyperException
from typer.core import TyperCommand

from gridtrack.cli.completion import words_as_typed
from gridtrack.cli.options import DEBUG_OPTION, print_note
from gridtrack.common.errors import ConfigurationError, GridtrackError
from gridtrack.common.files import check_utf8

COMMANDS = {
    "compare": "Run trackers on recordings, each in its own process, score them, and write a report.",
    "report": "Write the report of a run again, or of several runs side by side: as a page, or in another format.",
    "regress": "Compare a run with a baseline: is any tracker worse?",
    "train": "Train a tracker for a site or, with --general, for any site.",
    "trackers": "The trackers: list, show, check, new.",
    "suite": "Suites of recordings with published rows: list, run, row, page.",
    "recording": "Recordings: info, import, view, layout.",
    "simulate": "Recordings with ground truth: junction, junction-set, drive-set, worlds, tracks, check.",
}
"""The commands, each in the module of its name, and their help."""
STARTS_TRACKERS = ("compare", "regress", "suite", "train", "trackers")
"""Commands that run the code of trackers in processes below this one."""
CRASHED = 3
ENDS = (signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
"""Signals that end a command like Ctrl-C."""


class LazyCommand(TyperCommand):
    """A command with a module that is imported when the command is used, not for the help of another one."""

    def load(self) -> Any:
        """The command itself, or the group of commands."""
        command = typer.main.get_command(import_module(f"gridtrack.cli.{self.name}").app)
        command.help = command.help or self.help
        return command

    def make_context(self, *arguments: Any, **named: Any) -> Any:
        """The context of the command itself: parsing, help and completion start from it."""
        return self.load().make_context(*arguments, **named)


app = typer.Typer(
    no_args_is_help=True,
    help="Compare trackers on occupancy grids: the same frames, the same scores, statistics with intervals.",
)
for _name, _help in COMMANDS.items():
    app.command(_name, help=_help, cls=LazyCommand)(lambda: None)


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


@app.callback()
def common_options(debug: DebugOption = False, version: VersionOption = False) -> None:
    """Options of every command. `main` reads --debug itself, so that it can follow the name of a command."""


def main() -> None:
    """Run the command line. An error of the user is one line and exit code 2; `--debug` also shows its traceback.

    SIGTERM, with which a scheduler ends a job, SIGHUP and SIGQUIT have the effect of Ctrl-C: results so far are kept.
    """
    for number in ENDS:
        if signal.getsignal(number) != signal.SIG_IGN:  # nohup ignores SIGHUP
            signal.signal(number, signal.default_int_handler)
    arguments = [argument for argument in sys.argv[1:] if argument != DEBUG_OPTION]
    try:
        for argument in sys.argv[1:]:
            check_utf8(argument, ConfigurationError)
        with _shield(arguments), words_as_typed():
            code = app(arguments, prog_name="gridtrack", standalone_mode=False)
        sys.exit(code)
    except TyperException as error:
        _fail(error, _usage_text(error))
    except GridtrackError as error:
        _fail(error, str(error), error.exit_code)
    except OSError as error:
        _fail(error, f"{error.filename}: {error.strerror}" if error.filename else str(error))
    except Exception as error:  # noqa: BLE001  no crash may look like the verdict "worse"
        traceback.print_exception(error)
        sys.exit(CRASHED)


def _shield(arguments: list[str]) -> AbstractContextManager[None]:
    """Hide the arguments of this process from trackers that it starts."""
    if not arguments or arguments[0] not in STARTS_TRACKERS:
        return nullcontext()
    from gridtrack.evaluation.hosting.host import shielded_host

    return shielded_host(f"gridtrack {arguments[0]}", alone=True)


def _usage_text(error: TyperException) -> str:
    """A wrong option or a missing argument, and the command that lists them."""
    context = getattr(error, "ctx", None)
    text: str = getattr(error, "format_message", error.__str__)()
    return f"{text.rstrip('.')} (see `{context.command_path if context else 'gridtrack'} --help`)"


def _fail(error: Exception, reason: str, code: int = 2) -> NoReturn:
    if DEBUG_OPTION in sys.argv:
        traceback.print_exception(error)
    print_note(reason)
    sys.exit(code)

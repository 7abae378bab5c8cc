"""Options that several commands share, and the reading of their text."""

from __future__ import annotations

import json
import re
import shlex
import sys
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand, TyperOption

from gridtrack.common.errors import ConfigurationError, printable
from gridtrack.common.remote_files import URL, folder_name, is_url, local_folder

if TYPE_CHECKING:
    from pydantic import BaseModel

DEBUG_OPTION = "--debug"
"""Read from the command line itself, so that it can follow the name of a command."""
ROW_WEIGHTS_URL = re.compile(rf'(?<=[:,])\s*weights\s*=\s*("?)(?P<url>{URL.pattern}[^",]*)\1')
"""`weights=URL` among the options of a row."""
EXAMPLES = "For example demo.mcap@30s-90s, or s3://bucket/demo.mcap"


def fetch_recordings(given: Any) -> Any:
    """A callback: of recordings that are named by URLs the local copies. Raises RecordingError."""
    from gridtrack.recordings.stretches import fetched

    if given is None:
        return None
    if isinstance(given, str):
        return fetched(given, print_note)
    return [fetch_recordings(text) for text in given]


def print_note(line: str) -> None:
    """Print a line for the user, on stderr."""
    typer.echo(f"gridtrack: {printable(line)}", err=True)


def weights_folder(text: str) -> Path:
    """A parser: the folder of weights at a path, or the local copy of the one at a URL. Raises StoreError."""
    return local_folder(text, "weights", print_note)


def fetch_row_weights(rows: list[str] | None) -> list[str] | None:
    """A callback: of rows with `weights=URL` those with the local copies. Raises StoreError."""

    def local(match: re.Match[str]) -> str:
        return f"weights={json.dumps(str(weights_folder(match['url'])), ensure_ascii=False)}"

    return rows and [ROW_WEIGHTS_URL.sub(local, row) for row in rows]


def run_folder_at(text: str) -> Path:
    """A parser: the folder of a run at a path, or the local copy of the one at a URL. Raises StoreError."""
    return local_folder(text, "runs", print_note)


def default_report_folder(runs: Sequence[str]) -> Path | None:
    """The folder of the report where the user names none: of a run in a store `NAME-report` in the working folder, of
    several `NAME-side-by-side`; None for the run's own folder."""
    if not is_url(runs[0]):
        return None
    return Path(f"{folder_name(runs[0])}-{'report' if len(runs) == 1 else 'side-by-side'}")


RecordingArgument = Annotated[
    str,
    typer.Argument(
        metavar="RECORDING[@RANGE]",
        help=EXAMPLES,
        callback=fetch_recordings,
    ),
]
RecordingsArgument = Annotated[
    list[str],
    typer.Argument(
        metavar="RECORDING[@RANGE]...",
        help=EXAMPLES,
        callback=fetch_recordings,
    ),
]
WholeRecordingArgument = Annotated[
    str, typer.Argument(metavar="RECORDING", help="A file, a folder or a URL", callback=fetch_recordings)
]
GridOption = Annotated[str | None, typer.Option(help=r"CELLSxMETRES\[@X,Y], e.g. 100x0.2; default: the recording's")]
RateOption = Annotated[float | None, typer.Option(help="Frames per second; default: the recording's")]
WeightsOption = Annotated[
    Path | None,
    typer.Option(
        metavar="FOLDER",
        help="Folder of learned weights, or its URL, searched before the user's own and the shipped ones",
        parser=weights_folder,
    ),
]
TrackersTomlOption = Annotated[Path | None, typer.Option(help="Trackers of other environments and programs")]
SandboxOption = Annotated[
    bool,
    typer.Option(
        "--sandbox", help="Trackers see their own code and weights only: no network, no file, no process (bubblewrap)"
    ),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON")]


def with_defaults(
    defaults: Callable[[], Mapping[str, str]], helps: Callable[[], Mapping[str, str]] = dict
) -> type[TyperCommand]:
    """A command whose help shows the texts of `defaults()` and `helps()`, by the name of the parameter.

    The models of the settings hold what they are made of; these are imported for the help and not for every command.
    """

    class WithDefaults(TyperCommand):
        def format_help(self, ctx: Any, formatter: Any) -> None:
            default_texts, help_texts = defaults(), helps()
            shown = copy(self)
            shown.params = [copy(parameter) for parameter in self.params]
            for parameter in shown.params:
                name = parameter.name or ""
                parameter.default = default_texts.get(name, parameter.default)
                if isinstance(parameter, TyperOption) and name in help_texts:
                    parameter.help = help_texts[name]
            super(WithDefaults, shown).format_help(ctx, formatter)

    return WithDefaults


def default_of(model: type[BaseModel], field: str) -> Any:
    """The default of a field of settings."""
    return model.model_fields[field].default


def seconds_text(value: float) -> str:
    """Seconds as `seconds` reads them: 2.5 is `2.5s`."""
    return f"{value:g}s"


def seconds(text: str) -> float:
    """`2.5s` or `2.5` in seconds. Raises ConfigurationError."""
    try:
        return float(text.removesuffix("s"))
    except ValueError:
        raise ConfigurationError(f"'{text}': expected seconds, such as 2.5s") from None


def command_line() -> str:
    """The command as the user entered it, for run.json and for cards of learned weights."""
    return shlex.join(["gridtrack", *sys.argv[1:]])

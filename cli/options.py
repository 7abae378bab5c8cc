"""Options of commands: generated from settings, or shared by several commands."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Mapping
from functools import wraps
from pathlib import Path
from types import NoneType, UnionType
from typing import TYPE_CHECKING, Annotated, Any, Literal, Union, get_args, get_origin

import typer

from gridtrack.cli.completion import complete_row, complete_values
from gridtrack.common.errors import printable
from gridtrack.common.remote_files import local_folder

if TYPE_CHECKING:
    from pydantic import BaseModel
    from pydantic.fields import FieldInfo

    from gridtrack.common.options import OptionField

KEYWORD_ONLY = inspect.Parameter.KEYWORD_ONLY
DEBUG_OPTION = "--debug"
"""Read from the command line itself, so that it can follow the name of a command."""
EXAMPLES = "For example demo.mcap@30s-90s, or s3://bucket/demo.mcap"
COMPLETIONS = {"tracker": complete_row}
"""Completions of options by name, beside fixed values."""


def print_note(line: str) -> None:
    """Print a line for the user, on stderr."""
    typer.echo(f"gridtrack: {printable(line)}", err=True)


def command_line() -> list[str]:
    """The command as the user entered it, for run.json."""
    return ["gridtrack", *sys.argv[1:]]


def settings_options(model: type[BaseModel], *without: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """A decorator of a command `function(values, ...)`: it gets an option for each field of `model`.

    `values` are the values that the user gave, by field; the fields `without` an option are left out.
    """
    from gridtrack.common.options import option_fields

    options = {
        option.name.replace("-", "_"): option for option in option_fields(model) if option.path[-1] not in without
    }

    def decorate(function: Callable[..., None]) -> Callable[..., None]:
        @wraps(function)
        def command(**arguments: Any) -> None:
            given = {name: value for name in options if (value := arguments.pop(name)) is not None}
            for name, value in given.items():
                options[name].checked(value)
            function(_nested({options[name].path: value for name, value in given.items()}), **arguments)

        _, *own = inspect.signature(function, eval_str=True).parameters.values()
        generated = [_parameter(name, option) for name, option in options.items()]
        named = [parameter.replace(kind=KEYWORD_ONLY) for parameter in own]
        vars(command)["__signature__"] = inspect.Signature([*generated, *named])
        return command

    return decorate


def _nested(given: Mapping[tuple[str, ...], Any]) -> dict[str, Any]:
    """Values by field, and by field within a field that holds a model."""
    values: dict[str, Any] = {}
    for (*above, name), value in given.items():
        inner = values
        for part in above:
            inner = inner.setdefault(part, {})
        inner[name] = value
    return values


def _parameter(name: str, option: OptionField) -> inspect.Parameter:
    """The parameter of a command from which typer makes the option."""
    from gridtrack.common.field_docs import field_docs

    field, kind, annotation = option.field, *_types(option.field)
    about = field_docs(option.model).get(option.path[-1], "")
    literals = get_args(kind) if get_origin(kind) is Literal else ()
    shown: dict[str, Any] = {
        "help": " ".join(about.split()).replace("[", r"\[") + _default_text(option),
        "metavar": option.metavar or "|".join(literals) or None,
        "autocompletion": COMPLETIONS.get(name) or complete_values(kind, literals),
    }
    flag = f"--{option.name}/--no-{option.name}" if field.default is True else f"--{option.name}"
    made = typer.Argument(**shown) if option.own.argument else typer.Option(flag, **shown)
    default = inspect.Parameter.empty if field.is_required() else None
    optional = annotation if field.is_required() else annotation | None
    return inspect.Parameter(name, KEYWORD_ONLY, default=default, annotation=Annotated[optional, made])


def _types(field: FieldInfo) -> tuple[Any, Any]:
    """The type of a field without None, and the type of its option: text, if the settings read the field from text."""
    from pydantic import BeforeValidator

    union = get_origin(field.annotation) in (Union, UnionType)
    kind = next(one for one in get_args(field.annotation) if one is not NoneType) if union else field.annotation
    metadata = [*field.metadata, *getattr(kind, "__metadata__", ())]
    kind = get_args(kind)[0] if get_origin(kind) is Annotated else kind
    if get_origin(kind) is dict or Ellipsis in get_args(kind):
        return kind, list[str]
    is_text = any(isinstance(one, BeforeValidator) for one in metadata)
    return kind, kind if kind in (bool, int, float) and not is_text else str


def _default_text(option: OptionField) -> str:
    """The end of the help of an option: its default, if it has one."""
    default = option.field.get_default(call_default_factory=True)
    if option.field.is_required() or default is None or default is False or default in ("", (), {}):
        return ""
    text = f"{default:g}s" if option.metavar == "SECONDS" else str(default)
    return rf" \[default: {text}]"


def fetch_recording(given: str | None) -> str | None:
    """A callback: a recording, or the local copy of one at a URL. Raises StoreError."""
    from gridtrack.recordings.stretches import fetched

    return given and fetched(given, print_note)


def weights_folder(text: str) -> Path:
    """A parser: the folder of weights at a path, or a local copy of the one at a URL. Raises StoreError."""
    return local_folder(text, "weights", print_note)


def run_folder_at(text: str) -> Path:
    """A parser: the folder of a run at a path, or a local copy of the one at a URL. Raises StoreError."""
    return local_folder(text, "runs", print_note)


RecordingArgument = Annotated[str, typer.Argument(metavar="RECORDING[@RANGE]", help=EXAMPLES, callback=fetch_recording)]
WholeRecordingArgument = Annotated[
    str, typer.Argument(metavar="RECORDING", help="A file, a folder or a URL", callback=fetch_recording)
]
GridOption = Annotated[
    str | None,
    typer.Option(metavar="CELLSxMETRES[@X,Y]", help="Grid, such as 100x0.2; default: the grid of the recording"),
]
RateOption = Annotated[
    float | None, typer.Option(metavar="HZ", help="Frames per second; default: the rate of the recording")
]
WeightsOption = Annotated[
    Path | None,
    typer.Option(
        metavar="FOLDER",
        help="Folder of learned weights, or its URL, searched before your own and the shipped ones",
        parser=weights_folder,
    ),
]
TrackersTomlOption = Annotated[
    Path | None, typer.Option(metavar="FILE", help="File that names trackers of other environments, and programs")
]
SandboxOption = Annotated[
    bool,
    typer.Option(
        "--sandbox", help="Trackers see their own code and weights only: no network, no file, no process (bubblewrap)"
    ),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON")]

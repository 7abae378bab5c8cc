"""What several commands take: arguments, options, and how their texts are read."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from gridtrack.common.errors import ConfigurationError

Recordings = Annotated[list[str], typer.Argument(metavar="RECORDING[@RANGE]...", help="e.g. demo.mcap@30s-90s")]
Grid = Annotated[str | None, typer.Option(help="CELLSxMETRES[@X,Y], e.g. 100x0.2; default: the recording's")]
Rate = Annotated[float | None, typer.Option(help="Frames per second; default: the recording's")]
Weights = Annotated[Path | None, typer.Option(help="Folder of trained weights, before your own and the shipped ones")]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON")]


def seconds(text: str) -> float:
    """`2.5s` or `2.5` in seconds. Raises ConfigurationError."""
    try:
        return float(text.removesuffix("s"))
    except ValueError:
        raise ConfigurationError(f"'{text}': expected seconds, such as 2.5s") from None


def command_line() -> str:
    """The command as typed, to be kept with its results."""
    return shlex.join(["gridtrack", *sys.argv[1:]])

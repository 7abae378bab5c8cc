"""Options that several commands share, and the reading of their text."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from gridtrack.common.errors import ConfigurationError

RecordingsArgument = Annotated[
    list[str], typer.Argument(metavar="RECORDING[@RANGE]...", help="For example demo.mcap@30s-90s")
]
GridOption = Annotated[str | None, typer.Option(help="CELLSxMETRES[@X,Y], e.g. 100x0.2; default: the recording's")]
RateOption = Annotated[float | None, typer.Option(help="Frames per second; default: the recording's")]
WeightsOption = Annotated[
    Path | None, typer.Option(help="Folder of learned weights, searched before the user's own and the shipped ones")
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON")]


def seconds(text: str) -> float:
    """`2.5s` or `2.5` in seconds. Raises ConfigurationError."""
    try:
        return float(text.removesuffix("s"))
    except ValueError:
        raise ConfigurationError(f"'{text}': expected seconds, such as 2.5s") from None


def command_line() -> str:
    """The command as the user entered it, for run.json and for cards of learned weights."""
    return shlex.join(["gridtrack", *sys.argv[1:]])

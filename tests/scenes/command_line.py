"""The command line in this process: its output, and its exit code."""

from __future__ import annotations

import io
import signal
import sys
from contextlib import redirect_stderr, redirect_stdout
from typing import NamedTuple
from unittest.mock import patch

from gridtrack.cli import ENDS, main


class Ended(NamedTuple):
    """The output of a command."""

    stdout: str
    stderr: str


def gridtrack(*arguments: object, code: int = 0) -> Ended:
    """Run `gridtrack ARGUMENTS`, which must end with the exit code `code`."""
    out, err = (io.TextIOWrapper(io.BytesIO(), "utf-8", write_through=True) for _ in range(2))
    ended: object = 0
    handlers = {number: signal.getsignal(number) for number in ENDS}
    with patch.object(sys, "argv", ["gridtrack", *map(str, arguments)]), redirect_stdout(out), redirect_stderr(err):
        try:
            main()
        except SystemExit as end:
            ended = end.code or 0
        finally:
            for number, handler in handlers.items():
                signal.signal(number, handler)
    printed = Ended(*(stream.buffer.getvalue().decode() for stream in (out, err)))
    assert ended == code, printed.stdout + printed.stderr
    return printed

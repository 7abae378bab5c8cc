"""The training process: `python -m gridtrack.evaluation.runs.fit_process NAME` runs a tracker's `fit`.

Its messages are described in `training_process.py`, the other end.
"""

from __future__ import annotations

import faulthandler
import signal
import sys
import threading
import traceback
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from gridtrack.common.config import Settings, validated
from gridtrack.common.errors import INTERRUPTED_EXIT_CODE, GridtrackError, PluginError
from gridtrack.evaluation.runs.fit_regions import FitScores
from gridtrack.evaluation.runs.stretch_files import StoredStretch
from gridtrack.evaluation.runs.training_process import ProgressLines
from gridtrack.trackers import registry
from gridtrack.trackers.contract import FitTask, Tracker
from gridtrack.trackers.serve import error_line, take_wire
from gridtrack.trackers.wire import Message, encode, fill_from, receive, write_to


def main() -> None:
    """Run the `fit` of the tracker named on the command line, and exit."""
    read_fd, write_fd = take_wire()
    faulthandler.enable()
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background of a shell ignores it
    try:
        run_fit(sys.argv[1], read_fd, write_fd)
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED_EXIT_CODE)


def run_fit(name: str, read_fd: int, write_fd: int) -> None:
    """Load the tracker `name` and run its `fit`, as the messages from `read_fd` request; answers go to `write_fd`."""
    fill = fill_from(read_fd)
    sending, asking = threading.Lock(), threading.Lock()

    def send(kind: str, **fields: str | int) -> None:
        with sending:
            write_to(write_fd, encode(Message(kind, 0, fields)))

    def regions_of(number: int) -> Path:
        with asking:
            send("regions", number=number)
            return Path(receive(fill, 0).value("path", str))

    try:
        request = receive(fill, 0)
        tracker, settings = _load(name, request)
        send("loaded", starts_from_general=tracker.starts_from_general(settings))
        with ProgressLines(lambda text: send("report", text=text)) as lines:
            _fit(tracker, settings, receive(fill, 0), lines, regions_of)
        send("done")
    except Exception as error:  # noqa: BLE001 any exception of `fit` is reported to the command
        with suppress(BrokenPipeError):  # the command has ended
            send("error", **_error_fields(error))


def _load(name: str, request: Message) -> tuple[type[Tracker], Settings]:
    """The tracker `name` and its validated options. Raises PluginError, ConfigurationError."""
    tracker = registry.load(name)
    if not tracker.learns:
        raise PluginError(f"tracker '{name}' has nothing to learn: compare it as it is")
    if request.value("general", bool) and not tracker.learns_general:
        raise PluginError(f"tracker '{name}' learns one site only: train it there, without --general")
    return tracker, validated(tracker.Options, request.value("options", dict), f"tracker '{name}'")


def _fit(
    tracker: type[Tracker],
    settings: Settings,
    request: Message,
    lines: ProgressLines,
    regions_of: Callable[[int], Path],
) -> None:
    """Run `fit` on the stretches of the request; `regions_of(n)` is the file with the regions of the n-th."""
    files = {use: [Path(path) for path in request.value(use, list)] for use in ("train", "validation")}
    train, validation = ([StoredStretch(path, lines.progress) for path in paths] for paths in files.values())
    scores = FitScores([*train, *validation], regions_of)
    out, log_dir = (Path(request.value(name, str)) for name in ("out", "log_dir"))
    start = request.value("start", str)
    task = FitTask(
        train,
        validation,
        scores.score,
        out,
        settings,
        log_dir,
        request.value("seed", int),
        request.value("command", str),
        general=request.value("general", bool),
        start=Path(start) if start else None,
        report=lines.report,
        progress=lines.progress,
    )
    tracker.fit(task)


def _error_fields(error: Exception) -> dict[str, str]:
    """The fields of the answer `error`; `error` is "" for an exception that is not a user's error."""
    if isinstance(error, GridtrackError):
        return {"error": type(error).__name__, "reason": str(error), "trace": ""}
    if isinstance(error, OSError) and error.filename:
        return {"error": "GridtrackError", "reason": f"{error.filename}: {error.strerror}", "trace": ""}
    where = traceback.extract_tb(error.__traceback__)[-1]
    reason = f"{error_line(error)} ({Path(where.filename).name}, line {where.lineno})"
    return {"error": "", "reason": reason, "trace": "".join(traceback.format_exception(error))}


if __name__ == "__main__":
    main()

"""A tracker in its own process: `python -m gridtrack.trackers.serve NAME` answers the referee over stdin and stdout."""

from __future__ import annotations

import faulthandler
import gc
import json
import os
import sys
import time
import traceback
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from gridtrack.common.config import Settings, validated
from gridtrack.common.errors import ConfigurationError, GridtrackError, PluginError, WeightsError, one_line
from gridtrack.common.field_docs import documented_schema
from gridtrack.trackers import messages, registry
from gridtrack.trackers.contract import Forecast, StreamSpec, Tracker
from gridtrack.trackers.wire import MAX_HEADER, Message, WireError, encode, fill_from, receive, widen, write_to

MAX_LINE = 500


def main() -> None:
    """Serve the tracker named on the command line until the referee closes the wire."""
    read_fd, write_fd = take_wire()
    faulthandler.enable()
    server = Server(sys.argv[1])
    fill = fill_from(read_fd)
    while True:
        try:
            request = receive(fill, server.max_body)
        except EOFError:
            return
        write_to(write_fd, server.answer(request))


def take_wire() -> tuple[int, int]:
    """Move the wire away from descriptors 0 and 1, so that libraries can neither read from it nor print to it.

    Returns the descriptors to read from and to write to. Afterwards stdout is stderr, for C code and subprocesses too.
    """
    read_fd, write_fd = os.dup(0), os.dup(1)
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)
    os.dup2(2, 1)
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    widen(read_fd)
    widen(write_fd)
    return read_fd, write_fd


class Server:
    """Answers requests for the tracker `name` in their order; a failure becomes an `error` answer."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.max_body = 0
        self.stream: StreamSpec | None = None
        self.tracker: Tracker | None = None
        self._answers: dict[str, Callable[[Message], Message]] = {
            "describe": self._describe,
            "start": self._start,
            "reset": self._reset,
            "update": self._update,
            "predict": self._predict,
            "export": self._export,
        }

    def answer(self, request: Message) -> list[memoryview]:
        """The encoded answer to `request`; an exception of the tracker becomes an `error` answer."""
        try:
            return encode(self._answers.get(request.kind, self._unknown)(request))
        except Exception as error:  # noqa: BLE001 - any exception of a tracker is reported to the referee
            traceback.print_exc()
            return encode(self._failure(request, error))

    def _unknown(self, request: Message) -> Message:
        raise WireError(f"there is no request '{request.kind:.40}'")

    def _describe(self, request: Message) -> Message:
        tracker = registry.load(self.name)
        options = self._options(tracker, request.value("options", dict))
        return Message("described", request.number, _description(tracker, tracker.classes, options))

    def _start(self, request: Message) -> Message:
        kind = registry.load(self.name)
        options = self._options(kind, request.value("options", dict))
        self.stream = messages.stream_from(request)
        self.max_body = messages.update_limit(self.stream.grid)
        gc.disable()  # compiled kernels make millions of objects: to look through them takes a tenth of the time
        try:
            self.tracker = kind(self.stream, options)
        finally:
            gc.enable()
        started = {"code_sha256": registry.code_sha256(kind), "device": self.tracker.device}
        fields = _description(kind, self.tracker.classes, options) | started
        return Message("started", request.number, fields)

    def _options(self, tracker: type[Tracker], values: Mapping[str, Any]) -> Settings:
        return validated(tracker.Options, dict(values), self.name)

    def _reset(self, request: Message) -> Message:
        seed = request.value("seed", int)
        _, spent = _timed(self._running().reset, seed)
        return Message("done", request.number, spent)

    def _update(self, request: Message) -> Message:
        frame = messages.frame_from(request)
        tracker = self._running()
        _, spent = _timed(tracker.update, frame)
        return Message("done", request.number, spent | {"recoveries": tracker.recoveries})

    def _predict(self, request: Message) -> Message:
        steps = request.value("steps", int)
        forecast, spent = _timed(self._running().predict, steps)
        if not isinstance(forecast, Forecast):
            raise WireError(f"predict returned a {type(forecast).__name__}; expected a Forecast")
        fields, arrays = messages.forecast_fields(forecast)
        return Message("forecast", request.number, fields | spent, arrays)

    def _export(self, request: Message) -> Message:
        found = self._running().export(Path(request.value("folder", str)))
        return Message("exported", request.number, {"about": one_line(found, MAX_LINE)})

    def _running(self) -> Tracker:
        if self.tracker is None:
            raise WireError("no stream has been started")
        return self.tracker

    def _failure(self, request: Message, error: Exception) -> Message:
        if isinstance(error, ImportError) and request.kind in {"start", "export"}:
            error = PluginError(f"tracker '{self.name}': {error}{registry.install_hint(self.name, error)}")
        fields = {"outcome": self._outcome(request, error), "reason": error_line(error)}
        return Message("error", request.number, fields)

    def _outcome(self, request: Message, error: Exception) -> str:
        """The outcome of the trial that ends with `error`."""
        if isinstance(error, MemoryError):
            return "out-of-memory"
        if isinstance(error, PluginError):
            return "unavailable"
        if isinstance(error, WireError):
            return "invalid-output"
        if request.kind in {"describe", "start", "export"}:
            if isinstance(error, WeightsError):
                return "untrained" if self.stream is None or self.stream.weights is None else "not-applicable"
            if isinstance(error, ConfigurationError):
                return "not-applicable"
        return "crashed"


def error_line(error: BaseException) -> str:
    """`error` as one bounded line, with its type unless it is a GridtrackError."""
    text = str(error) if isinstance(error, GridtrackError) and str(error) else f"{type(error).__name__}: {error}"
    return one_line(text, MAX_LINE)


def _timed(method: Callable[[Any], Any], argument: Any) -> tuple[Any, dict[str, int]]:
    """The result of `method(argument)`, with its elapsed time and processor time in this process."""
    elapsed, cpu = time.perf_counter_ns(), time.process_time_ns()
    result = method(argument)
    return result, {"elapsed_ns": time.perf_counter_ns() - elapsed, "cpu_ns": time.process_time_ns() - cpu}


def _description(kind: type[Tracker], classes: Any, options: Settings) -> dict[str, Any]:
    if not isinstance(classes, tuple) or not all(isinstance(name, str) for name in classes):
        raise WireError(f"classes is {classes!r:.80}; expected a tuple of names")
    schema = documented_schema(kind.Options)
    return {
        "api": kind.api,
        "about": (kind.__doc__ or "").strip(),
        "classes": list(classes),
        "moving_sensor": kind.moving_sensor,
        "learns": kind.learns,
        "role": kind.role,
        "reference_for": sorted(kind.reference_for),
        "options": options.model_dump(mode="json"),
        "options_schema": schema if len(json.dumps(schema)) < MAX_HEADER // 2 else {},
    }


if __name__ == "__main__":
    main()

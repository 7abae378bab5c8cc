"""Requests to a tracker process and their answers: deadlines, and the outcome of each failure."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, NoReturn

from gridtrack.common.errors import one_line
from gridtrack.common.files import last_line
from gridtrack.evaluation.hosting.outcome import OUTCOMES, TrialEnded
from gridtrack.evaluation.hosting.supervised import SupervisedProgram, TimeLimit
from gridtrack.trackers.messages import Arrays
from gridtrack.trackers.wire import Message, WireError

EXIT_WAIT_S = 1.0
MAX_REASON = 600


@dataclass(frozen=True, slots=True)
class Request:
    """A request: its `kind`, the expected kind of `answer`, its content, and the largest body of the answer, bytes."""

    kind: str
    answer: str
    fields: Mapping[str, Any] = field(default_factory=dict)
    arrays: Arrays = field(default_factory=dict)
    limit: int = 0
    what: str = ""
    """Name of the request in messages; empty: its kind."""


class Dialogue:
    """The wire to one process; its stderr goes to `log`."""

    def __init__(self, process: SupervisedProgram, log: Path, memory_mb: int) -> None:
        self.process = process
        self.log = log
        self.memory_mb = memory_mb
        self.what = "start"
        self.round_trip_ms = 0.0
        self._number = 0

    def __enter__(self) -> Dialogue:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.process.close(orderly=kind is None)

    def ask(self, request: Request, limit_s: float) -> Message:
        """Send `request` and receive its answer within `limit_s`; sets `round_trip_ms`.

        Raises TrialEnded, and WireError for an invalid answer.
        """
        self._number += 1
        self.what = request.what or request.kind
        message = Message(request.kind, self._number, request.fields, request.arrays)
        began, limit = time.monotonic(), TimeLimit(limit_s)
        try:
            if self.process.has_unread():
                raise WireError("unrequested bytes before the answer")
            self.process.send(message, limit)
            answer = self.process.receive(request.limit, limit)
        except TimeoutError:
            raise TrialEnded("timeout", f"{self.what}: no answer within {limit_s:g} s") from None
        except (EOFError, BrokenPipeError):
            self._closed()
        self.round_trip_ms = (time.monotonic() - began) * 1000.0
        if answer.number != self._number:
            raise WireError(f"answers request {answer.number}; expected {self._number}")
        if answer.kind == "error":
            self._failed(answer)
        if answer.kind != request.answer:
            raise WireError(f"answered '{answer.kind:.40}'; expected '{request.answer}'")
        return answer

    def _failed(self, answer: Message) -> NoReturn:
        """Raise the failure that the tracker reports."""
        outcome = answer.value("outcome", str)
        reason = one_line(answer.value("reason", str), MAX_REASON)
        where = "" if self.what in {"start", "describe"} else f"{self.what}: "
        for known in OUTCOMES:
            if outcome == known != "ok":
                raise TrialEnded(known, where + reason)
        raise WireError(f"an error with outcome '{outcome:.40}'; expected one of {', '.join(OUTCOMES[1:])}")

    def _closed(self) -> NoReturn:
        """Raise the reason why the other end of the wire is closed."""
        alive = not self.process.ended(EXIT_WAIT_S)
        by_referee = self.process.killed
        process_exit = self.process.close(orderly=False)
        if process_exit.over_memory:
            raise TrialEnded("out-of-memory", f"{self.what}: more than {self.memory_mb} MB of resident memory")
        if process_exit.start_error:
            raise TrialEnded("unavailable", str(process_exit))
        if by_referee:
            raise TrialEnded("crashed", f"{self.what}: ended by the referee")
        if alive:
            raise TrialEnded("crashed", f"{self.what}: closed its end of the wire")
        last = last_line(self.log, MAX_REASON)
        raise TrialEnded("crashed", f"{self.what}: {process_exit}{f' ({last})' if last else ''}")

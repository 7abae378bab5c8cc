"""Requests to a tracker process and their answers, each by its deadline, and the meaning of every way to fail."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, NoReturn

from gridtrack.common.errors import one_line
from gridtrack.evaluation.processes.outcome import OUTCOMES, TrialEnded
from gridtrack.evaluation.processes.supervised import SupervisedProgram
from gridtrack.trackers.messages import Arrays
from gridtrack.trackers.wire import Message, WireError, encode, receive

EXIT_WAIT_S = 1.0
LOG_END_BYTES = 4096
MAX_REASON = 600


@dataclass(frozen=True, slots=True)
class Request:
    """One request: its `kind`, the kind of `answer` expected, what it holds, and `limit`, the answer's largest body."""

    kind: str
    answer: str
    fields: Mapping[str, Any] = field(default_factory=dict)
    arrays: Arrays = field(default_factory=dict)
    limit: int = 0
    what: str = ""
    """What is being asked, for messages, where the kind does not say it all."""


class Dialogue:
    """The wire to one process, whose stderr goes to `log`."""

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
        """Send `request` and receive its answer within `limit_s`; `round_trip_ms` is then what that took.

        Raises TrialEnded, and WireError for an answer that is none.
        """
        self._number += 1
        self.what = request.what or request.kind
        message = Message(request.kind, self._number, request.fields, request.arrays)
        began = time.monotonic()
        deadline = began + limit_s
        try:
            if self.process.has_unread():
                raise WireError("before it, bytes came that nobody had asked for")
            self.process.write(encode(message), deadline)
            answer = receive(lambda buffers: self.process.read(buffers, deadline), request.limit)
        except TimeoutError:
            raise TrialEnded("timeout", f"{self.what}: no answer within {limit_s:g} s") from None
        except (EOFError, BrokenPipeError):
            self._silent()
        self.round_trip_ms = (time.monotonic() - began) * 1000.0
        if answer.number != self._number:
            raise WireError(f"an answer to request {answer.number} where {self._number} was asked")
        if answer.kind == "error":
            self._failed(answer)
        if answer.kind != request.answer:
            raise WireError(f"answered '{answer.kind:.40}'; expected '{request.answer}'")
        return answer

    def _failed(self, answer: Message) -> NoReturn:
        """The tracker says itself what went wrong."""
        outcome = answer.value("outcome", str)
        reason = one_line(answer.value("reason", str), MAX_REASON)
        where = "" if self.what in {"start", "describe"} else f"{self.what}: "
        for known in OUTCOMES:
            if outcome == known != "ok":
                raise TrialEnded(known, where + reason)
        raise WireError(f"an error with outcome '{outcome:.40}'; expected one of {', '.join(OUTCOMES[1:])}")

    def _silent(self) -> NoReturn:
        """The wire is closed at the other end: find out why."""
        lives = not self.process.ended(EXIT_WAIT_S)
        by_referee = self.process.killed
        ending = self.process.close(orderly=False)
        if ending.over_memory:
            raise TrialEnded("out-of-memory", f"{self.what}: more than {self.memory_mb} MB of resident memory")
        if ending.start_error:
            raise TrialEnded("unavailable", str(ending))
        if by_referee:
            raise TrialEnded("crashed", f"{self.what}: ended by the referee")
        if lives:
            raise TrialEnded("crashed", f"{self.what}: closed its end of the wire")
        raise TrialEnded("crashed", f"{self.what}: {ending}{self._last_line()}")

    def _last_line(self) -> str:
        """The last line of the log, as the end of a reason."""
        with self.log.open("rb") as log:
            size = log.seek(0, 2)
            log.seek(max(0, size - LOG_END_BYTES))
            lines = [one_line(line, MAX_REASON) for line in log.read().decode(errors="replace").splitlines()]
        last = next((line for line in reversed(lines) if line), "")
        return f" ({last})" if last else ""

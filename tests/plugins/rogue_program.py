"""A program on the wire that starts correctly, and answers an `update` in the way named by its argument.

Tests of its answers import it, and start it only for claims about processes.
"""

from __future__ import annotations

import os
import sys
import time

import numpy as np

from gridtrack.trackers.wire import MESSAGE_PREFIX, Message, encode, fill_from, receive

TIMES = {"elapsed_ns": 1, "cpu_ns": 1}
STARTED = {
    "api": 1,
    "about": "",
    "classes": [],
    "moving_sensor": False,
    "learns": False,
    "options": {},
    "options_schema": {},
}


def header(text: str) -> bytes:
    return MESSAGE_PREFIX.pack(b"GTW", 1, len(text), 0) + text.encode()


def answer(number: int, kind: str = "done", **fields: object) -> bytes:
    return b"".join(encode(Message(kind, number, TIMES | fields)))


def answers_to_update(number: int) -> dict[str, bytes]:
    """The answers by name."""
    done = answer(number)
    return {
        "done": done,
        "twice": done + done,
        "garbage": b"Hello, I am a tracker\n" * 10,
        "huge-body": MESSAGE_PREFIX.pack(b"GTW", 1, 2, 1 << 62) + b"{}",
        "huge-header": MESSAGE_PREFIX.pack(b"GTW", 1, (1 << 32) - 1, 0),
        "other-version": MESSAGE_PREFIX.pack(b"GTW", 9, 2, 0) + b"{}",
        "half-a-message": done[: len(done) // 2],
        "not-json": header("{what"),
        "nested-json": header("[" * 100_000),
        "a-list": header("[]"),
        "another-number": answer(number + 7),
        "another-kind": answer(number, "forecast"),
        "no-times": b"".join(encode(Message("done", number))),
        "endless-time": answer(number, elapsed_ns=10**400),
        "negative-time": answer(number, cpu_ns=-1),
        "made-up-outcome": answer(number, "error", outcome="ok", reason="all is well"),
        "terminal-codes": answer(number, "error", outcome="crashed", reason="\x1b[31mred\nalert\x07"),
    }


def answer_to(request: Message, how: str, described: dict[str, object]) -> bytes:
    """The answer to any request; `described` are the fields by which it describes itself."""
    if request.kind == "start":
        return b"".join(encode(Message("started", request.number, STARTED | described)))
    if request.kind == "predict":
        return b"".join(encode(Message("forecast", request.number, TIMES, large_forecast(request.fields["steps"]))))
    return answers_to_update(request.number)[how if request.kind == "update" else "done"]


def large_forecast(steps: int) -> dict[str, np.ndarray]:
    """Forecasts of 255 classes in a window of 100 x 100 cells, 10 MB for each step."""
    semantics = np.zeros((steps + 1, 255, 100, 100), np.float32)
    semantics[:, 0] = 1.0
    return {"occupancy": np.zeros((steps + 1, 100, 100), np.float32), "semantics": semantics}


def main() -> None:
    how, fill = sys.argv[1], fill_from(0)
    while True:
        request = receive(fill, 1 << 28)
        if request.kind == "update" and how == "drips":
            for byte in answer(request.number):
                os.write(1, bytes([byte]))
                time.sleep(0.2)
        elif request.kind == "update" and how == "closes-stdin":
            os.close(0)
            os.write(1, answer(request.number))
            time.sleep(3600)
        else:
            os.write(1, answer_to(request, how, {}))
            if request.kind == "update" and how == "half-a-message":
                sys.exit(0)
            if how == "stops-reading":
                time.sleep(3600)


if __name__ == "__main__":
    main()

"""A program on the wire that starts correctly, and answers an `update` in the way named by its argument."""

from __future__ import annotations

import json
import os
import sys
import time

import numpy as np

from gridtrack.trackers.wire import MESSAGE_PREFIX, Message, encode, fill_from, receive, write_to

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


def misbehave(how: str, number: int) -> None:
    done = answer(number)
    answers = {
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
    if how == "drips":
        for byte in done:
            os.write(1, bytes([byte]))
            time.sleep(0.2)
    elif how == "stops-reading":
        time.sleep(3600)
    elif how == "closes-stdin":
        os.close(0)
        os.write(1, done)
        time.sleep(3600)
    else:
        os.write(1, answers[how])
        if how == "half-a-message":
            sys.exit(0)


def large_forecast(steps: int) -> dict[str, np.ndarray]:
    """Forecasts of 255 classes in a window of 100 x 100 cells, 10 MB for each step."""
    semantics = np.zeros((steps + 1, 255, 100, 100), np.float32)
    semantics[:, 0] = 1.0
    return {"occupancy": np.zeros((steps + 1, 100, 100), np.float32), "semantics": semantics}


def main() -> None:
    fill = fill_from(0)
    while True:
        try:
            request = receive(fill, 1 << 28)
        except EOFError:
            return
        if request.kind == "start":
            described = json.loads(sys.argv[2]) if len(sys.argv) > 2 else {}
            named = [f"class {i}" for i in range(10_000)] if sys.argv[1] == "many-classes" else []
            write_to(1, encode(Message("started", request.number, STARTED | {"classes": named} | described)))
            if sys.argv[1] == "stops-reading":
                time.sleep(3600)
        elif request.kind == "predict":
            write_to(1, encode(Message("forecast", request.number, TIMES, large_forecast(request.fields["steps"]))))
        elif request.kind == "update" and sys.argv[1] == "large-forecasts":
            write_to(1, encode(Message("done", request.number, TIMES)))
        elif request.kind == "update":
            misbehave(sys.argv[1], request.number)
        else:
            write_to(1, encode(Message("done", request.number, TIMES)))


main()

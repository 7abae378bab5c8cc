"""The readers of the messages of the wire, in both directions."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from fuzz.containers import damaged_message
from fuzz.reader import CLASSES, GRID, Reader, on_file
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame
from gridtrack.trackers import messages
from gridtrack.trackers.contract import Forecast, StreamSpec, TrackedObject
from gridtrack.trackers.wire import Message, encode, receive

STEPS = 2


def forecast_message(folder: Path) -> None:
    shape = (STEPS + 1, *GRID.shape)
    forecast = Forecast(
        np.full(shape, 0.2, np.float32),
        np.full((STEPS + 1, 2, *GRID.shape), 0.5, np.float32),
        np.zeros((STEPS + 1, 2, *GRID.shape), np.float32),
        (TrackedObject(1, np.zeros(5, np.float32), np.zeros(2, np.float32), np.eye(4, dtype=np.float32), "person"),),
        np.zeros((2, *shape), np.bool_),
    )
    fields, arrays = messages.forecast_fields(forecast)
    write_message(folder, Message("forecast", 3, fields | {"elapsed_ns": 5, "cpu_ns": 5}, arrays))


def write_message(folder: Path, message: Message) -> None:
    (folder / "message.bin").write_bytes(b"".join(encode(message)))


def received(folder: Path, max_body: int) -> Message:
    """The message in the folder; a file that ends in it counts as a process that ended, which the host survives."""
    file = (folder / "message.bin").open("rb")

    def fill(buffers: list[memoryview]) -> None:
        for buffer in buffers:
            if file.readinto(buffer) < buffer.nbytes:
                raise EOFError

    with file:
        return receive(fill, max_body)


def read_forecast(folder: Path) -> str:
    try:
        answer = received(folder, messages.forecast_limit(GRID, STEPS, 2))
    except EOFError:
        return "cut off"
    forecast = messages.forecast_from(answer, GRID, STEPS, 2)
    return f"{answer.value('elapsed_ns', int)} ns, {len(forecast.objects)} objects"


def started_message(folder: Path) -> None:
    lists = {"classes": list(CLASSES), "reference_for": ["classes"]}
    reported = {
        "api": 1,
        "about": "a",
        "moving_sensor": True,
        "learns": False,
        "role": "tracker",
        "code_sha256": "a" * 64,
        "device": "NVIDIA H100",
    }
    write_message(folder, Message("started", 1, lists | reported | {"options": {"a": 1.5}, "options_schema": {}}))


def read_started(folder: Path) -> str:
    from gridtrack.evaluation.hosting.tracker_process import description_from

    try:
        described = description_from(received(folder, 0))
    except EOFError:
        return "cut off"
    assert all(name.isprintable() for name in described.classes)
    json.dumps(dict(described.options), allow_nan=False).encode()
    return f"{len(described.classes)} classes"


def start_message(folder: Path) -> None:
    stream = StreamSpec(GRID, 0.125, "here", CLASSES)
    write_message(folder, Message("start", 1, {"stream": messages.stream_fields(stream), "options": {}}))


def update_message(folder: Path) -> None:
    seen, points = np.ones(GRID.shape, np.bool_), np.zeros((3, 2), np.float32)
    frame = GridFrame(5, seen, seen, SE2(), np.zeros((1, 2), np.float32), points, np.zeros(3, np.uint8))
    write_message(folder, Message("update", 2, {}, messages.frame_arrays(frame)))


def read_request(folder: Path) -> str:
    try:
        request = received(folder, messages.update_limit(GRID))
    except EOFError:
        return "cut off"
    return str(messages.stream_from(request) if "stream" in request.fields else messages.frame_from(request))[:80]


READERS: dict[str, Reader] = {
    "wire, forecast": Reader(forecast_message, on_file("message.bin", damaged_message), read_forecast),
    "wire, started": Reader(started_message, on_file("message.bin", damaged_message), read_started),
    "wire, start": Reader(start_message, on_file("message.bin", damaged_message), read_request),
    "wire, update": Reader(update_message, on_file("message.bin", damaged_message), read_request),
}

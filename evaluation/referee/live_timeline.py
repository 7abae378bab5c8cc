"""Deadlines in real time: the frames that a busy tracker misses, and the newest forecast at each deadline.

A free tracker receives a frame, updates and forecasts; until the forecast is delivered it is busy, and never receives
the frames of that time. A forecast is in time for a frame if it is delivered before the next one is presented.
"""

from __future__ import annotations

import threading
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any, NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import GridFrame
from gridtrack.evaluation.referee.deadline import Timeline
from gridtrack.trackers.contract import Forecast
from gridtrack.trackers.messages import forecast_fields, objects_from
from gridtrack.trackers.wire import Message


class Presented(NamedTuple):
    """A frame of the stream that a tracker receives, its number, and whether its forecast has a deadline."""

    number: int
    frame: GridFrame
    has_deadline: bool


class Delivered(NamedTuple):
    """A forecast, and the number of the frame that it was made at."""

    made_at: int
    forecast: Forecast


class LiveTimeline:
    """The frames that one tracker receives, and its forecasts, in real time.

    One thread presents the frames and closes the deadlines; the tracker's thread takes the frames, delivers the
    forecasts, and leaves when it cannot go on.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._accepted: list[bool] = []
        self._newest: list[int] = []
        self._inbox: Presented | None = None
        self._delivered: Delivered | None = None
        self._in_time: Delivered | None = None
        self._busy = self._over = False
        self.left = False
        """Whether the tracker takes no further frame."""
        self.missed = 0
        """Frames with a deadline that the tracker did not receive."""
        self._first_timed: int | None = None

    def present(self, frame: GridFrame, *, has_deadline: bool) -> None:
        """Present the next frame: the tracker receives it if it is free."""
        with self._changed:
            index, free = len(self._accepted), not (self._busy or self.left)
            self._accepted.append(free)
            if has_deadline:
                self._first_timed = index if self._first_timed is None else self._first_timed
                self.missed += not free
            if free:
                self._inbox, self._busy = Presented(index, frame, has_deadline), True
                self._changed.notify_all()

    def close(self, index: int) -> Delivered | None:
        """The deadline of the frame `index`, presented last, is over: the newest forecast in time, None before any.

        A second call for a frame, necessary after an interrupt, gives the same.
        """
        with self._changed:
            if index == len(self._newest):
                self._newest.append(-1 if self._delivered is None else self._delivered.made_at)
                self._in_time = self._delivered
            return self._in_time

    def wait_until_free(self, timeout_s: float) -> bool:
        """Wait until the tracker is not busy, or the time is over; whether it is free."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._busy or self.left, timeout_s)

    def end(self) -> None:
        """No further frame is presented."""
        with self._changed:
            self._over = True
            self._changed.notify_all()

    def take(self) -> Presented | None:
        """Wait for the next frame that the tracker receives; None at the end."""
        with self._changed:
            self._changed.wait_for(lambda: self._inbox is not None or self._over)
            taken, self._inbox = self._inbox, None
            return taken

    def deliver(self, index: int, forecast: Forecast | None) -> None:
        """The tracker has finished with the frame `index`, and is free; None: it made no forecast."""
        with self._changed:
            if forecast is not None:
                self._delivered = Delivered(index, forecast)
            self._busy = False
            self._changed.notify_all()

    def leave(self) -> None:
        """The tracker takes no further frame."""
        with self._changed:
            self.left = True
            self._changed.notify_all()

    @property
    def frames(self) -> int:
        """Number of frames with a deadline in the past."""
        return len(self._newest)

    @property
    def has_deadlines(self) -> bool:
        """Whether any frame so far had a deadline."""
        return self._first_timed is not None

    @property
    def newest(self) -> int:
        """The frame of the newest forecast in time for the last of these frames; -1 before the first."""
        return self._newest[-1] if self._newest else -1

    @property
    def timeline(self) -> Timeline:
        """The frames up to the last deadline that is over."""
        with self._changed:
            frames = len(self._newest)
            return Timeline(np.array(self._accepted[:frames], np.bool_), np.array(self._newest, np.int64))

    @property
    def timed(self) -> Timeline:
        """The part of the timeline with deadlines; `newest` counts from its first frame."""
        whole = self.timeline
        first = len(whole.newest) if self._first_timed is None else self._first_timed
        return Timeline(whole.accepted[first:], whole.newest[first:] - first)


class _Place(NamedTuple):
    """Place, type and shape of an array in the file."""

    at: int
    size: int
    dtype: np.dtype[Any]
    shape: tuple[int, ...]


class ForecastStore:
    """Forecasts that wait for their scores, compressed in a file without a name. Thread-safe."""

    def __init__(self, folder: Path) -> None:
        """Raises OSError."""
        self._file = TemporaryFile(dir=folder)  # noqa: SIM115 closed by `close`
        self._places: dict[int, dict[str, _Place]] = {}
        self._fields: dict[int, dict[str, Any]] = {}
        self._lock = threading.Lock()

    def add(self, delivered: Delivered) -> None:
        """Keep a forecast, once. Raises OSError."""
        with self._lock:
            if delivered.made_at in self._places:
                return
            self._fields[delivered.made_at], arrays = forecast_fields(delivered.forecast)
            self._places[delivered.made_at] = {name: self._append(array) for name, array in arrays.items()}

    def read(self, index: int) -> Forecast:
        """The forecast made at the frame `index`. Raises KeyError, OSError."""
        with self._lock:
            arrays = {name: self._array(place) for name, place in self._places[index].items()}
            objects = objects_from(Message("forecast", index, self._fields[index], arrays))
            semantics, velocity, futures = (arrays.get(name) for name in ("semantics", "velocity", "futures"))
            return Forecast(arrays["occupancy"], semantics, velocity, objects, futures)

    def close(self) -> None:
        """Remove the file."""
        self._file.close()

    def _append(self, array: NDArray[Any]) -> _Place:
        content = lz4.frame.compress(np.ascontiguousarray(array).tobytes())
        at = self._file.seek(0, 2)
        self._file.write(content)
        return _Place(at, len(content), array.dtype, array.shape)

    def _array(self, place: _Place) -> NDArray[Any]:
        self._file.seek(place.at)
        content = lz4.frame.decompress(self._file.read(place.size))
        return np.frombuffer(content, place.dtype).reshape(place.shape)


class StoredForecasts:
    """A TrackerLike that gives the stored forecasts of the frames that a tracker received; `failed` at one of them."""

    def __init__(self, store: ForecastStore, timeline: Timeline, failed: tuple[int, Exception] | None) -> None:
        self._store, self._timeline, self._failed = store, timeline, failed

    def reset(self, seed: int) -> None:
        """Start at the first frame; nothing is drawn at random, so `seed` is not used."""
        self._received = iter(np.flatnonzero(self._timeline.accepted).tolist())

    def update(self, frame: GridFrame) -> None:
        """The next frame that the tracker received. Raises the error that it failed with."""
        self._index = next(self._received)
        if self._failed is not None and self._index == self._failed[0]:
            raise self._failed[1]

    def predict(self, steps: int) -> Forecast:
        """The forecast that was made at this frame."""
        return self._store.read(self._index)

"""The observations of a recording that is still being written, as they arrive, and the pace of their presentation."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from gridtrack.common.errors import RecordingError
from gridtrack.evaluation.engines.engine import WAKE_S
from gridtrack.recordings.growth import Growth
from gridtrack.recordings.observation import Observation
from gridtrack.recordings.stream import GridStream

POLL_S = 0.05
"""Period at which the size of the file is looked at."""
BEHIND_S = 1.0
"""A frame is behind where a frame this much later has been read."""
MAX_AHEAD = 600
"""Observations that are read before it is their time."""


class Watch(Protocol):
    """Waits for the file to grow."""

    idle: bool

    def more(self) -> bool:
        """Whether the file has grown; waits for it."""

    def stop(self) -> None:
        """Wait no longer."""


class Turns(Protocol):
    """The pace of the frames."""

    def restart(self) -> None:
        """A frame is presented now, without a deadline."""

    def wait(self, all_free: Callable[[float], bool], *, behind: bool) -> None:
        """Wait until it is time for the next frame, which has arrived; where it is `behind`, until `all_free`."""


class FileWatch:
    """Waits for a file to grow: `more` of its Growth."""

    def __init__(self, path: Path, idle_s: float) -> None:
        """After `idle_s` seconds without growth nothing more is waited for."""
        self._path, self._idle_s = path, idle_s
        self._size = -1
        self._grown_s = time.monotonic()
        self._stopped = threading.Event()
        self.idle = False
        """Whether the time without growth was over."""

    def more(self) -> bool:
        """Wait until the file has grown since the last call; False where it did not, or the watch was stopped."""
        while not self._stopped.is_set():
            size = self._path.stat().st_size
            if size != self._size:
                self._size, self._grown_s = size, time.monotonic()
                return True
            if time.monotonic() - self._grown_s > self._idle_s:
                self.idle = True
                return False
            self._stopped.wait(POLL_S)
        return False

    def stop(self) -> None:
        """Wait no longer. From any thread."""
        self._stopped.set()


@dataclass(frozen=True, slots=True)
class Arrival:
    """An observation, and how many bytes of the file had been read when it was made."""

    observation: Observation
    position: int


class Arrivals:
    """Observations of a growing recording, read in a thread of its own. `problem`: why the rest cannot be read."""

    def __init__(self, stream: GridStream, growth: Growth) -> None:
        self._stream, self._growth = stream, growth
        self._read: queue.Queue[Arrival | None] = queue.Queue(MAX_AHEAD)
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="reader", daemon=True)
        self.problem = ""
        self.ended = False
        """Whether the recording was read to its end."""
        self._newest_ns = 0

    def __iter__(self) -> Iterator[Arrival]:
        """The observations, once, in their order; waits for them."""
        self._thread.start()
        while True:
            try:
                arrival = self._read.get(timeout=WAKE_S)
            except queue.Empty:
                continue
            if arrival is None:
                return
            yield arrival

    def behind_s(self, stamp_ns: int) -> float:
        """How much later the newest frame read is than `stamp_ns`, seconds."""
        return (self._newest_ns - stamp_ns) / 1e9

    def stop(self) -> None:
        """End the reading; the file is no longer open."""
        self._stopped.set()
        if self._thread.is_alive():
            self._thread.join()

    def _run(self) -> None:
        try:
            for observation in self._stream.arriving():
                self._newest_ns = observation.frame.stamp_ns
                if not self._put(Arrival(observation, self._growth.position)):
                    return
            self.ended = True
        except (RecordingError, OSError) as error:
            self.problem = str(error)
        self._put(None)

    def _put(self, arrival: Arrival | None) -> bool:
        while not self._stopped.is_set():
            try:
                self._read.put(arrival, timeout=WAKE_S)
            except queue.Full:
                continue
            return True
        return False


class Pace:
    """The time at which each frame is presented: a period after the one before, or when it has arrived."""

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._presented_s = time.monotonic()

    def restart(self) -> None:
        """A frame is presented now, without a deadline."""
        self._presented_s = time.monotonic()

    def wait(self, all_free: Callable[[float], bool], *, behind: bool) -> None:
        """Wait until it is time for the next frame, which has arrived.

        Where it is `behind`, it is also time when `all_free(timeout)`: no tracker misses the frame by that.
        """
        while (left_s := self._presented_s + self._period_s - time.monotonic()) > 0:
            if not behind:
                time.sleep(min(left_s, WAKE_S))
            elif all_free(min(left_s, WAKE_S)):
                break
        self._presented_s = time.monotonic()

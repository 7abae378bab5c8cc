"""A recording that is still being written: opened when it holds enough to begin, then read as it grows."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from gridtrack.common.errors import ConfigurationError, RecordingError
from gridtrack.evaluation.engines.engine import WAKE_S
from gridtrack.evaluation.referee.referee import WARM_UP
from gridtrack.evaluation.runs.plan import Trial
from gridtrack.evaluation.runs.settings import CompareSettings, check_together
from gridtrack.recordings import Recording, open_recording
from gridtrack.recordings.file_reading import DamageError, FileEnds, Growth
from gridtrack.recordings.mcap_file import MCAP_MAGIC, McapFile
from gridtrack.recordings.observation import Observation
from gridtrack.recordings.recording import NoScansError
from gridtrack.recordings.stream import GridStream
from gridtrack.recordings.stretches import parse_stretch

SPARE_FRAMES = 3
"""Frames beside the warm-up and one horizon: a frame is made when the scans of two later periods are read."""
FILE_POLL_S = 0.05
"""Period at which the size of the file is checked."""
BEHIND_S = 1.0
"""A frame is behind if a frame this much later has been read."""
MAX_AHEAD = 600
"""Limit of the observations that are read ahead of their time."""


def open_growing(path: Path, settings: CompareSettings, more: Callable[[], bool]) -> Recording:
    """The recording at `path` when it holds the warm-up and one horizon, or its writer has closed it.

    `more()` waits for more bytes, and returns whether there are any. The sensors, their frames and the rate of the
    recording are fixed then. Raises RecordingError if nothing more comes, or its format cannot grow.
    """
    holds = "nothing that can be read"
    while True:
        if _has_begun(path):
            growth = Growth()
            recording = open_recording(path, growth=growth, format=settings.format)
            held_s, needed_s = _held_s(recording), _needed_s(recording, settings)
            if held_s >= needed_s or not growth.cut:
                growth.sensors = frozenset(recording.survey.sensors)
                return recording
            holds = f"{held_s:.1f} s of scans"
        if not more():
            raise RecordingError(
                f"{path}: nothing more is written to it, and it holds {holds}: to follow it, the recorder must be"
                f" running; a comparison begins with {WARM_UP} frames and one horizon ({settings.horizon_s:g} s)"
            )


def path_to_follow(settings: CompareSettings) -> Path:
    """The recording to follow. Raises ConfigurationError for settings that are for finished recordings."""
    check_together(settings)
    path, stretch = parse_stretch(settings.recordings[0])
    if len(settings.recordings) > 1 or stretch is not None:
        raise ConfigurationError("--follow reads one recording from its beginning to its end: name one file, no range")
    given = {name: getattr(settings, name) for name in ("resume", "latency", "deadline", "degrade")}
    for name, value in given.items():
        if value:
            raise ConfigurationError(f"--{name} is for finished recordings: leave it out with --follow")
    if settings.validation and parse_stretch(settings.validation)[0].resolve() == path.resolve():
        raise ConfigurationError(
            f"--validation {settings.validation}: the recording that is followed; name a finished one"
        )
    return path


def refuse_raw(trials: Sequence[Trial]) -> None:
    """Raise ConfigurationError if a tracker requests returns of the laser."""
    for trial in trials:
        if trial.selection.points != "centres":
            raise ConfigurationError(
                f"{trial.label}: returns of the laser (points={trial.selection.points}) are for finished recordings:"
                " leave them out with --follow"
            )


def _has_begun(path: Path) -> bool:
    """Whether the file can be opened: an MCAP file after its first message. A missing file is reported when opened."""
    if not path.is_file():
        return True
    growth = Growth()
    try:
        with growth.open(path) as file:
            head = file.read(len(MCAP_MAGIC))
        if head != MCAP_MAGIC:
            return True
        return next(McapFile(path, growth).messages(), None) is not None or not growth.cut
    except FileEnds:
        return False
    except DamageError:
        return True


def _held_s(recording: Recording) -> float:
    try:
        return recording.survey.duration_s
    except NoScansError:
        assert recording.growth is not None
        if not recording.growth.cut:
            raise
        return 0.0


def _needed_s(recording: Recording, settings: CompareSettings) -> float:
    """Seconds of scans needed to begin; infinite while the rate is unknown."""
    try:
        rate_hz = settings.rate_hz or recording.info.rate_hz or recording.survey.rate_hz
    except NoScansError:
        rate_hz = None
    return (WARM_UP + SPARE_FRAMES) / rate_hz + settings.horizon_s if rate_hz else float("inf")


class FileWatch:
    """Waits for a file to grow: `more` of its Growth."""

    def __init__(self, path: Path, idle_s: float) -> None:
        """Stop waiting after `idle_s` seconds without growth."""
        self._path, self._idle_s = path, idle_s
        self._size = -1
        self._grown_s = time.monotonic()
        self._stopped = threading.Event()
        self.idle = False
        """Whether it stopped waiting because the file did not grow."""

    def more(self) -> bool:
        """Wait until the file has grown since the last call. Returns False if it has not, or the watch was stopped."""
        while not self._stopped.is_set():
            size = self._path.stat().st_size
            if size != self._size:
                self._size, self._grown_s = size, time.monotonic()
                return True
            if time.monotonic() - self._grown_s > self._idle_s:
                self.idle = True
                return False
            self._stopped.wait(FILE_POLL_S)
        return False

    def stop(self) -> None:
        """Stop waiting. From any thread."""
        self._stopped.set()


@dataclass(frozen=True, slots=True)
class Arrival:
    """An observation, and the number of bytes of the file that had been read for it."""

    observation: Observation
    position: int


class Arrivals:
    """Observations of a growing recording, read in a separate thread."""

    def __init__(self, stream: GridStream, growth: Growth) -> None:
        self._stream, self._growth = stream, growth
        self._read: queue.Queue[Arrival | None] = queue.Queue(MAX_AHEAD)
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="reader", daemon=True)
        self.problem = ""
        """The reason why the rest cannot be read; empty if it can."""
        self.ended = False
        """Whether the recording was read to its end."""
        self._newest_ns = 0

    def __iter__(self) -> Iterator[Arrival]:
        """Wait for the observations, and yield them once, in their order."""
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
        """Time from `stamp_ns` to the newest frame read, seconds."""
        return (self._newest_ns - stamp_ns) / 1e9

    def stop(self) -> None:
        """Stop reading, and close the file."""
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


class RealTimePace:
    """The pace at which frames are presented: each a period after the one before, or when it has arrived."""

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._presented_s = time.monotonic()

    def restart(self) -> None:
        """A frame is presented now, without a deadline."""
        self._presented_s = time.monotonic()

    def wait(self, all_free: Callable[[float], bool], *, behind: bool) -> None:
        """Wait until it is time for the next frame, which has arrived.

        If it is `behind`, it is also time when `all_free(timeout_s)`: then no tracker misses the previous frame.
        """
        while (left_s := self._presented_s + self._period_s - time.monotonic()) > 0:
            if not behind:
                time.sleep(min(left_s, WAKE_S))
            elif all_free(min(left_s, WAKE_S)):
                break
        self._presented_s = time.monotonic()

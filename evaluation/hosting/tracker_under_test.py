"""The tracker under test of the contract suite: one process, and its forecasts of synthetic streams."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from gridtrack.common.grid import GridFrame
from gridtrack.evaluation.hosting.contract_scene import scene
from gridtrack.evaluation.hosting.limits import Limits
from gridtrack.evaluation.hosting.tracker_process import TrackerDescription, TrackerProcess, describe
from gridtrack.trackers.contract import Forecast, StreamSpec
from gridtrack.trackers.selection import Launch

STREAM_FRAMES, TURN_FRAME, CHECKED_STEPS = 16, 10, 5
RESET_SEED = 7
Forecasts = list[tuple[int, Forecast]]
"""Forecasts, each with the number of frames observed before it."""


class TrackerUnderTest:
    """A process of the tracker, restarted after a failure."""

    def __init__(
        self, launch: Launch, stream: StreamSpec, options: Mapping[str, Any], limits: Limits, folder: str
    ) -> None:
        self.stream = stream
        self._launch, self._options, self._limits = launch, options, limits
        self._log = Path(folder, "stderr.log")
        self._running = ExitStack()
        self._process: TrackerProcess | None = None
        self._fresh: Forecasts | None = None

    def __enter__(self) -> TrackerUnderTest:
        return self

    def __exit__(self, *_: object) -> None:
        self._running.close()

    def process(self) -> TrackerProcess:
        """The running process, started where there is none."""
        if self._process is None:
            self._process = self._running.enter_context(self.process_on(self.stream))
        return self._process

    def described(self, more: Mapping[str, Any] | None = None) -> TrackerDescription:
        """The tracker's description without a stream, with `more` options. Raises ConfigurationError, PluginError."""
        return describe(self._launch, {**self._options, **(more or {})}, self._limits)

    def restart(self) -> None:
        """End the process; the next use starts a new one."""
        self._process = None
        self._running.close()

    def process_on(self, stream: StreamSpec) -> TrackerProcess:
        """A separate process on another stream, not started yet."""
        return TrackerProcess(self._launch, stream, self._options, self._limits, self._log)

    def scene(self, seed: int = 1, turn_seed: int | None = None) -> list[GridFrame]:
        """A scene on the stream's grid; with `turn_seed`, the velocities change at frame TURN_FRAME."""
        turn = None if turn_seed is None else (TURN_FRAME, turn_seed)
        return scene(self.stream.grid, self.stream.period_s, STREAM_FRAMES, seed, turn)

    def forecasts(self, frames: Sequence[GridFrame], at: Iterable[int] = range(4, STREAM_FRAMES + 1, 4)) -> Forecasts:
        """Reset, stream `frames`, and forecast after the 1-based frames `at`, as often as each occurs there."""
        tracker = self.process()
        tracker.reset(RESET_SEED)
        due = list(at)
        made = []
        for count, frame in enumerate(frames, start=1):
            tracker.update(frame)
            made += [(count, tracker.predict(CHECKED_STEPS)) for _ in range(due.count(count))]
        return made

    def fresh_forecasts(self) -> Forecasts:
        """The forecasts of the scene in a process that has seen nothing else; made once."""
        if self._fresh is None:
            self.restart()
            self._fresh = self.forecasts(self.scene())
        return self._fresh

"""A small recording, and trackers that fail half way, for runs through the real processes."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from gridtrack.common.geometry import SE2
from gridtrack.common.scan import Scan
from gridtrack.evaluation.runs.settings import CompareSettings
from gridtrack.evaluation.runs.trial_record import TrialRecord
from gridtrack.recordings import RecordingInfo, write_native

RATE_HZ, SECONDS, BEAMS = 10, 20, 120
STRETCHES = {"train": (0.0, 4.0), "validation": (4.0, 9.0), "test": (9.0, None)}

STAGED = '''
import os, time
import numpy as np
from gridtrack.common.config import Settings
from gridtrack.trackers.contract import Forecast, Tracker


class Options(Settings):
    crash_at: int = 0
    crash_in: int = 2
    sleep_s: float = 0.0
    starts: str = ""


class Staged(Tracker):
    """Forecasts the last frame; dies at the update `crash_at` of the stretch `crash_in`, and takes its time.

    Stretches are counted in one process; with a file `starts`, each earlier process counts as one.
    """

    Options = Options

    def __init__(self, stream, options):
        super().__init__(stream, options)
        self.stretch = 0
        if options.starts:
            with open(options.starts, "ab") as file:
                self.stretch = file.tell()
                file.write(b".")

    def reset(self, seed):
        self.stretch, self.updates = self.stretch + 1, 0

    def update(self, frame):
        self.updates, self.last = self.updates + 1, frame.occupied
        if self.stretch == self.options.crash_in and self.updates == self.options.crash_at:
            os.abort()
        time.sleep(self.options.sleep_s)

    def predict(self, steps):
        return Forecast(np.repeat(self.last[None].astype(np.float32), steps + 1, axis=0))
'''


def scan(index: int, speed: float = 0.0, wall_m: float = 3.0) -> Scan:
    """A wall ahead, and something 0.3 m wide that walks to and fro before it."""
    angles = np.linspace(-math.pi / 3, math.pi / 3, BEAMS)
    ranges = wall_m / np.cos(angles)
    towards = 0.8 * math.sin(index / 12)
    ranges[np.abs(angles - towards) < 0.08] = 1.6
    return Scan(
        stamp_ns=1_000_000_000_000 + index * 1_000_000_000 // RATE_HZ,
        ranges=ranges.astype(np.float32),
        angle_min=float(angles[0]),
        angle_increment=float(angles[1] - angles[0]),
        range_min=0.05,
        range_max=8.0,
        world_T_sensor=SE2(speed * index / RATE_HZ, 0.0, 0.0),
    )


Record = Callable[..., Path]


@pytest.fixture
def record(tmp_path: Path) -> Record:
    """`record(name, seconds, stretches, speed, wall_m)` writes a recording and gives its path; m/s of the sensor."""

    def record(
        name: str = "room",
        seconds: int = SECONDS,
        stretches: dict[str, object] | None = None,
        speed: float = 0.0,
        wall_m: float = 3.0,
    ) -> Path:
        path = tmp_path / f"{name}.mcap"
        info = RecordingInfo(
            site="room", grid="40x0.2@-1,-4", rate_hz=RATE_HZ, stretches=STRETCHES if stretches is None else stretches
        )
        with path.open("wb") as file:
            write_native(file, info, (scan(index, speed, wall_m) for index in range(seconds * RATE_HZ)))
        return path

    return record


@pytest.fixture
def settings(record: Record, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., CompareSettings]:
    """`settings(*trackers, **more)` for the small recording, with nothing learned but what a test puts there."""
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "home"))
    given = {"recordings": (str(record()),), "out": tmp_path / "run", "horizon_s": 1.0, "every_s": 0.5}
    return lambda *trackers, **more: CompareSettings(trackers=trackers, **(given | more))


@pytest.fixture
def staged(install: Callable[..., Path]) -> Path:
    """Registers the tracker `staged`; the folder of its code."""
    return install("staged", {"staged": "staged_tracker:Staged"}, {"staged_tracker.py": STAGED})


class RecordedProgress:
    """A RunObserver that records its calls."""

    def __init__(self) -> None:
        self.notes: list[str] = []
        self.frames: dict[str, int] = {}
        self.delivered: dict[str, int] = {}
        self.records: dict[str, TrialRecord] = {}

    def note(self, text: str) -> None:
        self.notes.append(text)

    def planned(self, frames: dict[str, int], then: Sequence[str] = ()) -> None:
        self.planned_frames = frames

    def started(self, trial: str, frames: int) -> None:
        self.frames[trial] = frames

    def advanced(self, trial: str) -> None:
        self.delivered[trial] = self.delivered.get(trial, 0) + 1

    def ended(self, trial: str, record: TrialRecord) -> None:
        self.records[trial] = record


@pytest.fixture
def progress() -> RecordedProgress:
    return RecordedProgress()

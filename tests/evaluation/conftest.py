"""Runs on a small recording: its settings, a tracker that fails half way, and recorded progress."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from gridtrack.evaluation.runs.plan import resolve
from gridtrack.evaluation.runs.recipe import Recipe
from gridtrack.evaluation.runs.runner import run
from gridtrack.evaluation.runs.settings import CompareSettings
from gridtrack.evaluation.runs.summary import RunSummary
from gridtrack.evaluation.runs.train import train_tracker
from gridtrack.evaluation.runs.trial_record import TrialRecord
from tests.conftest import PLUGINS

from scenes.room import STAGED, write_room

Record = Callable[..., Path]


@pytest.fixture
def record(tmp_path: Path) -> Record:
    """`record(name, seconds, stretches, speed, wall_m)` writes a recording of the room, and returns its path."""
    return lambda name="room", *where, **how: write_room(tmp_path / f"{name}.mcap", *where, **how)


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An empty folder for the user's own weights."""
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "home"))


@pytest.fixture
def settings(record: Record, tmp_path: Path, home: None) -> Callable[..., CompareSettings]:
    """`settings(*trackers, **more)` for the small recording, with learned files of the test alone."""
    given = {"recordings": (str(record()),), "out": tmp_path / "run", "horizon_s": 1.0, "every_s": 0.5}
    given["no_floors"] = True
    return lambda *trackers, **more: CompareSettings(trackers=trackers, **(given | more))


@pytest.fixture
def compare(settings: Callable[..., CompareSettings], progress: RecordedProgress) -> Callable[..., RunSummary]:
    """`compare(*trackers, **settings)` runs a comparison, one trial at a time, and returns the summary."""
    return lambda *trackers, **more: run(
        resolve(settings(*trackers, **({"jobs": 1} | more))), ("gridtrack", "compare"), progress
    )


@pytest.fixture
def staged(install: Callable[..., Path]) -> Path:
    """Registers the tracker `staged`; the folder of its code."""
    return install("staged", {"staged": "staged_tracker:Staged"}, {"staged_tracker.py": STAGED})


@pytest.fixture
def train(record: Record, tmp_path: Path) -> Callable[..., Path]:
    """`train(folder, tracker, *recordings, **more)` trains on recordings, or the room; the path of the card."""

    def train(folder: str, tracker: str = "static-map", *recordings: object, **more: Any) -> Path:
        on = tuple(map(str, recordings)) or (str(record()),)
        return train_tracker(Recipe(tracker=tracker, recordings=on, out=tmp_path / folder, **more), lambda text: None)

    return train


class RecordedProgress:
    """A RunObserver that records its calls."""

    def __init__(self) -> None:
        self.notes: list[str] = []
        self.frames: dict[str, int] = {}
        self.delivered: dict[str, int] = {}
        self.records: dict[str, TrialRecord] = {}
        self.on_frame: Callable[[str, int], None] = lambda trial, delivered: None
        """Called after each frame of a trial with the number of its frames so far."""

    def note(self, text: str) -> None:
        self.notes.append(text)

    def planned(self, frames: dict[str, int], then: Sequence[str] = ()) -> None:
        self.planned_frames = frames

    def started(self, trial: str, frames: int) -> None:
        self.frames[trial] = frames

    def advanced(self, trial: str) -> None:
        self.delivered[trial] = self.delivered.get(trial, 0) + 1
        self.on_frame(trial, self.delivered[trial])

    def ended(self, trial: str, record: TrialRecord) -> None:
        self.records[trial] = record


@pytest.fixture
def progress() -> RecordedProgress:
    return RecordedProgress()


@pytest.fixture
def movers(install: Callable[..., Path]) -> None:
    """Registers the trackers `mover`, which forecasts velocities, and `guesser`, which samples futures."""
    module = PLUGINS / "movers.py"
    install("movers", {"mover": "movers:Mover", "guesser": "movers:Guesser"}, {module.name: module.read_text()})


@pytest.fixture
def nosy(install: Callable[..., Path]) -> None:
    """Registers the trackers `nosy`, which looks around in `fit`, and `nosy-in-trial`."""
    module = PLUGINS / "nosy_trackers.py"
    points = {"nosy": "nosy_trackers:Nosy", "nosy-in-trial": "nosy_trackers:NosyInTrial"}
    install("nosy", points, {module.name: module.read_text()})

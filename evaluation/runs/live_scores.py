"""Scores so far of trackers that follow a recording: static cells are judged by the observations until then."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from queue import SimpleQueue
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import nearest_step, shift_between
from gridtrack.evaluation.referee.deadline import read_later
from gridtrack.evaluation.referee.kinds import CellKinds, KindsOfOutlines, KindsOfWindow, ObservedCounts, Regions
from gridtrack.evaluation.referee.motion import ObservedMotion
from gridtrack.evaluation.referee.referee import Moment
from gridtrack.evaluation.referee.splits import EvaluationSplit
from gridtrack.evaluation.referee.strata import LastSeen
from gridtrack.evaluation.runs.followed_trial import FollowedTrial
from gridtrack.evaluation.scores.cells import Tally, count_cells
from gridtrack.evaluation.scores.f1 import f1_of
from gridtrack.recordings.observation import Observation

SHOWN_STRATUM, SHOWN_S = "dynamic", 1.0
"""The score of the live table."""
MAX_FRAMES_WAITING = 600
"""Frames that wait for their scores in the live table; while there are more, forecasts are left out of it."""
MAX_AGE = 1000
"""Older forecasts, in frames, are left out of the live table."""


@dataclass(frozen=True, slots=True)
class LiveRow:
    """One tracker in the live table: `f1` so far over `forecasts`, frames `missed`, and the age of its forecast.

    `f1` is NaN before the first score; `age_frames` None before the first deadline; `ended`: it takes no more frames.
    """

    label: str
    f1: float
    forecasts: int
    missed: int
    age_frames: int | None
    ended: bool


class LiveStatus(NamedTuple):
    """State of the live table: seconds of recording presented, seconds that are read and not yet presented."""

    time_s: float
    behind_s: float
    score: str
    rows: list[LiveRow]


class LiveObserver(Protocol):
    """Receives the live table."""

    def note(self, text: str) -> None:
        """A message for the user, one line."""

    def update(self, status: Callable[[], LiveStatus]) -> None:
        """A frame was presented; `status()` is the table now."""


class _Due(NamedTuple):
    """A frame that is forecast from: the forecasts in time for it by label, and the age bands (M, M) of its cells."""

    frame: int
    newest: Mapping[str, int]
    ages: NDArray[np.uint8]


class ScoresSoFar:
    """Counts of the forecasts of several trackers, frame by frame."""

    def __init__(self, split: EvaluationSplit, runs: Mapping[str, FollowedTrial]) -> None:
        self._split, self._runs, self._grid = split, runs, split.test.grid
        self._counts = ObservedCounts(self._grid)
        self._motion = ObservedMotion(split.test)
        self._unknown = Regions(self._grid, KindsOfWindow(np.zeros(self._grid.shape, np.uint8)))
        """Of a moment: static cells are judged at the end of its horizon."""
        self._seen = LastSeen()
        self._recent: deque[tuple[Observation, Moment]] = deque(maxlen=split.steps + 1)
        self._windows: deque[SE2] = deque(maxlen=MAX_AGE)
        self._due: deque[_Due] = deque()
        self._index = -1
        self.tallies = {label: Tally.empty(split.steps, split.strata) for label in runs}
        self.scored = dict.fromkeys(runs, 0)

    def add(self, observation: Observation, newest: Mapping[str, int], *, scored: bool) -> None:
        """Add the next observation, with the forecasts in time for it: `scored` once its horizon is observed."""
        self._index += 1
        frame = observation.frame
        self._counts.add(observation)
        self._seen.add(frame, self._grid.cell_m)
        self._windows.append(frame.world_T_grid)
        motion = self._motion.of(observation)
        self._recent.append((observation, Moment(observation, motion, self._split.test, self._unknown)))
        if scored and next(iter(self._runs.values())).endless.due(self._index):
            self._due.append(_Due(self._index, newest, self._seen.bands(frame.stamp_ns)))
        if self._due and self._due[0].frame + self._split.steps == self._index:
            self._score(self._due.popleft())

    def _score(self, due: _Due) -> None:
        first, moment = self._recent[0]
        maps = Regions(self._grid, self._kinds(first), self._split.strata).of(first)
        targets = [other.target_in(moment.window, maps) for _, other in self._recent]
        for label, made_at in due.newest.items():
            age = self._index - made_at
            if made_at < 0 or age >= len(self._windows):
                continue
            shift = shift_between(self._windows[-1 - age], first.frame.world_T_grid, self._grid.cell_m)
            forecast = read_later(self._runs[label].store.read(made_at), due.frame - made_at, shift, self._split.steps)
            self.tallies[label].add(count_cells(forecast.occupancy, targets, maps, due.ages))
            self.scored[label] += 1

    def _kinds(self, observation: Observation) -> CellKinds:
        scene = observation.scene
        return KindsOfOutlines(scene, self._grid) if scene else self._counts.kinds()


class LiveScores:
    """Scores so far, made in a thread of its own, so that no frame waits for them."""

    def __init__(self, split: EvaluationSplit, runs: Sequence[FollowedTrial]) -> None:
        self._runs = {run.trial.label: run for run in runs}
        self._scores = ScoresSoFar(split, self._runs)
        self.step = min(split.steps, max(1, nearest_step(SHOWN_S, split.test.period_s)))
        """The step of the shown score."""
        self._waiting: SimpleQueue[tuple[Observation, Mapping[str, int]] | None] = SimpleQueue()
        self._over = False
        self._thread = threading.Thread(target=self._work, name="live scores", daemon=True)
        self.problem = ""
        """Why the scores in the table change no more; empty while they do."""

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread; waiting forecasts are left out."""
        self._over = True
        self._waiting.put(None)
        if self._thread.is_alive():
            self._thread.join()

    def add(self, observation: Observation) -> None:
        """Add the next observation, after its deadline for every tracker."""
        self._waiting.put((observation, {label: run.live.newest for label, run in self._runs.items()}))

    def rows(self) -> list[LiveRow]:
        """The table, in the order of the trackers."""
        return [self._row(label, run) for label, run in self._runs.items()]

    def _row(self, label: str, run: FollowedTrial) -> LiveRow:
        live = run.live
        age = live.frames - 1 - live.newest if live.has_deadlines and live.newest >= 0 else None
        return LiveRow(label, self._f1(label, run), self._scores.scored[label], live.missed, age, live.left)

    def _f1(self, label: str, run: FollowedTrial) -> float:
        if run.chosen is None or not self._scores.scored[label]:
            return math.nan
        tally = self._scores.tallies[label]
        return float(f1_of(tally.confusion(run.chosen.bins))[self.step, tally.strata.index(SHOWN_STRATUM)])

    def _work(self) -> None:
        while (added := self._waiting.get()) is not None and not self._over:
            observation, newest = added
            try:
                self._scores.add(observation, newest, scored=self._waiting.qsize() < MAX_FRAMES_WAITING)
            except Exception as error:  # noqa: BLE001 the table is a view: the scores of the run are made at its end
                self.problem = f"{type(error).__name__}: {error}"
                return

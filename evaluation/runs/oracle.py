"""The oracle: a forecaster that knows the truth. Its score is the ceiling of a recording.

It runs in the referee's process, because no tracker receives the truth. It knows the true scene at t+n, and of the
laser's errors there only their distribution: in a visible cell it forecasts P(occupied | visible, scene), the best
forecast for every proper score that is not made of t+n itself, and in a hidden cell the true outlines.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.common.scan import Scan
from gridtrack.common.scene import Scene
from gridtrack.evaluation.referee.referee import Delivery, KeptMoments, scored_forecasts
from gridtrack.evaluation.referee.splits import ORACLE, EvaluationSplit, SplitMoments
from gridtrack.evaluation.runs.scorekeeper import SCORE_FILES, Scorekeeper, facts_of
from gridtrack.evaluation.runs.shared_thresholds import SharedThresholds, oracle_key
from gridtrack.evaluation.runs.trial import OnFrame, validation_tally
from gridtrack.evaluation.runs.trial_record import OUTCOME_FILE, ThresholdsUsed, Times, TrialRecord, hashes_of
from gridtrack.evaluation.scores.definition import ScoreDefinition
from gridtrack.evaluation.scores.robot import Robot
from gridtrack.evaluation.scores.thresholds import Thresholds, best_thresholds, half
from gridtrack.recordings.observation import Observation
from gridtrack.recordings.stream import GridStream
from gridtrack.recordings.truth import OUTLINE, truth_grid
from gridtrack.simulation.expected_scan import ExpectedScan, RangeErrors, measure_range_errors, true_ranges
from gridtrack.trackers.contract import Forecast

ORACLE_REPLACES = (OUTCOME_FILE, *SCORE_FILES)
"""Files of an earlier run that the scores of the oracle replace."""
MAX_ERROR_FRAMES = 500
"""Limit of the scans of a sensor in which its range errors are measured: half a million beams."""


class Oracle:
    """A TrackerLike that reads ahead in the recording; it holds one horizon of observations and their forecasts."""

    def __init__(self, moments: KeptMoments) -> None:
        self._moments, self._grid_spec = moments, moments.stream.grid
        self.errors = range_errors(_observations(moments), len(moments.stream))

    def reset(self, seed: int) -> None:
        """Start at the first frame; nothing is drawn at random, so `seed` is not used."""
        self._unread: Iterator[Observation] = _observations(self._moments)
        self._ahead: deque[Observation] = deque()
        self._grids: dict[tuple[int, SE2], NDArray[np.float32]] = {}

    def update(self, frame: GridFrame) -> None:
        """Discard everything earlier than `frame`."""
        while not self._ahead or self._ahead[0].frame.stamp_ns < frame.stamp_ns:
            if self._ahead:
                self._ahead.popleft()
            else:
                self._ahead.append(next(self._unread))
        self._grids = {key: grid for key, grid in self._grids.items() if key[0] >= frame.stamp_ns}

    def predict(self, steps: int) -> Forecast:
        """The grids of steps 0..steps in the window of the newest frame."""
        window = self.ahead(0).reference_T_grid
        return Forecast(np.stack([self._grid(self.ahead(n), window) for n in range(steps + 1)]))

    def ahead(self, step: int) -> Observation:
        """The observation `step` frames after the newest frame."""
        while len(self._ahead) <= step:
            self._ahead.append(next(self._unread))
        return self._ahead[step]

    def _grid(self, observation: Observation, window: SE2) -> NDArray[np.float32]:
        """The forecast of one observation in a window; kept, because a sensor at rest has the same window again."""
        key = observation.frame.stamp_ns, window
        if key not in self._grids:
            grid = self._grid_spec
            self._grids[key] = expected_grid(observation.seen_in(window, grid), grid, self.errors)
        return self._grids[key]


def range_errors(observations: Iterable[Observation], frames: int) -> dict[str, RangeErrors]:
    """The range errors of each sensor, measured in observations with truth that are spread over these `frames`."""
    pairs = (pair for observation in observations for pair in _scenes(observation))
    return measure_range_errors(pairs, -(-frames // MAX_ERROR_FRAMES))


def _observations(moments: KeptMoments) -> Iterator[Observation]:
    return (moment.observation for moment in moments)


def expected_grid(observation: Observation, grid: GridSpec, errors: dict[str, RangeErrors]) -> NDArray[np.float32]:
    """P(occupied) (M, M): of visible cells given that they are, and of hidden cells 0 or 1 by the true outlines."""
    frame, scene = observation.frame, observation.scene
    if scene is None:
        return np.zeros(grid.shape, np.float32)
    expected = ExpectedScan.nothing(grid)
    for (scan, own_scene), grid_T_sensor in zip(_scenes(observation), observation.grid_T_sensor, strict=True):
        expected.add(scan, true_ranges(scan, own_scene), errors[scan.sensor], grid, grid_T_sensor)
    forecast = expected.occupied_where_visible()
    outlines = truth_grid(scene, grid, observation.reference_T_grid).cover == OUTLINE
    return np.where(frame.visible & ~np.isnan(forecast), forecast, outlines).astype(np.float32)


def _scenes(observation: Observation) -> Iterator[tuple[Scan, Scene]]:
    """The scans of a frame, each with its own true scene, else the frame's."""
    for scan in observation.scans:
        scene = scan.scene or observation.scene
        if scene is not None:
            yield scan, scene


def run_oracle(
    split: EvaluationSplit,
    moments: SplitMoments,
    folder: Path,
    on_frame: OnFrame,
    shared: SharedThresholds,
    scores: Sequence[ScoreDefinition],
    robot: Robot,
) -> TrialRecord:
    """Score the oracle on the test stretch of a split like a tracker, and write its record to `folder`.

    `scores` and `robot` are as for trackers. Its thresholds are chosen like a tracker's; `shared` holds the already
    chosen ones. `on_frame` is called before each frame. Raises errors of `on_frame`, RecordingError and OSError; no
    record is written then.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for stale in ORACLE_REPLACES:
        (folder / stale).unlink(missing_ok=True)
    began = time.perf_counter()
    thresholds = shared.of(oracle_key(split), lambda: _choose_thresholds(split, moments, on_frame))
    delivery = Delivery(moments.test, on_frame)
    with Scorekeeper(folder, split, facts_of(split, thresholds, robot), scores) as scorekeeper:
        for scored in scored_forecasts(Oracle(moments.test), delivery, split.schedule, seed=0):
            scorekeeper.add(scored, delivery.digest)
    record = TrialRecord(
        label=ORACLE,
        recording=split.name,
        outcome="ok",
        frames_scored=scorekeeper.scored,
        frames_expected=split.schedule.expected,
        frames_delivered=delivery.frames,
        delivered=delivery.digest,
        steps=split.steps,
        thresholds=ThresholdsUsed.of(thresholds),
        files=hashes_of(folder, SCORE_FILES),
        times=Times(wall_s=time.perf_counter() - began, frames=delivery.frames),
    )
    record.write(folder)
    return record


def oracle_validation(split: EvaluationSplit) -> GridStream | None:
    """The stretch on which the oracle's thresholds are chosen; None if there is none, or if it has no truth."""
    return split.validation if split.validation and split.validation.has_truth else None


def _choose_thresholds(split: EvaluationSplit, moments: SplitMoments, on_frame: OnFrame) -> Thresholds:
    """The best thresholds on the validation stretch; 0.5 without one."""
    stretch = oracle_validation(split)
    if stretch is None or moments.validation is None:
        return half(split.steps, split.strata)
    delivery = Delivery(moments.validation, on_frame)
    return best_thresholds(validation_tally(Oracle(moments.validation), delivery, split, 0), stretch.name)

"""The oracle: a forecaster that knows the truth. Its score is the ceiling of a recording.

It runs in the referee's process, because no tracker receives the truth. Its forecast for t+n is binary: the grid that
a laser without noise would measure of the true scene at t+n, and in cells hidden at t+n the true outlines.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.common.raycast import cast_scan
from gridtrack.evaluation.comparison.trial import OnFrame
from gridtrack.evaluation.results.summary import ORACLE
from gridtrack.evaluation.results.trial_record import OUTCOME_FILE, Times, TrialRecord, hashes_of
from gridtrack.evaluation.scoring.motion import ObservedMotion
from gridtrack.evaluation.scoring.referee import Delivery, scored_forecasts
from gridtrack.evaluation.scoring.scorekeeper import SCORE_FILES, Scorekeeper
from gridtrack.evaluation.scoring.splits import EvaluationSplit, SplitRegions
from gridtrack.evaluation.scoring.thresholds import half
from gridtrack.recordings.stream import GridStream, Observation
from gridtrack.recordings.truth import OUTLINE, truth_grid
from gridtrack.simulation.laser import sweep
from gridtrack.trackers.contract import Forecast


class Oracle:
    """A TrackerLike that reads ahead in the recording; it holds the ideal grids of one horizon."""

    def __init__(self, stream: GridStream) -> None:
        self._stream = stream

    def reset(self, seed: int) -> None:
        """Start at the first frame; `seed` is not used."""
        self._ahead: Iterator[Observation] = iter(self._stream.observations())
        self._grids: deque[tuple[int, NDArray[np.float32]]] = deque()

    def update(self, frame: GridFrame) -> None:
        """Discard the ideal grids of earlier frames."""
        while self._grids and self._grids[0][0] < frame.stamp_ns:
            self._grids.popleft()
        while not self._grids:
            self._read()
            if self._grids[0][0] < frame.stamp_ns:
                self._grids.popleft()

    def predict(self, steps: int) -> Forecast:
        """The ideal grids of steps 0..steps."""
        while len(self._grids) <= steps:
            self._read()
        return Forecast(np.stack([grid for _, grid in self._grids][: steps + 1]))

    def _read(self) -> None:
        observation = next(self._ahead)
        self._grids.append((observation.frame.stamp_ns, ideal_grid(observation, self._stream.grid)))


def ideal_grid(observation: Observation, grid: GridSpec) -> NDArray[np.float32]:
    """Binary occupancy (M, M) of the true scene: visible cells as measured without noise, hidden cells by outlines."""
    frame, scene = observation.frame, observation.scene
    if scene is None:
        return np.zeros(grid.shape, np.float32)
    visible, occupied = np.zeros((2, *grid.shape), np.bool_)
    for scan, grid_T_sensor in zip(observation.scans, observation.grid_T_sensor, strict=True):
        beams = scan.ranges.size
        true_ranges, _ = sweep(
            scan.scene or scene, scan.world_T_sensor, scan.angle_min, scan.angle_increment, beams, scan.range_max
        )
        cast_scan(replace(scan, ranges=true_ranges), grid, grid_T_sensor, visible, occupied)
    outlines = truth_grid(scene, grid, frame.world_T_grid).cover == OUTLINE
    return np.where(frame.visible, occupied, outlines).astype(np.float32)


def run_oracle(split: EvaluationSplit, regions: SplitRegions, folder: Path, on_frame: OnFrame) -> TrialRecord:
    """Score the oracle on the test stretch of a split like a tracker, and write its record to `folder`.

    `on_frame` is called before each frame. Raises what `on_frame` raises, RecordingError and OSError; no record is
    written then.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for stale in (OUTCOME_FILE, *SCORE_FILES):
        (folder / stale).unlink(missing_ok=True)
    began = time.perf_counter()
    thresholds = half(split.steps, split.strata)
    delivery = Delivery(split.test, on_frame, ObservedMotion(split.test, regions.test.dynamic))
    with Scorekeeper(folder, split, regions.test, thresholds, ()) as scorekeeper:
        for scored in scored_forecasts(Oracle(split.test), delivery, split.schedule, seed=0):
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
        thresholds=thresholds.used(),
        files=hashes_of(folder, SCORE_FILES),
        times=Times(wall_s=time.perf_counter() - began, frames=delivery.frames),
    )
    record.write(folder)
    return record

"""The oracle: the ceiling of a recording with truth, computed by the referee because no tracker sees the truth.

It forecasts what a laser free of noise would see of the true scene at t+n, as zeros and ones; where a cell turns out
hidden, the truth's own outlines. What it misses is what range noise takes from anybody.
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
from gridtrack.evaluation.scoring.record import RECORD, ThresholdsUsed, Times, TrialRecord
from gridtrack.evaluation.scoring.referee import Delivery, scored_forecasts
from gridtrack.evaluation.scoring.scorekeeper import SCORE_FILES, Scorekeeper
from gridtrack.evaluation.scoring.splits import ORACLE, EvaluationSplit, SplitRegions
from gridtrack.evaluation.scoring.thresholds import half
from gridtrack.recordings.stream import GridStream, Observation
from gridtrack.recordings.truth import OUTLINE, truth_grid
from gridtrack.simulation.laser import sweep
from gridtrack.trackers.contract import Forecast


class Oracle:
    """Watches as a tracker does, and has read ahead: one horizon of the recording is all that it holds."""

    def __init__(self, stream: GridStream) -> None:
        self._stream = stream

    def reset(self, seed: int) -> None:
        """A new stream begins; nothing is left to chance."""
        self._ahead: Iterator[Observation] = iter(self._stream.observations())
        self._known: deque[tuple[int, NDArray[np.float32]]] = deque()

    def update(self, frame: GridFrame) -> None:
        """The next frame has come: what was known of those before it is let go."""
        while self._known and self._known[0][0] < frame.stamp_ns:
            self._known.popleft()
        while not self._known:
            self._read()
            if self._known[0][0] < frame.stamp_ns:
                self._known.popleft()

    def predict(self, steps: int) -> Forecast:
        """What will truly be there."""
        while len(self._known) <= steps:
            self._read()
        return Forecast(np.stack([grid for _, grid in self._known][: steps + 1]))

    def _read(self) -> None:
        observation = next(self._ahead)
        self._known.append((observation.frame.stamp_ns, ideal_grid(observation, self._stream.grid)))


def ideal_grid(observation: Observation, grid: GridSpec) -> NDArray[np.float32]:
    """The true scene (M, M), zeros and ones: where a cell is visible as seen without noise, elsewhere its outlines."""
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
    """Score the oracle on a split as any tracker is, and leave its record; `on_frame` is called before each frame.

    Raises what `on_frame` raises, RecordingError and OSError; nothing is recorded then.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for left_by_an_earlier_attempt in (RECORD, *SCORE_FILES):
        (folder / left_by_an_earlier_attempt).unlink(missing_ok=True)
    began = time.perf_counter()
    thresholds, delivery = half(split.steps, split.strata), Delivery(split.test, on_frame)
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
        thresholds=ThresholdsUsed.of(thresholds),
        times=Times(wall_s=time.perf_counter() - began, frames=delivery.frames),
    )
    record.write(folder)
    return record

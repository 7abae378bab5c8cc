"""The robustness pass: a tracker is given degraded frames, and scored against the undegraded ones."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from gridtrack.common.grid import GridFrame
from gridtrack.evaluation.comparison.plan import Trial
from gridtrack.evaluation.comparison.replay import replayed_f1
from gridtrack.evaluation.processes.tracker_process import TrackerProcess
from gridtrack.evaluation.scoring.record import AtStrength, Robustness, ThresholdsUsed
from gridtrack.evaluation.scoring.referee import Delivery, TrackerLike
from gridtrack.evaluation.scoring.splits import SplitRegions
from gridtrack.evaluation.scoring.target import targets
from gridtrack.recordings.degradation import Degradation, degrader
from gridtrack.trackers.contract import Forecast, stream_of

STRENGTHS = (0.25, 0.5, 1.0)
"""Shares of what was asked for; 0, the trial's own score, stands before them."""
ROBUSTNESS_LOG = "robustness.log"


class RobustnessRun:
    """Every kind of a degradation by itself, at every strength, on one trial's test stretch."""

    def __init__(self, trial: Trial, degradation: Degradation, folder: Path) -> None:
        self._trial, self._degradation = trial, degradation
        stream = stream_of(trial.test, trial.weights.path if trial.weights else None)
        self._process = TrackerProcess(
            trial.launch, stream, trial.selection.options, trial.limits, folder / ROBUSTNESS_LOG
        )

    def run(self, regions: SplitRegions, thresholds: ThresholdsUsed, on_frame: Callable[[], None]) -> Robustness:
        """Run it; `on_frame` is called before each frame and may raise to end it. Raises TrialEnded."""
        with self._process:
            return Robustness(
                degradation=self._degradation,
                kinds={
                    kind: tuple(self._at(kind, strength, regions, thresholds, on_frame) for strength in STRENGTHS)
                    for kind in self._degradation.kinds
                },
            )

    def interrupt(self) -> None:
        """End it from another thread, also in the middle of a call."""
        self._process.kill()

    def _at(
        self,
        kind: str,
        strength: float,
        regions: SplitRegions,
        thresholds: ThresholdsUsed,
        on_frame: Callable[[], None],
    ) -> AtStrength:
        trial, degradation = self._trial, self._degradation.only(kind).scaled(strength)
        shown = Delivery(trial.test.degraded(degrader(degradation, trial.seed)), on_frame)
        tracker = _ShownOthers(self._process, shown)
        f1 = replayed_f1(tracker, targets(trial.test), trial, regions, thresholds)
        return AtStrength(strength=strength, value=getattr(degradation, kind), delivered=shown.digest, f1=f1)


class _ShownOthers:
    """A tracker that is shown the frames of `shown` where the referee delivers those that it scores against."""

    def __init__(self, tracker: TrackerLike, shown: Delivery) -> None:
        self._tracker, self._shown = tracker, iter(shown)

    def reset(self, seed: int) -> None:
        """A new stream begins."""
        self._tracker.reset(seed)

    def update(self, frame: GridFrame) -> None:
        """Give it the frame with the same stamp."""
        degraded = next(self._shown).frame
        assert degraded.stamp_ns == frame.stamp_ns
        self._tracker.update(degraded)

    def predict(self, steps: int) -> Forecast:
        """Ask it."""
        return self._tracker.predict(steps)

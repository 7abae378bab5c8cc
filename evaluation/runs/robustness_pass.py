"""The robustness pass: a tracker receives degraded frames, and is scored against the undegraded ones."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from gridtrack.common.grid import GridFrame
from gridtrack.evaluation.hosting.tracker_process import TrackerProcess
from gridtrack.evaluation.referee.referee import Delivery, KeptMoments, TrackerLike, moments
from gridtrack.evaluation.runs.passes import AtStrength, Robustness
from gridtrack.evaluation.runs.plan import Trial
from gridtrack.evaluation.runs.replay import replayed
from gridtrack.evaluation.runs.trial_record import ThresholdsUsed
from gridtrack.recordings.degradation import Degradation, degrader
from gridtrack.trackers.contract import Forecast

STRENGTHS = (0.25, 0.5, 1.0)
"""Strengths as shares of the requested degradation; strength 0 is the trial's own score."""
ROBUSTNESS_LOG = "robustness.log"


class RobustnessRun:
    """Each kind of a degradation separately, at every strength, on one trial's test stretch.

    Every condition has a process of its own: a tracker that keeps frames over `reset` would know the stream. The log of
    the last process goes to `folder`.
    """

    def __init__(self, trial: Trial, degradation: Degradation, folder: Path) -> None:
        self._trial, self._degradation, self._log = trial, degradation, folder / ROBUSTNESS_LOG
        self._process: TrackerProcess | None = None
        self._interrupted = False

    def run(self, test: KeptMoments, thresholds: ThresholdsUsed, on_frame: Callable[[], None]) -> Robustness:
        """Run the pass on the trial's `test` stretch; `on_frame` is called before each frame and may raise to end it.

        Raises TrialEnded.
        """
        return Robustness(
            degradation=self._degradation,
            kinds={
                kind: tuple(self._at(kind, strength, test, thresholds, on_frame) for strength in STRENGTHS)
                for kind in self._degradation.kinds
            },
        )

    def interrupt(self) -> None:
        """End the pass from another thread, also during a call."""
        self._interrupted = True
        if self._process is not None:
            self._process.kill()

    def _at(
        self,
        kind: str,
        strength: float,
        test: KeptMoments,
        thresholds: ThresholdsUsed,
        on_frame: Callable[[], None],
    ) -> AtStrength:
        trial, degradation = self._trial, self._degradation.only(kind).scaled(strength)
        stream = test.stream.degraded(degrader(degradation, trial.seed))
        degraded = Delivery(moments(stream, test.regions), on_frame)
        self._process = trial.tracker_process(self._log)
        if self._interrupted:
            self._process.kill()
        with self._process as process:
            tracker = _DegradedInput(process, degraded)
            scores = replayed(tracker, test, trial, thresholds)
        return AtStrength(strength=strength, value=getattr(degradation, kind), delivered=degraded.digest, scores=scores)


class _DegradedInput:
    """A tracker that receives the degraded frame in place of each frame that the referee delivers."""

    def __init__(self, tracker: TrackerLike, degraded: Delivery) -> None:
        self._tracker, self._degraded = tracker, iter(degraded)

    def reset(self, seed: int) -> None:
        """A new stream begins."""
        self._tracker.reset(seed)

    def update(self, frame: GridFrame) -> None:
        """Update the tracker with the degraded frame of the same stamp."""
        received = next(self._degraded).frame
        assert received.stamp_ns == frame.stamp_ns
        self._tracker.update(received)

    def predict(self, steps: int) -> Forecast:
        """The tracker's forecast."""
        return self._tracker.predict(steps)

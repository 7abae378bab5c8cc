"""Passes of a trial under other conditions: its latency, scores on a simulated clock, and scores on degraded input.

A tracker is timed alone on the machine, by the calls of the trial: the same frames, and forecasts at the same frames.
It cannot recognise by its requests that it is timed. Every scored pass over the stream has a process of its own: a
tracker that keeps frames over `reset` would know the stream.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import GridFrame
from gridtrack.evaluation.hosting.timing import Call, Timings
from gridtrack.evaluation.hosting.tracker_process import TrackerProcess
from gridtrack.evaluation.referee.deadline import RATES, Costs, DeadlineTracker, Timeline, spare_steps, timeline
from gridtrack.evaluation.referee.referee import (
    WARM_UP,
    Delivery,
    KeptMoments,
    Moment,
    TrackerLike,
    moments,
    scored_forecasts,
)
from gridtrack.evaluation.runs.passes import (
    TWENTIETHS,
    AtRate,
    AtStrength,
    CallTimes,
    Deadline,
    Latency,
    Quantiles,
    Robustness,
    RoundTrips,
)
from gridtrack.evaluation.runs.plan import Trial
from gridtrack.evaluation.runs.result_files import Curves, rounded_curve
from gridtrack.evaluation.runs.scorekeeper import Counter, facts_of
from gridtrack.evaluation.runs.trial_record import ThresholdsUsed, TrialRecord
from gridtrack.evaluation.scores.definition import Floats
from gridtrack.evaluation.scores.registry import scores
from gridtrack.recordings.degradation import Degradation, degrader

MAX_FORECASTS, MIN_FORECASTS, MAX_TIMED_S = 61, 16, 30.0
"""Forecasts of a timed pass: at most MAX_FORECASTS; of a slow tracker at least MIN_FORECASTS, and no further one after
MAX_TIMED_S seconds of calls. The first one, which may compile and allocate, is not timed."""
LATENCY_LOG, DEADLINE_LOG, ROBUSTNESS_LOG = "latency.log", "deadline.log", "robustness.log"
STRENGTHS = (0.25, 0.5, 1.0)
"""Strengths as shares of the requested degradation; strength 0 is the trial's own score."""


def measure_latency(trial: Trial, folder: Path) -> Latency:
    """Time a tracker's updates and forecasts; its log goes to `folder`. Raises TrialEnded."""
    steps = trial.split.steps
    with trial.tracker_process(folder / LATENCY_LOG) as process:
        calls = _timed_calls(process, trial, trial.split.schedule.scored, steps)
    update, predict = map(_call_times, calls.timings.counted_ms())
    return Latency(
        clock=calls.timings.clock,
        device=process.description.device,
        round_trips=RoundTrips.of(calls.timings),
        update=update,
        predict=predict,
        predict_step=Quantiles(p50=predict.p50 / steps, p95=predict.p95 / steps, p99=predict.p99 / steps),
    )


def measure_deadline(trial: Trial, test: KeptMoments, record: TrialRecord, folder: Path) -> Deadline:
    """Time the tracker, then score it on its `test` stretch with the simulated clock, at the thresholds of `record`.

    It is scored at every rate of RATES. Forecasts reach further by the delay that the round trips of the trial show.
    The log of the last process goes to `folder`. Raises TrialEnded.
    """
    log, steps, scored = folder / DEADLINE_LOG, trial.split.steps, trial.split.schedule.scored
    reach = steps + spare_steps(record.round_trips.total_ms, trial.test.period_s * 1e3, steps)
    # on the simulated clock the newest forecast at a frame is at best of the frame before
    requested = range(scored.start - 1, scored.stop - 1, scored.step)
    with trial.tracker_process(log) as process:
        calls = _timed_calls(process, trial, requested, reach)
    costs = calls.costs()
    update_ms, predict_ms = map(_call_times, calls.timings.counted_ms())
    return Deadline(
        update_ms=update_ms,
        predict_ms=predict_ms,
        busy_ms=Quantiles.of(costs.busy_ms),
        highest_rate_hz=costs.highest_rate_hz,
        forecast_steps=reach,
        clock=costs.clock,
        device=process.description.device,
        round_trips=RoundTrips.of(calls.timings),
        rates=_at_every_rate(log, trial, test, record.thresholds, costs, reach),
    )


@dataclass
class _TimedCalls:
    """Timed calls; `newest` has for each update the index of the newest forecast."""

    timings: Timings = field(default_factory=Timings)
    newest: list[int] = field(default_factory=list)

    def add(self, update: Call, forecast: Call | None) -> None:
        """Add the calls of a frame; the first one has a forecast."""
        self.timings.updates.append(update)
        if forecast is not None:
            self.timings.forecasts.append(forecast)
        self.newest.append(len(self.timings.forecasts) - 1)

    def costs(self) -> Costs:
        """The durations of each update and of the newest forecast, as if every frame had a forecast."""
        updates_ms, forecasts_ms = self.timings.counted_ms()
        return Costs(updates_ms, forecasts_ms[self.newest], self.timings.clock)


def _timed_calls(process: TrackerProcess, trial: Trial, requested: Collection[int], steps: int) -> _TimedCalls:
    """Time the updates, and forecasts of `steps` at the `requested` frames, from the second such frame on."""
    calls, forecasts, timed_ms = _TimedCalls(), 0, 0.0
    process.reset(trial.seed)
    for index, frame in enumerate(trial.test):
        process.update(frame)
        update, forecast = _last_call(process), None
        if index in requested:
            process.predict(steps)
            forecast, forecasts = _last_call(process), forecasts + 1
        if forecasts > 1 or (forecasts == 1 == len(requested)):
            calls.add(update, forecast)
        timed_ms += update.round_trip_ms + (forecast.round_trip_ms if forecast else 0.0)
        slow = forecasts >= MIN_FORECASTS and timed_ms > MAX_TIMED_S * 1e3
        if slow or forecasts == min(MAX_FORECASTS, len(requested)):
            break
    return calls


def _last_call(process: TrackerProcess) -> Call:
    assert process.last_call is not None
    return process.last_call


def _at_every_rate(
    log: Path, trial: Trial, test: KeptMoments, thresholds: ThresholdsUsed, costs: Costs, reach: int
) -> tuple[AtRate, ...]:
    """Scores at each rate; rates with the same timeline share one pass over the stream."""
    schedule, period_ms = trial.split.schedule, trial.test.period_s * 1e3
    scores_of: dict[bytes, dict[str, Curves]] = {}
    results = []
    for rate in RATES:
        clock = timeline(schedule.frames, period_ms / rate, costs)
        key = clock.accepted.tobytes() + clock.newest.tobytes()
        if key not in scores_of:
            with trial.tracker_process(log) as process:
                tracker = DeadlineTracker(process, clock, schedule, reach, trial.test.grid.cell_m)
                scores_of[key] = _replayed(tracker, test, trial, thresholds)
        results.append(
            AtRate(
                rate=rate,
                rate_hz=round(rate * 1000.0 / period_ms, 6),
                frames=schedule.frames,
                missed=clock.missed,
                age_frames=Quantiles.of(_ages(clock)),
                scores=scores_of[key],
            )
        )
    return tuple(results)


def _ages(clock: Timeline) -> NDArray[np.int64]:
    """Age (F - WARM_UP,) of the newest delivered forecast at each frame after the warm-up, frames."""
    ages: NDArray[np.int64] = (np.arange(len(clock.newest)) - clock.newest)[WARM_UP:]
    return ages


def _call_times(ms: NDArray[np.float64]) -> CallTimes:
    twentieths = np.percentile(ms, TWENTIETHS, method="higher").tolist()
    return CallTimes(**Quantiles.of(ms).model_dump(), twentieths=tuple(twentieths))


def measure_robustness(
    trial: Trial,
    degradation: Degradation,
    test: KeptMoments,
    record: TrialRecord,
    folder: Path,
    on_frame: Callable[[], None],
    began: Callable[[Callable[[], None]], None],
) -> Robustness:
    """Score the tracker on its `test` stretch with each kind of the degradation separately, at every strength.

    At the thresholds of `record`. `on_frame()` is called before each frame, and may raise to end the pass; `began`
    receives the function that ends a process, before each process starts. The log of the last one goes to `folder`.
    Raises TrialEnded.
    """

    def at(kind: str, strength: float) -> AtStrength:
        own = degradation.only(kind).scaled(strength)
        stream = test.stream.degraded(degrader(own, trial.seed))
        degraded = Delivery(moments(stream, test.regions), on_frame)
        process = trial.tracker_process(folder / ROBUSTNESS_LOG)
        began(process.kill)
        with process:
            found = _replayed(_DegradedInput(process, degraded), test, trial, record.thresholds)
        return AtStrength(strength=strength, value=getattr(own, kind), delivered=degraded.digest, scores=found)

    kinds = {kind: tuple(at(kind, strength) for strength in STRENGTHS) for kind in degradation.kinds}
    return Robustness(degradation=degradation, kinds=kinds)


class _DegradedInput:
    """A tracker that receives the degraded frame in place of each frame that the referee delivers."""

    def __init__(self, tracker: TrackerLike, degraded: Delivery) -> None:
        self.reset, self.predict = tracker.reset, tracker.predict
        self._tracker, self._degraded = tracker, iter(degraded)

    def update(self, frame: GridFrame) -> None:
        """Update the tracker with the degraded frame of the same stamp."""
        received = next(self._degraded).frame
        assert received.stamp_ns == frame.stamp_ns
        self._tracker.update(received)


def _replayed(
    tracker: TrackerLike, frames: Iterable[Moment], trial: Trial, thresholds: ThresholdsUsed
) -> dict[str, Curves]:
    """The leading values of the scores that may lead, by score and stratum, of `tracker` on the trial's `frames`.

    Forecasts are made at the frames that the trial scored.
    """
    leading = [score for score in scores(trial.scores) if score.may_lead]
    facts = facts_of(trial.split, thresholds.thresholds(), trial.robot)
    counter, sums = Counter(leading, facts), dict[str, Floats]()
    for scored in scored_forecasts(tracker, frames, trial.split.schedule, trial.seed):
        for name, own in counter.count(scored).items():
            sums[name] = sums[name] + own if name in sums else own
    found = {}
    for score in leading:
        if score.name in sums:
            values = score.leading(sums[score.name], facts)
            found[score.name] = {name: rounded_curve(values[:, k]) for k, name in enumerate(score.strata(facts))}
    return found

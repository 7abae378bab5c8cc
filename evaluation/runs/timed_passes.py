"""Passes that time a tracker alone on the machine: latencies, and scores on a simulated clock with measured times."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.hosting.timing import TWENTIETHS, Call, Latencies, Timings
from gridtrack.evaluation.hosting.tracker_process import TrackerProcess
from gridtrack.evaluation.referee.deadline import RATES, Clock, Costs, DeadlineTracker, Timeline, spare_steps, timeline
from gridtrack.evaluation.referee.referee import WARM_UP, Delivery
from gridtrack.evaluation.referee.splits import SplitRegions
from gridtrack.evaluation.runs.passes import AtRate, CallTimes, Deadline, Latency, Quantiles
from gridtrack.evaluation.runs.plan import Trial
from gridtrack.evaluation.runs.replay import replayed_f1
from gridtrack.evaluation.runs.result_files import Curves
from gridtrack.evaluation.runs.trial_record import ThresholdsUsed

LATENCY_FRAMES = 120
"""Frames of the latency pass after the warm-up; every second one is forecast from."""
MAX_TIMED_FRAMES, MIN_TIMED_FRAMES, MAX_TIMED_S = 120, 30, 30.0
"""Frames whose update and forecast are timed after the warm-up: at most MAX_TIMED_FRAMES; of a slow tracker at least
MIN_TIMED_FRAMES, and no further one after MAX_TIMED_S seconds of calls."""
TRIAL_FORECASTS = 4
"""Forecasts at the end of the warm-up; their duration decides how far ahead the timed forecasts must reach."""
LATENCY_LOG, DEADLINE_LOG = "latency.log", "deadline.log"


def measure_latency(trial: Trial, folder: Path) -> Latency:
    """Time a tracker's updates and forecasts; its log goes to `folder`. Raises TrialEnded."""
    timings = Timings()
    with trial.tracker_process(folder / LATENCY_LOG) as process:
        process.reset(trial.seed)
        for index, frame in enumerate(islice(trial.test, WARM_UP + LATENCY_FRAMES)):
            process.update(frame)
            if index < WARM_UP:
                continue
            timings.add_update(_last_call(process))
            if index % 2 == 0:
                process.predict(trial.split.steps)
                timings.add_predict(_last_call(process))
    update, predict = timings.counted()
    return Latency(
        clock=timings.clock,
        update=_reported_times(update),
        predict=_reported_times(predict),
        predict_step=Quantiles(**{name: ms / trial.split.steps for name, ms in predict.summary().items()}),
    )


def _reported_times(latencies: Latencies) -> CallTimes:
    return CallTimes(**latencies.summary(), twentieths=latencies.twentieths())


def measure_deadline(trial: Trial, regions: SplitRegions, thresholds: ThresholdsUsed, folder: Path) -> Deadline:
    """Time the tracker, then score it on the simulated clock at every rate of RATES.

    Every pass over the stream has a process of its own: a tracker that keeps frames over `reset` would know the stream.
    The log of the last process goes to `folder`. Raises TrialEnded.
    """
    log = folder / DEADLINE_LOG
    with trial.tracker_process(log) as process:
        costs, reach = _measure(process, trial)
    return Deadline(
        update_ms=_call_times(costs.update_ms),
        predict_ms=_call_times(costs.predict_ms),
        busy_ms=_exact_quantiles(costs.busy_ms),
        highest_rate_hz=costs.highest_rate_hz,
        forecast_steps=reach,
        clock=costs.clock,
        rates=_at_every_rate(log, trial, regions, thresholds, costs, reach),
    )


def _measure(process: TrackerProcess, trial: Trial) -> tuple[Costs, int]:
    """The duration of the calls, and how many steps ahead the forecasts must reach."""
    steps, period_ms = trial.split.steps, trial.test.period_s * 1e3
    timings = Timings()
    update_calls: list[Call] = []
    predict_calls: list[Call] = []
    trial_ms = timed_ms = 0.0
    process.reset(trial.seed)
    for index, frame in enumerate(islice(trial.test, WARM_UP + MAX_TIMED_FRAMES)):
        process.update(frame)
        took_ms, update_call = process.last_ms, _last_call(process)
        if index >= WARM_UP:
            process.predict(steps + spare_steps(trial_ms, period_ms, steps))
            update_calls.append(update_call)
            predict_calls.append(_last_call(process))
            timings.add_update(update_calls[-1])
            timings.add_predict(predict_calls[-1])
            timed_ms += update_calls[-1].round_trip_ms + predict_calls[-1].round_trip_ms
            if len(update_calls) >= MIN_TIMED_FRAMES and timed_ms > MAX_TIMED_S * 1e3:
                break
        elif index >= WARM_UP - TRIAL_FORECASTS:
            process.predict(steps)
            # the very first forecast may compile and allocate: it is left out
            trial_ms = max(trial_ms, took_ms + process.last_ms) if index > WARM_UP - TRIAL_FORECASTS else 0.0
    clock = timings.clock
    update_ms, predict_ms = ([_duration(call, clock) for call in calls] for calls in (update_calls, predict_calls))
    return Costs(update_ms, predict_ms, clock), steps + spare_steps(trial_ms, period_ms, steps)


def _last_call(process: TrackerProcess) -> Call:
    assert process.last_call is not None
    return process.last_call


def _duration(call: Call, clock: Clock) -> float:
    return call.own_ms if clock == "tracker" else call.round_trip_ms


def _at_every_rate(
    log: Path, trial: Trial, regions: SplitRegions, thresholds: ThresholdsUsed, costs: Costs, reach: int
) -> tuple[AtRate, ...]:
    """Scores at each rate; rates with the same timeline share one pass over the stream."""
    schedule, period_ms = trial.split.schedule, trial.test.period_s * 1e3
    f1_of: dict[bytes, Curves] = {}
    results = []
    for rate in RATES:
        clock = timeline(schedule.frames, period_ms / rate, costs)
        key = clock.accepted.tobytes() + clock.newest.tobytes()
        if key not in f1_of:
            frames = Delivery(trial.test, lambda: None, regions.test)
            with trial.tracker_process(log) as process:
                tracker = DeadlineTracker(process, clock, schedule, reach, trial.test.grid.cell_m)
                f1_of[key] = replayed_f1(tracker, frames, trial, thresholds)
        results.append(
            AtRate(
                rate=rate,
                rate_hz=round(rate * 1000.0 / period_ms, 6),
                frames=schedule.frames,
                missed=clock.missed,
                age_frames=_exact_quantiles(_ages(clock)),
                f1=f1_of[key],
            )
        )
    return tuple(results)


def _ages(clock: Timeline) -> NDArray[np.int64]:
    """Age (F - WARM_UP,) of the newest delivered forecast at each frame after the warm-up, frames."""
    ages: NDArray[np.int64] = (np.arange(len(clock.newest)) - clock.newest)[WARM_UP:]
    return ages


def _call_times(ms: Sequence[float]) -> CallTimes:
    twentieths = np.percentile(ms, TWENTIETHS, method="higher")
    found = _exact_quantiles(np.asarray(ms))
    return CallTimes(p50=found.p50, p95=found.p95, p99=found.p99, twentieths=tuple(map(float, twentieths)))


def _exact_quantiles(values: NDArray[np.float64] | NDArray[np.int64]) -> Quantiles:
    p50, p95, p99 = np.percentile(values, (50, 95, 99), method="higher")
    return Quantiles(p50=float(p50), p95=float(p95), p99=float(p99))

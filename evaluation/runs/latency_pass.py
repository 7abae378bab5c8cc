"""The latency pass: one tracker at a time, alone on the machine, over part of the test stretch."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

from gridtrack.evaluation.hosting.timing import Latencies, Timings
from gridtrack.evaluation.referee.referee import WARM_UP
from gridtrack.evaluation.runs.passes import CallTimes, Latency, Quantiles
from gridtrack.evaluation.runs.plan import Trial

TIMED_FRAMES = 120
"""Frames timed after the warm-up; every second one is forecast from."""
LATENCY_LOG = "latency.log"


def measure_latency(trial: Trial, folder: Path) -> Latency:
    """Time a tracker's updates and forecasts; its log goes to `folder`. Raises TrialEnded."""
    timings = Timings()
    with trial.tracker_process(folder / LATENCY_LOG) as process:
        process.reset(trial.seed)
        for index, frame in enumerate(islice(trial.test, WARM_UP + TIMED_FRAMES)):
            process.update(frame)
            if index < WARM_UP:
                continue
            assert process.last_call is not None
            timings.add_update(process.last_call)
            if index % 2 == 0:
                process.predict(trial.split.steps)
                timings.add_predict(process.last_call)
    update, predict = timings.counted()
    return Latency(
        clock=timings.clock,
        update=_call_times(update),
        predict=_call_times(predict),
        predict_step=Quantiles(**{name: ms / trial.split.steps for name, ms in predict.summary().items()}),
    )


def _call_times(latencies: Latencies) -> CallTimes:
    return CallTimes(**latencies.summary(), twentieths=latencies.twentieths())

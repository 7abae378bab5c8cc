"""Measurements of a tracker beside its scores: latencies, scores under deadlines, scores on degraded input."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from gridtrack.common.notices import Line
from gridtrack.evaluation.hosting.timing import Timings
from gridtrack.evaluation.referee.deadline import Clock
from gridtrack.evaluation.runs.result_files import Curves, ResultModel
from gridtrack.recordings.degradation import Degradation

TWENTIETHS = range(0, 101, 5)
"""Percentiles in steps of a twentieth of the calls."""
HIGHEST = 1e6
"""A rate, in Hz or as a multiple, or a strength of degradation above this is refused."""
MOST_CONDITIONS = 20
"""More rates, kinds or strengths than this are refused."""


class Quantiles(ResultModel):
    """50th, 95th and 99th percentile."""

    p50: float
    p95: float
    p99: float

    @classmethod
    def of(cls, values: Sequence[float] | NDArray[np.float64] | NDArray[np.int64]) -> Quantiles:
        """Of the values, each percentile one of them; there is at least one."""
        p50, p95, p99 = np.percentile(values, (50, 95, 99), method="higher").tolist()
        return Quantiles(p50=p50, p95=p95, p99=p99)


class CallTimes(Quantiles):
    """Milliseconds of calls of one kind."""

    twentieths: Annotated[tuple[float, ...], Field(max_length=len(TWENTIETHS))] = ()
    """Percentiles 0, 5, 10 to 100: each stretch between two holds a twentieth of the calls. Earlier runs have none."""

    @model_validator(mode="after")
    def _twentieths_increase(self) -> Self:
        if self.twentieths and len(self.twentieths) != len(TWENTIETHS):
            raise ValueError(f"twentieths: {len(self.twentieths)} percentiles where {len(TWENTIETHS)} belong")
        if any(not 0.0 <= earlier <= later for earlier, later in pairwise(self.twentieths)):
            raise ValueError("twentieths: the percentiles do not increase")
        return self


class RoundTrips(ResultModel):
    """Median round trips of the calls of a pass, ms; 0 without calls."""

    update_ms: float = 0.0
    predict_ms: float = 0.0

    @classmethod
    def of(cls, timings: Timings) -> Self:
        """Of the calls so far."""
        medians = (
            float(np.median([call.round_trip_ms for call in calls])) if calls else 0.0
            for calls in (timings.updates, timings.forecasts)
        )
        update_ms, predict_ms = (float(f"{ms:.4g}") for ms in medians)
        return cls(update_ms=update_ms, predict_ms=predict_ms)

    @property
    def total_ms(self) -> float:
        """Time of an update and a forecast, ms."""
        return self.update_ms + self.predict_ms


class Latency(ResultModel):
    """Milliseconds of calls, alone on the machine."""

    clock: Clock = "tracker"
    """By the tracker's own clock; by the round trip (`host`) where that is far longer than the tracker reports."""

    device: Line = ""
    """The device on which the tracker computes: its word, not checked; empty for the processor."""
    round_trips: RoundTrips = RoundTrips()
    update: CallTimes
    predict: CallTimes
    predict_step: Quantiles
    """A forecast's time divided by its number of steps."""


class AtRate(ResultModel):
    """Scores of a trial with frames at `rate` times the rate of the stream."""

    rate: float = Field(gt=0.0, le=HIGHEST)
    rate_hz: float = Field(gt=0.0, le=HIGHEST)
    frames: int
    """Of the test stretch."""
    missed: int
    """Frames that the tracker is not given, because it is busy."""
    age_frames: Quantiles
    """Age of the newest forecast at each frame, in frames."""
    scores: dict[str, Curves]
    """By the name of each score that may lead, its leading value."""


class Deadline(ResultModel):
    """A trial on a simulated clock: the time of its calls, alone on the machine, and its scores in time."""

    update_ms: CallTimes
    predict_ms: CallTimes
    busy_ms: Quantiles
    """An update and the forecast after it."""
    highest_rate_hz: float = Field(gt=0.0)
    """The rate at which 99 of 100 frames are processed before the next one arrives."""
    clock: Clock = "tracker"
    """As of the latency."""
    device: Line = ""
    """As of the latency."""
    round_trips: RoundTrips = RoundTrips()
    """Of the timed calls."""
    forecast_steps: int
    """How many steps ahead the forecasts reach, for delays to be covered."""
    rates: tuple[AtRate, ...] = Field(min_length=1, max_length=MOST_CONDITIONS)


class Followed(ResultModel):
    """A trial that followed its recording while it was written: its deadlines are real ones."""

    frames: int
    """Frames with a deadline: written after the following began."""
    missed: int
    """Frames among them that the busy tracker did not receive."""
    age_frames: Quantiles | None
    """Age of the newest forecast in time at each of them, in frames; null if there are none."""
    forecast_steps: int
    """How many steps ahead the forecasts reach, for delays to be covered."""


class AtStrength(ResultModel):
    """Scores of a tracker that receives degraded frames, against the undegraded ones."""

    strength: float = Field(ge=0.0, le=HIGHEST)
    """Share of the requested degradation."""
    value: float = Field(ge=0.0, le=HIGHEST)
    """The degradation itself, in its unit of measurement."""
    delivered: str
    """Hash of the degraded frames; empty for strength 0."""
    scores: dict[str, Curves]
    """As of a rate."""


class Robustness(ResultModel):
    """Scores under each kind of degradation by itself, in the order of its strength."""

    degradation: Degradation
    """As requested, at strength 1."""
    kinds: dict[str, Annotated[tuple[AtStrength, ...], Field(min_length=2, max_length=MOST_CONDITIONS)]] = Field(
        max_length=MOST_CONDITIONS
    )

    @model_validator(mode="after")
    def _values_increase(self) -> Self:
        for kind, points in self.kinds.items():
            if any(later.value <= earlier.value for earlier, later in pairwise(points)):
                raise ValueError(f"degradation {kind}: its values do not increase")
        return self

"""Deadlines on a simulated clock: the frames that a busy tracker misses, and the newest forecast at each frame.

A free tracker accepts a frame, updates and forecasts; until the forecast is delivered it is busy, and never receives
the frames of that time. The durations of the calls are measured; given them, the timeline does not depend on the
machine. Scoring the newest delivered forecast follows Li, Wang and Ramanan, "Towards Streaming Perception", ECCV 2020.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, Shift, rolled, shift_between
from gridtrack.evaluation.referee.referee import Schedule, TrackerLike
from gridtrack.trackers.contract import Forecast

Clock = Literal["tracker", "host"]
"""`tracker`: the time that it reports, without the transport of messages; `host`: the round trip of each call."""
RATES = (0.5, 1.0, 2.0, 4.0)
"""Simulated rates of the stream, as multiples of its own rate."""


@dataclass(frozen=True, slots=True)
class Costs:
    """Measured durations, ms: `update_ms` and `predict_ms` of the same frames, in their order, by this `clock`."""

    update_ms: NDArray[np.float64]
    predict_ms: NDArray[np.float64]
    clock: Clock = "tracker"

    @property
    def busy_ms(self) -> NDArray[np.float64]:
        """Time from accepting a frame to delivering its forecast (n,), ms."""
        return np.add(self.update_ms, self.predict_ms)

    @property
    def highest_rate_hz(self) -> float:
        """The rate at which 99 % of the frames are finished before the next one."""
        return 1000.0 / max(float(np.percentile(self.busy_ms, 99, method="higher")), 1e-6)


@dataclass(frozen=True, slots=True)
class Timeline:
    """A simulation over F frames: `accepted` (F,) bool, whether the tracker receives the frame, and `newest` (F,)
    int64, the frame of the newest forecast delivered by then; -1 before the first."""

    accepted: NDArray[np.bool_]
    newest: NDArray[np.int64]

    @property
    def missed(self) -> int:
        """Number of frames that the tracker does not receive."""
        return int((~self.accepted).sum())

    def lasting(self, frames: int) -> Timeline:
        """The same for `frames` frames or more: the tracker receives none of the added frames."""
        added = max(0, frames - len(self.newest))
        newest = np.pad(self.newest, (0, added), "edge") if len(self.newest) else np.full(added, -1, np.int64)
        return Timeline(np.pad(self.accepted, (0, added)), newest)


def timeline(frames: int, period_ms: float, costs: Costs) -> Timeline:
    """The timeline of `frames` frames at `period_ms`; the k-th accepted frame takes as long as the k-th measured one.

    The measured durations are repeated if they are fewer. A forecast delivered, or a tracker free, exactly at the
    stamp of a frame is in time for it. Times are integer nanoseconds.
    """
    period_ns = round(period_ms * 1e6)
    busy_ns = [round(u * 1e6) + round(p * 1e6) for u, p in zip(costs.update_ms, costs.predict_ms, strict=True)]
    accepted, newest = np.zeros(frames, np.bool_), np.full(frames, -1, np.int64)
    free_ns, count, current, delivered = 0, 0, -1, -1
    for index in range(frames):
        now_ns = index * period_ns
        if free_ns <= now_ns:
            delivered, current = current, index
            free_ns = now_ns + busy_ns[count % len(busy_ns)]
            accepted[index], count = True, count + 1
        newest[index] = current if free_ns <= now_ns else delivered
    return Timeline(accepted, newest)


def spare_steps(busy_ms: float, period_ms: float, steps: int) -> int:
    """Number of extra steps to forecast, so that the oldest forecast in use still covers `steps` ahead.

    At most `steps`: a slower tracker has no forecast for the end of the horizon.
    """
    return min(steps, 2 * math.ceil(busy_ms / period_ms))


class DeadlineTracker:
    """A TrackerLike on the simulated clock: it does not receive missed frames, and predicts with delivered forecasts.

    `predict` at frame s uses the newest delivered forecast, made at frame t: step n is its step s - t + n, or its last
    step where it is shorter; all cells are free before the first delivery, and so are those that came into the window
    since frame t. Forecasts that `schedule` does not use are
    not computed: they take time on the clock only.
    """

    def __init__(self, tracker: TrackerLike, clock: Timeline, schedule: Schedule, reach: int, cell_m: float) -> None:
        """`reach`: the last step of the tracker's forecasts."""
        self._tracker, self._timeline, self._reach, self._cell_m = tracker, clock, reach, cell_m
        self._used = {int(clock.newest[index]) for index in range(schedule.frames) if schedule.due(index)}

    def reset(self, seed: int) -> None:
        """A new stream begins."""
        self._tracker.reset(seed)
        self._index = -1
        self._forecasts: dict[int, tuple[SE2, Forecast]] = {}
        self._shape = (0, 0)
        self._window = SE2()

    def update(self, frame: GridFrame) -> None:
        """Advance the clock by one frame; the tracker receives the frame if it is free."""
        self._index += 1
        self._shape, self._window = frame.occupied.shape, frame.world_T_grid
        if self._timeline.accepted[self._index]:
            self._tracker.update(frame)
            if self._index in self._used:
                self._forecasts[self._index] = self._window, self._tracker.predict(self._reach)

    def predict(self, steps: int) -> Forecast:
        """The newest delivered forecast, for steps 0..steps from the current frame."""
        made_at = int(self._timeline.newest[self._index])
        if made_at < 0:
            return Forecast(np.zeros((steps + 1, *self._shape), np.float32))
        self._forecasts = {index: f for index, f in self._forecasts.items() if index >= made_at}
        window, forecast = self._forecasts[made_at]
        shift = shift_between(window, self._window, self._cell_m)
        return read_later(forecast, self._index - made_at, shift, steps)


def read_later(forecast: Forecast, age: int, shift: Shift, steps: int) -> Forecast:
    """A forecast read `age` frames after it was made, for steps 0..steps from then on, in a window moved by `shift`.

    Its last step stands for those after it; cells that came into the window are free, of no class and no velocity. What
    a forecast says of its own time alone, objects and velocities of step 0 only, is not read later.
    """
    used_steps = np.minimum(age + np.arange(steps + 1), len(forecast.occupancy) - 1)
    occupancy, semantics = forecast.occupancy[used_steps], forecast.semantics
    if semantics is not None:
        semantics = rolled(semantics[used_steps], shift, np.float32(1.0 / semantics.shape[1]))
    velocity, futures = forecast.velocity, forecast.futures
    if velocity is not None and velocity.ndim == 4:
        velocity = velocity[used_steps]
    elif age:
        velocity = None
    if velocity is not None:
        velocity = rolled(velocity, shift, np.nan)
    if futures is not None:
        futures = rolled(futures[:, used_steps], shift, 0)
    objects = () if age or shift else forecast.objects
    return Forecast(rolled(occupancy, shift, np.float32(0.0)), semantics, velocity, objects, futures)

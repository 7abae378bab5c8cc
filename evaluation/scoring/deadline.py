"""Deadlines on a simulated clock: which frames a busy tracker misses, and which forecast is there at each frame.

A tracker takes a frame when it comes, updates and forecasts; until the forecast is delivered it is busy, and the frames
that come meanwhile are missed: it is never given them. What each call takes was measured; from there on nothing depends
on the machine, so a timeline can be worked out by hand. (The idea of scoring what is there in time: Li, Wang, Ramanan,
"Towards Streaming Perception", ECCV 2020.)
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import GridFrame
from gridtrack.evaluation.scoring.referee import Schedule, TrackerLike
from gridtrack.trackers.contract import Forecast

RATES = (0.5, 1.0, 2.0, 4.0)
"""How fast the stream comes, as multiples of its own rate."""


@dataclass(frozen=True, slots=True)
class Costs:
    """What taking a frame costs, milliseconds: `update_ms` and `predict_ms` of the same frames, in their order."""

    update_ms: Sequence[float]
    predict_ms: Sequence[float]

    @property
    def busy_ms(self) -> NDArray[np.float64]:
        """From taking a frame until its forecast is delivered (n,)."""
        return np.add(self.update_ms, self.predict_ms)

    @property
    def highest_rate_hz(self) -> float:
        """The rate at which 99 of 100 frames are done before the next one comes."""
        return 1000.0 / max(float(np.percentile(self.busy_ms, 99, method="higher")), 1e-6)


@dataclass(frozen=True, slots=True)
class Timeline:
    """What happens at each of F frames: `taken` (F,) bool, whether the tracker is free to take it, and `newest` (F,)
    int64, the frame that the newest forecast delivered by then was made from; -1 where there is none yet."""

    taken: NDArray[np.bool_]
    newest: NDArray[np.int64]

    @property
    def missed(self) -> int:
        """How many frames the tracker is not given."""
        return int((~self.taken).sum())


def timeline(frames: int, period_ms: float, costs: Costs) -> Timeline:
    """The timeline of `frames` that come one `period_ms` apart; the k-th frame taken costs as the k-th measured did.

    Costs are used over again where they are fewer. A forecast delivered, or a tracker free, at the very moment a frame
    comes is in time for it. Times are kept in whole nanoseconds.
    """
    period_ns = round(period_ms * 1e6)
    busy_ns = [round(u * 1e6) + round(p * 1e6) for u, p in zip(costs.update_ms, costs.predict_ms, strict=True)]
    taken, newest = np.zeros(frames, np.bool_), np.full(frames, -1, np.int64)
    free_ns, count, current, delivered = 0, 0, -1, -1
    for index in range(frames):
        now_ns = index * period_ns
        if free_ns <= now_ns:
            delivered, current = current, index
            free_ns = now_ns + busy_ns[count % len(busy_ns)]
            taken[index], count = True, count + 1
        newest[index] = current if free_ns <= now_ns else delivered
    return Timeline(taken, newest)


def spare_steps(busy_ms: float, period_ms: float, steps: int) -> int:
    """How many steps further a tracker must forecast so that its stalest forecast still reaches `steps` ahead.

    At most as many again: who is slower than that has nothing to say about the end of the horizon.
    """
    return min(steps, 2 * math.ceil(busy_ms / period_ms))


class OnTime:
    """A tracker as the clock lets it be: it is not given the frames it misses, and answers with what is there.

    A question at frame s about step n is answered by the newest delivered forecast, made at frame t, with its step
    s - t + n; by its last step where it does not reach so far, and with nothing occupied where there is none yet.
    Forecasts that no question of `schedule` reads are not asked for: they cost time on the clock only.
    """

    def __init__(self, tracker: TrackerLike, kept: Timeline, schedule: Schedule, reach: int) -> None:
        """`reach`: how many steps ahead its forecasts go."""
        self._tracker, self._timeline, self._reach = tracker, kept, reach
        self._asked = {int(kept.newest[index]) for index in range(schedule.frames) if schedule.due(index)}

    def reset(self, seed: int) -> None:
        """A new stream begins."""
        self._tracker.reset(seed)
        self._index = -1
        self._forecasts: dict[int, Forecast] = {}
        self._shape = (0, 0)

    def update(self, frame: GridFrame) -> None:
        """The next frame comes; the tracker is given it only where it is free."""
        self._index += 1
        self._shape = frame.occupied.shape
        if self._timeline.taken[self._index]:
            self._tracker.update(frame)
            if self._index in self._asked:
                self._forecasts[self._index] = self._tracker.predict(self._reach)

    def predict(self, steps: int) -> Forecast:
        """What is there now, for steps 0..steps from the newest frame that came."""
        made_at = int(self._timeline.newest[self._index])
        if made_at < 0:
            return Forecast(np.zeros((steps + 1, *self._shape), np.float32))
        self._forecasts = {index: f for index, f in self._forecasts.items() if index >= made_at}
        forecast = self._forecasts[made_at]
        read = np.minimum(self._index - made_at + np.arange(steps + 1), self._reach)
        semantics = None if forecast.semantics is None else forecast.semantics[read]
        return Forecast(forecast.occupancy[read], semantics)

"""Speed against a reference tracker of the same run: machines differ by a time, and hardly by a ratio of times."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

from gridtrack.evaluation.regression.measurement import Baseline, Measurement, Unmeasured


@dataclass(frozen=True, slots=True)
class SpeedRow:
    """How many times as long as the reference a tracker takes for one call, in the baseline and in the run."""

    label: str
    call: Literal["update", "predict"]
    reference: str
    ratio_baseline: float
    ratio_run: float
    margin: float

    @property
    def growth(self) -> float:
        """By which share it takes longer; negative where it is quicker."""
        return self.ratio_run / self.ratio_baseline - 1.0

    @property
    def verdict(self) -> Literal["worse", "no worse"]:
        """Whether it grew beyond the margin."""
        return "worse" if self.growth > self.margin else "no worse"


def compare_speed(
    baseline: Baseline, run: Measurement, reference: str | None, margin: float
) -> tuple[tuple[SpeedRow, ...], tuple[str, ...]]:
    """The rows of every tracker but the reference, and what to know where speed is not judged.

    Raises Unmeasured where it was asked for, and either side has a trial without latency figures.
    """
    first = baseline.first
    without = [reason for then in baseline.runs for reason in _without_speed(first, then, "baseline")]
    without += _without_speed(first, run, "run")
    if reference is None:
        why = without[0] if without else "name a tracker to measure against with --speed-reference"
        return (), (f"speed is not judged: {why}",)
    if without:
        raise Unmeasured([f"speed cannot be judged: {reason}" for reason in without])
    calls: tuple[Literal["update", "predict"], ...] = ("update", "predict")
    rows = []
    for label in (label for label in first.trackers if label != reference):
        for call in calls:
            then, now = (_ratio(runs, first, label, reference, call) for runs in (baseline.runs, [run]))
            rows.append(SpeedRow(label, call, reference, then, now, margin))
    return tuple(rows), ()


def _without_speed(asked: Measurement, side: Measurement, name: str) -> Iterator[str]:
    """A reason for each trial that the baseline has and that was not timed on this side."""
    for label, recording, _ in asked.trials():
        if side.trackers[label].recordings[recording].speed is None:
            yield f"{label}@{recording} has no latency figures in the {name}: compare with --latency"


def _ratio(runs: Sequence[Measurement], asked: Measurement, label: str, reference: str, call: str) -> float:
    """Geometric mean, over runs and the baseline's recordings, of the time of one call as a multiple of the
    reference's."""
    ratios = [
        getattr(run.trackers[label].recordings[name].speed, f"{call}_ms")
        / getattr(run.trackers[reference].recordings[name].speed, f"{call}_ms")
        for run in runs
        for name in asked.recordings
    ]
    return math.exp(sum(map(math.log, ratios)) / len(ratios))

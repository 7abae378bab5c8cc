"""Speed as a ratio to the times of a reference tracker of the same run, which depends little on the machine; and the
row of times measured in turns with a base (`turns.py`)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

from gridtrack.evaluation.regression.measurement import Baseline, Measurement, Unmeasured

CallKind = Literal["update", "predict"]
CALLS: tuple[CallKind, ...] = ("update", "predict")


@dataclass(frozen=True, slots=True)
class SpeedRow:
    """The time of a tracker for one call as a multiple of the reference's, in the baseline and in the run."""

    label: str
    call: CallKind
    reference: str
    ratio_baseline: float
    ratio_run: float
    margin: float

    @property
    def growth(self) -> float:
        """Growth of the ratio as a share; negative where the tracker is faster."""
        return self.ratio_run / self.ratio_baseline - 1.0

    @property
    def verdict(self) -> Literal["worse", "no worse"]:
        """Whether the growth exceeds the margin."""
        return "worse" if self.growth > self.margin else "no worse"


@dataclass(frozen=True, slots=True)
class TurnsRow:
    """The time of a call as a multiple of its base's time, with a 95 % interval over rounds."""

    label: str
    call: CallKind
    base: str
    ratio: float
    low: float
    high: float
    rounds: int
    margin: float

    @property
    def verdict(self) -> Literal["worse", "no worse"]:
        """Whether the whole interval is beyond the margin."""
        return "worse" if self.low > 1.0 + self.margin else "no worse"


def compare_speed(
    baseline: Baseline, run: Measurement, reference: str | None, margin: float
) -> tuple[tuple[SpeedRow, ...], tuple[str, ...]]:
    """The rows of every tracker except the reference; without a reference no rows, and a note if both sides have times.

    Raises Unmeasured if a reference is given and a trial of either side has no latency.
    """
    first = baseline.first
    without = [reason for then in baseline.runs for reason in _without_speed(first, then, "baseline")]
    without += _without_speed(first, run, "run")
    if reference is None:
        return (), () if without else ("speed is not judged: name the tracker to compare with by --speed-reference",)
    if without:
        raise Unmeasured([f"speed cannot be judged: {reason}" for reason in without])
    rows = []
    for label in (label for label in first.trackers if label != reference):
        for call in CALLS:
            then, now = (_time_ratio(runs, first, label, reference, call) for runs in (baseline.runs, [run]))
            rows.append(SpeedRow(label, call, reference, then, now, margin))
    return tuple(rows), ()


def _without_speed(baseline: Measurement, side: Measurement, name: str) -> Iterator[str]:
    """A reason for each trial of the baseline that has no times on this side."""
    for label, recording, _ in baseline.trials():
        if side.trackers[label].recordings[recording].speed is None:
            yield f"{label}@{recording} has no latency in the {name}: compare with --latency"


def _time_ratio(runs: Sequence[Measurement], baseline: Measurement, label: str, reference: str, call: str) -> float:
    """The ratio of the times of one call: geometric mean over runs and the baseline's recordings."""
    ratios = [
        getattr(run.trackers[label].recordings[name].speed, f"{call}_ms")
        / getattr(run.trackers[reference].recordings[name].speed, f"{call}_ms")
        for run in runs
        for name in baseline.recordings
    ]
    return math.exp(sum(map(math.log, ratios)) / len(ratios))

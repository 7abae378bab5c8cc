"""Which kept forecasts come first onto the page: the worst, the most telling and ordinary ones, in turns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import polars as pl

from gridtrack.reports.run import ReportError
from gridtrack.reports.table import MAIN_STRATUM

FEW_CELLS = 5
"""A moment with fewer occupied cells stands out after all others: F1 of one cell is 0 or 1 by chance."""
LEAST_DIFFERENCE = 0.01
"""A moment in which the trackers' F1 differ by less is not called telling."""


@dataclass(frozen=True)
class FrameScore:
    """The counts of one tracker on cells in motion, at one scored frame and step."""

    tp: int
    fp: int
    fn: int

    @property
    def occupied(self) -> int:
        """Occupied in-motion cells of the observed frame: the same for every tracker."""
        return self.tp + self.fn

    @property
    def f1(self) -> float:
        """F1 of this frame alone; 0 where no cell was occupied and none was forecast."""
        return 2 * self.tp / max(2 * self.tp + self.fp + self.fn, 1)


@dataclass(frozen=True)
class ChosenMoment:
    """A kept forecast, by the stamp of frame t, and why it is on the page: `worst`, `telling` or `ordinary`."""

    stamp_ns: int
    reason: str


def moments_in_order(
    scores: Mapping[str, Mapping[int, FrameScore]], trackers: Sequence[str]
) -> tuple[ChosenMoment, ...]:
    """Every moment that all of `scores` have, once, the ones to keep first: worst, telling and ordinary in turns.

    `scores`: the scores of each trial by label and stamp; `trackers`: the labels by which moments are judged. Worst: by
    the mean F1 of the trackers, where a cell was occupied. Telling: by the range of their F1. Both have moments of few
    cells last. Ordinary: each as far in time as possible from those before it.
    """
    stamps = sorted(set.intersection(*(set(frames) for frames in scores.values()))) if scores else []
    occupied = [s for s in stamps if any(frames[s].occupied for frames in scores.values())]
    f1 = {s: [scores[name][s].f1 for name in trackers] for s in occupied} if trackers else {}
    ranges = {s: max(values) - min(values) for s, values in f1.items()}
    few = {s: max(frames[s].occupied for frames in scores.values()) < FEW_CELLS for s in occupied}
    worst = sorted(f1, key=lambda s: (few[s], sum(f1[s]), s))
    telling = sorted((s for s in f1 if ranges[s] >= LEAST_DIFFERENCE), key=lambda s: (few[s], -ranges[s], s))
    queues = {"worst": worst, "telling": telling, "ordinary": _spread(stamps)}
    chosen: dict[int, str] = {}
    while len(chosen) < len(stamps):
        for reason, queue in queues.items():
            stamp = next((s for s in queue if s not in chosen), None)
            if stamp is not None:
                chosen[stamp] = reason
    return tuple(ChosenMoment(stamp, reason) for stamp, reason in chosen.items())


def _spread(stamps: Sequence[int]) -> list[int]:
    """The stamps, each as far as possible from those before it; the first two are the ends."""
    rest = list(stamps)
    order: list[int] = []
    while rest:
        farthest = max(rest, key=lambda s: (min((abs(s - o) for o in order), default=0), -s))
        rest.remove(farthest)
        order.append(farthest)
    return order


def frame_scores(path: Path, steps: Sequence[int]) -> dict[int, dict[int, FrameScore]]:
    """The scores of cells in motion by step and stamp, from the scores.parquet of a trial. Raises ReportError."""
    try:
        rows = (
            pl.scan_parquet(path, glob=False)
            .filter(pl.col("step").is_in(list(steps)) & (pl.col("stratum") == MAIN_STRATUM))
            .select("step", "stamp_ns", "tp", "fp", "fn")
            .collect()
        )
    except (OSError, pl.exceptions.PolarsError) as error:
        raise ReportError(f"{path}: cannot be read as scores ({str(error).splitlines()[0]}); run it again") from None
    scores: dict[int, dict[int, FrameScore]] = {step: {} for step in steps}
    for step, stamp, tp, fp, fn in rows.iter_rows():
        scores[step][stamp] = FrameScore(tp, fp, fn)
    return scores

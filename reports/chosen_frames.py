"""The choice of the frames that a report shows as pictures: one rule for every tracker, stated on the page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import polars as pl

from gridtrack.reports.run import ReportError
from gridtrack.reports.table import MAIN_STRATUM

LEAST_DIFFERENCE = 0.01
"""Trackers whose F1 differ by less are not shown as differing."""


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
class ChosenFrame:
    """A scored frame to show, and the reason why it was chosen."""

    stamp_ns: int
    reason: str


def selection_rule(parts: int, horizon_s: float) -> str:
    """The rule of `choose_frames` as a sentence."""
    each = f"from each of {parts} equal parts of the stretch" if parts > 1 else "from the stretch"
    return (
        "Chosen by one rule for every tracker, among the frames whose forecasts the run kept:"
        f" {each} the frame with the most occupied in-motion cells {horizon_s:.3g} s later; and one more, where the"
        " trackers' F1 on in-motion cells at that horizon differ most (the floor is not counted)."
    )


def choose_frames(
    scores: Mapping[str, Mapping[int, FrameScore]], trackers: Sequence[str], parts: int
) -> tuple[ChosenFrame, ...]:
    """At most `parts` + 1 frames in the order of time, among the frames that every trial in `scores` has.

    `scores`: the scores of each trial by label and stamp; `trackers`: the labels whose F1 are compared.
    """
    stamps = sorted(set.intersection(*(set(frames) for frames in scores.values()))) if scores else []
    if not stamps:
        return ()
    occupied = {stamp: frames[stamp].occupied for frames in scores.values() for stamp in stamps}
    chosen: dict[int, str] = {}
    width = (stamps[-1] - stamps[0]) // parts + 1
    for part in range(parts):
        inside = [s for s in stamps if part == (s - stamps[0]) // width]
        if inside:
            busiest = max(inside, key=lambda s: (occupied[s], -s))
            chosen[busiest] = f"most occupied in-motion cells of part {part + 1}: {occupied[busiest]}"
    rest = [s for s in stamps if s not in chosen]
    if rest and len(trackers) > 1:
        ranges = {s: _range([scores[name][s].f1 for name in trackers]) for s in rest}
        widest = max(rest, key=lambda s: (ranges[s], -s))
        if ranges[widest] >= LEAST_DIFFERENCE:
            chosen[widest] = f"largest difference between trackers: {ranges[widest]:.2f} in F1 on in-motion cells"
    return tuple(ChosenFrame(stamp, chosen[stamp]) for stamp in sorted(chosen))


def _range(values: Sequence[float]) -> float:
    return max(values) - min(values)


def frame_scores(path: Path, step: int) -> dict[int, FrameScore]:
    """The scores of cells in motion at `step` by stamp, from the scores.parquet of a trial. Raises ReportError."""
    try:
        rows = (
            pl.scan_parquet(path, glob=False)
            .filter((pl.col("step") == step) & (pl.col("stratum") == MAIN_STRATUM))
            .select("stamp_ns", "tp", "fp", "fn")
            .collect()
        )
    except (OSError, pl.exceptions.PolarsError) as error:
        raise ReportError(f"{path}: cannot be read as scores ({str(error).splitlines()[0]}); run it again") from None
    return {stamp: FrameScore(tp, fp, fn) for stamp, tp, fp, fn in rows.iter_rows()}

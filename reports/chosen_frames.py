"""Choosing the moments that a report pictures: by one rule that is the same for every tracker, and said on the page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import polars as pl

from gridtrack.reports.run import ReportError

COLUMNS = ("stamp_ns", "step", "stratum", "tp", "fp", "fn")


@dataclass(frozen=True)
class FrameScore:
    """One tracker's moving cells at one scored frame and step: hits, false alarms and misses."""

    tp: int
    fp: int
    fn: int

    @property
    def occupied(self) -> int:
        """Occupied moving cells that came: the same for every tracker."""
        return self.tp + self.fn

    @property
    def f1(self) -> float:
        """F1 of this moment alone; 0 where nothing was there and nothing was forecast."""
        return 2 * self.tp / max(2 * self.tp + self.fp + self.fn, 1)


@dataclass(frozen=True)
class ChosenFrame:
    """A moment to picture, and what it was chosen for."""

    stamp_ns: int
    why: str


def rule(parts: int, horizon_s: float) -> str:
    """How `choose_frames` chooses, in words."""
    each = f"each of {parts} equal parts of the stretch gives" if parts > 1 else "the stretch gives"
    return (
        f"Chosen by rule, the same for every tracker, out of the moments kept for viewing: {each} the one with the most"
        f" occupied moving cells {horizon_s:.3g} s later; one more is where the trackers' moving F1 at that horizon"
        " differ most (the floor aside)."
    )


def choose_frames(
    scored: Mapping[str, Mapping[int, FrameScore]], trackers: Sequence[str], parts: int
) -> tuple[ChosenFrame, ...]:
    """At most `parts` + 1 moments in the order of time, out of those that every one of the trials in `scored` has.

    `scored` holds one tracker's moments by stamp; `trackers` names those whose disagreement counts.
    """
    stamps = sorted(set.intersection(*(set(moments) for moments in scored.values()))) if scored else []
    if not stamps:
        return ()
    occupied = {stamp: moments[stamp].occupied for moments in scored.values() for stamp in stamps}
    chosen: dict[int, str] = {}
    width = (stamps[-1] - stamps[0]) // parts + 1
    for part in range(parts):
        inside = [s for s in stamps if part == (s - stamps[0]) // width]
        if inside:
            busiest = max(inside, key=lambda s: (occupied[s], -s))
            chosen[busiest] = f"busiest of part {part + 1}: {occupied[busiest]} occupied moving cells came"
    rest = [s for s in stamps if s not in chosen]
    if rest and len(trackers) > 1:
        spread = {s: _spread([scored[name][s].f1 for name in trackers]) for s in rest}
        apart = max(rest, key=lambda s: (spread[s], -s))
        if spread[apart] >= 0.01:
            chosen[apart] = f"where trackers differ most: moving F1 {spread[apart]:.2f} apart"
    return tuple(ChosenFrame(stamp, chosen[stamp]) for stamp in sorted(chosen))


def _spread(values: Sequence[float]) -> float:
    return max(values) - min(values)


def frame_scores(path: Path, step: int) -> dict[int, FrameScore]:
    """The moving cells of every scored frame at `step`, by stamp, from a trial's scores.parquet. Raises ReportError."""
    try:
        rows = (
            pl.scan_parquet(path)
            .select(COLUMNS)
            .filter((pl.col("step") == step) & (pl.col("stratum") == "moving"))
            .select("stamp_ns", "tp", "fp", "fn")
            .collect()
        )
    except (OSError, pl.exceptions.PolarsError) as error:
        raise ReportError(f"{path}: cannot be read as scores ({str(error).splitlines()[0]}); run it again") from None
    return {stamp: FrameScore(tp, fp, fn) for stamp, tp, fp, fn in rows.iter_rows()}

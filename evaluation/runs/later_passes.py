"""Later passes over a recording (`--degrade`, `--deadline`) with higher scores than the first one.

A tracker that keeps a file sees the recording again in a later pass: the file can be its memory. With worse input, or
less time, a score has no honest reason to rise by more than chance.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from gridtrack.evaluation.runs.finished import HEADLINE_STRATA
from gridtrack.evaluation.runs.result_files import Curves
from gridtrack.evaluation.runs.summary import TrackerSummary, TrialSummary

BEYOND = 0.1
"""Without an interval, a rise of F1 above this is more than chance."""


def remembered(trackers: Mapping[str, TrackerSummary]) -> Iterator[str]:
    """A notice for each trial with a higher F1 in a later pass, at some step: above the interval of the first pass, or
    by more than BEYOND without an interval. The notice states the largest rise."""
    for label, row in trackers.items():
        for name, trial in row.recordings.items():
            rises = [rise for words, f1 in _later(trial) for rise in _rises(trial, words, f1)]
            if rises:
                _, first, later, words = max(rises)
                yield (
                    f"{label} on {name}: F1 is {first:.3f} in the first pass and {later:.3f} in a later one ({words}),"
                    " which is more than chance: the tracker may remember the recording; --sandbox prevents it"
                )


def _later(trial: TrialSummary) -> Iterator[tuple[str, Curves]]:
    """The later passes of a trial: condition in words, and F1 (S + 1) by stratum."""
    for kind, points in trial.robustness.kinds.items() if trial.robustness else ():
        for point in points:
            if point.strength:
                yield f"{kind} {point.value:g}", point.f1
    for at in trial.deadline.rates if trial.deadline else ():
        yield f"deadlines at {at.rate:g} times the rate", at.f1


def _rises(trial: TrialSummary, condition: str, later: Curves) -> Iterator[tuple[float, float, float, str]]:
    """The rises of F1 beyond chance at each step: the rise, F1 of both passes, and the place in words."""
    for stratum in HEADLINE_STRATA:
        scores = trial.strata.get(stratum, {}).get("f1", {})
        for step, now in enumerate(later.get(stratum, ()) if scores else ()):
            first = scores["f1"].at(step)
            if first.value is None or now is None:
                continue
            if now > (first.interval[1] if first.interval else first.value + BEYOND):
                yield now - first.value, first.value, now, f"{condition}, {stratum} cells, step {step}"

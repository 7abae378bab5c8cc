"""Signs that a tracker remembers a recording from an earlier pass over it, in a file that it kept.

A later pass (`--degrade`, `--deadline`) has worse input or less time, so its score has no honest reason to rise by more
than chance. Rows that are the same tracker have no honest reason to differ. A trial that did not end has shown frames.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Iterator, Mapping

from gridtrack.common.notices import Notice
from gridtrack.evaluation.runs.finished import HEADLINE_STRATA
from gridtrack.evaluation.runs.result_files import Curves
from gridtrack.evaluation.runs.summary import PairFamily, TrackerSummary, TrialSummary
from gridtrack.evaluation.scores.f1 import F1

BEYOND = 0.1
"""Without an interval, a rise of F1 above this is more than chance."""


def with_memories(
    trackers: Mapping[str, TrackerSummary], families: Iterable[PairFamily], may_remember: Collection[str]
) -> tuple[dict[str, TrackerSummary], list[Notice]]:
    """The rows with the sign in `memory` of each scope that has one, and a notice of each.

    `may_remember`: labels of the rows with a tracker that could read a file that it kept; the others have no sign.
    """
    found = (*_of_trials(trackers), *_of_rows(trackers, families))
    signs = {(label, name): sign for label, name, sign in found if label in may_remember}
    rows = dict(trackers)
    for (label, name), sign in signs.items():
        row, marked = rows[label], {"memory": sign}
        recordings = {one: own.model_copy(update=marked) if one == name else own for one, own in row.recordings.items()}
        pooled = row.pooled and row.pooled.model_copy(update=marked)
        rows[label] = row.model_copy(update={"recordings": recordings, "pooled": pooled})
    notices = [
        Notice(
            text=f"{sign}: the tracker may remember the recording; --sandbox prevents it",
            row=label,
            recording=name,
            kind="may remember the recording; --sandbox prevents it",
        )
        for (label, name), sign in signs.items()
    ]
    return rows, notices


def _of_trials(trackers: Mapping[str, TrackerSummary]) -> Iterator[tuple[str, str, str]]:
    """Label, recording and sign of each trial with an earlier start, or with a higher F1 in a later pass, at some step:
    above the interval of the first pass, or by more than BEYOND without one. Of several rises the largest counts."""
    for label, row in trackers.items():
        for name, trial in row.recordings.items():
            if trial.memory:
                yield label, name, trial.memory
            if rises := [rise for condition, f1 in _later(trial) for rise in _rises(trial, condition, f1)]:
                _, first, later, place = max(rises)
                numbers = f"F1 is {first:.3f} in the first pass and {later:.3f} in a later one"
                yield label, name, f"{numbers} ({place}), which is more than chance"


def _later(trial: TrialSummary) -> Iterator[tuple[str, Curves]]:
    """The later passes of a trial: condition in words, and F1 (S + 1) by stratum."""
    for kind, points in trial.robustness.kinds.items() if trial.robustness else ():
        for point in points:
            if point.strength:
                yield f"{kind} {point.value:g}", point.scores.get(F1.name, {})
    for at in trial.deadline.rates if trial.deadline else ():
        yield f"deadlines at {at.rate:g} times the rate", at.scores.get(F1.name, {})


def _rises(trial: TrialSummary, condition: str, later: Curves) -> Iterator[tuple[float, float, float, str]]:
    """The rises of F1 beyond chance at each step: the rise, F1 of both passes, and the place in words."""
    for stratum in HEADLINE_STRATA:
        for step, now in enumerate(later.get(stratum, ())):
            first = trial.at(stratum, F1.name, F1.lead.name, step)
            if first.value is None or now is None:
                continue
            if now > (first.interval[1] if first.interval else first.value + BEYOND):
                yield now - first.value, first.value, now, f"{condition}, {stratum} cells, step {step}"


def _of_rows(trackers: Mapping[str, TrackerSummary], families: Iterable[PairFamily]) -> Iterator[tuple[str, str, str]]:
    """Label, recordings and sign of the better of two rows of the same tracker, if a paired test separates them."""
    for family in families:
        for pair in family.pairs:
            alike = _identity(trackers[pair.tracker]) == _identity(trackers[pair.other])
            if alike and pair.verdict in {"better", "worse"}:
                better, worse = (pair.tracker, pair.other) if pair.verdict == "better" else (pair.other, pair.tracker)
                by = f"better by {abs(pair.difference.value or 0.0):.3f}"
                place = f"{family.score}, {family.stratum} cells, {family.horizon_s:g} s ahead"
                sign = f"it is the same tracker as {worse}, and {by} ({place}), which is more than chance"
                yield better, family.recordings, sign


def _identity(row: TrackerSummary) -> str:
    """Equal for rows of one tracker with the same options and weights on every recording."""
    weights = {name: trial.weights_sha256 for name, trial in row.recordings.items()}
    return json.dumps([row.tracker, dict(row.options), row.points, weights], sort_keys=True, default=str)

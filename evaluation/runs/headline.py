"""The headline score of a run: the first score for which the recordings have enough events."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.notices import Notice
from gridtrack.evaluation.runs.finished import DETAIL_HORIZON_S, FinishedTrial, RunTrials, detail_step
from gridtrack.evaluation.scores.definition import RareEvents, ScoreDefinition
from gridtrack.evaluation.statistics.jackknife import LEAST_UNITS

ENOUGH_FORECASTS = 50
"""So many forecasts with an event, each a horizon after the last, are enough without LEAST_UNITS units with one."""


def leading_scores(run: RunTrials, scores: Sequence[ScoreDefinition]) -> tuple[list[ScoreDefinition], list[Notice]]:
    """The scores that may lead the run, the headline score first, and a notice of each that has too few events.

    In a run without intervals scores with
    a threshold come last, because few frames determine a threshold poorly. Raises ScoresError.
    """
    counted = {name for trial in run.all if trial.complete for name in run.sums(trial).scores}
    may_lead, too_few = [], []
    for score in (one for one in scores if one.may_lead):
        applies = score.name in counted if counted else score.events is None  # where nothing is scored, none has events
        if not applies:
            continue
        missing = _too_few(run, score, score.events) if score.events else None
        too_few += [missing] if missing else []
        may_lead += [] if missing else [score]
    tested = any(_number(run, names) >= LEAST_UNITS for names in run.groups)
    return sorted(may_lead, key=lambda score: score.thresholded and not tested), too_few


def _too_few(run: RunTrials, score: ScoreDefinition, events: RareEvents) -> Notice | None:
    """A notice of the first group of recordings that has too few events; None if all have enough."""
    for names in run.groups:
        found = [_events_of(run, trial, score, events) for trial in _scored_in_full(run, names)]
        forecasts = sum(_apart(stamps_ns[has_event], DETAIL_HORIZON_S) for stamps_ns, has_event in found)
        units = _number(run, names, [has_event for _, has_event in found])
        if units < LEAST_UNITS and forecasts < ENOUGH_FORECASTS:
            text = (
                f"too few {events.name}: {forecasts} separate forecasts and {units} units have any, and"
                f" {ENOUGH_FORECASTS} forecasts or {LEAST_UNITS} units are needed for {score.title} to lead"
            )
            return Notice(text=text, recording=names[0] if len(run.groups) > 1 else "")
    return None


def _scored_in_full(run: RunTrials, names: Sequence[str]) -> list[FinishedTrial]:
    """A trial of each of these recordings that has one with all scores: events and units are the same for all rows."""
    complete = [[trial for trial in run.on(name) if trial.complete] for name in names]
    return [trials[0] for trials in complete if trials]


def _number(run: RunTrials, names: Sequence[str], chosen: Sequence[NDArray[np.bool_]] | None = None) -> int:
    """The number of units of these recordings that have `chosen` frames (None: any)."""
    trials = _scored_in_full(run, names)
    frames = [run.frames(trial).stamps_ns for trial in trials]
    units = run.unit_rule([trial.record.recording for trial in trials], names).units_of(frames)
    kept = [np.ones(len(own), np.bool_) for own in units] if chosen is None else chosen
    return len({unit for own, of_frame in zip(units, kept, strict=True) for unit in own[of_frame].tolist()})


def _events_of(
    run: RunTrials, trial: FinishedTrial, score: ScoreDefinition, events: RareEvents
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """The stamps (F,) of the scored frames of a trial, and whether each has an event at the detail horizon."""
    sums = run.sums(trial)
    stamps_ns = sums.frames.stamps_ns
    if score.name not in sums.scores:
        return stamps_ns, np.zeros(len(stamps_ns), np.bool_)
    step = detail_step(run.recordings[trial.record.recording].horizons_s)
    found = sums.by_frame(score.name, [step], [score.stratum], sums.layouts[score.name].parts)
    return stamps_ns, events.count(found)[:, 0, 0] > 0


def _apart(stamps_ns: NDArray[np.int64], least_s: float) -> int:
    """How many of these stamps, which increase, can be chosen at least `least_s` apart."""
    number, next_ns = 0, -np.inf
    for stamp_ns in stamps_ns.tolist():
        if stamp_ns >= next_ns:
            number, next_ns = number + 1, stamp_ns + least_s * 1e9
    return number

"""The headline score of a run: the first score for which the recordings have enough events."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.notices import Notice
from gridtrack.evaluation.runs.estimates import Selected, selected
from gridtrack.evaluation.runs.finished import DETAIL_HORIZON_S, FinishedTrial, RunTrials, detail_step
from gridtrack.evaluation.scores.definition import RareEvents, ScoreDefinition
from gridtrack.evaluation.statistics.jackknife import LEAST_UNITS

ENOUGH_FORECASTS = 50
"""So many forecasts with an event, each a horizon after the last, are enough without LEAST_UNITS units with one."""


def leading_scores(run: RunTrials, scores: Sequence[ScoreDefinition]) -> tuple[list[ScoreDefinition], list[Notice]]:
    """The scores that may lead the run, the headline score first, and a notice of each that has too few events.

    In a run without intervals scores with a threshold come last, because few frames determine a threshold poorly.
    Raises ScoresError.
    """
    counted = {name for trial in run.all if trial.complete for name in run.sums(trial).scores}
    groups = {names[0]: _one_trial_each(run, names) for names in run.groups}
    may_lead, too_few = [], []
    for score in (one for one in scores if one.may_lead):
        applies = score.name in counted if counted else score.events is None  # where nothing is scored, none has events
        if not applies:
            continue
        missing = _too_few(run, groups, score, score.events) if score.events else None
        too_few += [missing] if missing else []
        may_lead += [] if missing else [score]
    tested = any(chosen.number >= LEAST_UNITS for chosen in groups.values())
    return sorted(may_lead, key=lambda score: score.thresholded and not tested), too_few


def _one_trial_each(run: RunTrials, names: Sequence[str]) -> Selected:
    """A complete trial on each of these recordings that has one: events and units are the same for all rows.

    Raises ScoresError.
    """
    complete = [[trial for trial in run.on(name) if trial.complete] for name in names]
    trials = [found[0] for found in complete if found]
    return selected(run, trials, run.unit_rule([trial.record.recording for trial in trials], names))


def _too_few(
    run: RunTrials, groups: Mapping[str, Selected], score: ScoreDefinition, events: RareEvents
) -> Notice | None:
    """A notice of the first group of recordings that has too few events, by its first one; None if all have enough."""
    for name, chosen in groups.items():
        found = [_events_of(run, trial, score, events) for trial in chosen.trials]
        forecasts = sum(_apart(stamps_ns[has_event], DETAIL_HORIZON_S) for stamps_ns, has_event in found)
        with_event = (own[has_event] for own, (_, has_event) in zip(chosen.units, found, strict=True))
        units = len({unit for own in with_event for unit in own.tolist()})
        if units < LEAST_UNITS and forecasts < ENOUGH_FORECASTS:
            text = (
                f"too few {events.name}: {forecasts} separate forecasts and {units} units have any, and"
                f" {ENOUGH_FORECASTS} forecasts or {LEAST_UNITS} units are needed for {score.title} to lead"
            )
            return Notice(text=text, recording=name if len(groups) > 1 else "")
    return None


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

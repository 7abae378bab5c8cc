"""A trial's test stretch scored again under another condition, at the thresholds of the trial."""

from __future__ import annotations

from collections.abc import Iterable

from gridtrack.evaluation.referee.referee import Moment, TrackerLike, scored_forecasts
from gridtrack.evaluation.runs.plan import Trial
from gridtrack.evaluation.runs.result_files import Curves, rounded_curve
from gridtrack.evaluation.runs.scorekeeper import Counter, facts_of
from gridtrack.evaluation.runs.trial_record import ThresholdsUsed
from gridtrack.evaluation.scores.definition import Floats
from gridtrack.evaluation.scores.registry import scores


def replayed(
    tracker: TrackerLike, frames: Iterable[Moment], trial: Trial, thresholds: ThresholdsUsed
) -> dict[str, Curves]:
    """The leading values of the scores that may lead, by score and stratum, of `tracker` on the trial's `frames`.

    Forecasts are made at the frames that the trial scored.
    """
    leading = [score for score in scores(trial.scores) if score.may_lead]
    facts = facts_of(trial.split, thresholds.thresholds(), trial.robot)
    counter, sums = Counter(leading, facts), dict[str, Floats]()
    for scored in scored_forecasts(tracker, frames, trial.split.schedule, trial.seed):
        for name, own in counter.count(scored).items():
            sums[name] = sums[name] + own if name in sums else own
    found = {}
    for score in leading:
        if score.name in sums:
            values = score.leading(sums[score.name], facts)
            found[score.name] = {name: rounded_curve(values[:, k]) for k, name in enumerate(score.strata(facts))}
    return found

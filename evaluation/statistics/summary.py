"""The summary of a run, computed from the records and the counts of its trials."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from gridtrack.evaluation.results.recording import RecordingDescription, RecordingSummary
from gridtrack.evaluation.results.summary import RunSummary, TrackerSummary
from gridtrack.evaluation.results.trial_summary import PooledSummary, TrialSummary
from gridtrack.evaluation.scoring.class_scores import unknown_classes
from gridtrack.evaluation.scoring.robustness import mismatched_degradations, with_undegraded
from gridtrack.evaluation.statistics.ceiling import incomplete_floors, with_ceiling
from gridtrack.evaluation.statistics.class_statistics import ClassStatistics
from gridtrack.evaluation.statistics.finished_trial import FinishedTrial, trials_on
from gridtrack.evaluation.statistics.occluded_statistics import OccludedStatistics
from gridtrack.evaluation.statistics.pair_statistics import PairStatistics
from gridtrack.evaluation.statistics.pooled_horizons import unlike_recordings
from gridtrack.evaluation.statistics.run_statistics import RunStatistics
from gridtrack.evaluation.statistics.training_statistics import TrainingStatistics
from gridtrack.evaluation.statistics.turned_rankings import turned_rankings
from gridtrack.trackers.contract import Role


def summarise(
    recordings: Mapping[str, RecordingDescription],
    trials: Iterable[FinishedTrial],
    notices: Sequence[str],
    interrupted: bool,
    reference: str | None = None,
) -> RunSummary:
    """The summary of `trials` on `recordings`; `notices` precede those of the trials.

    `reference` is the label of the row that the others are compared with; None: the default one. Raises ScoresError.
    """
    trials = list(trials)
    statistics = RunStatistics(recordings, trials, reference)
    classes = ClassStatistics(recordings, statistics)
    found = _notices(recordings, trials, statistics.mismatched)
    if not statistics.pools and len(recordings) > 1:
        found.append("the recordings have no horizons in common: no scores are pooled over them")
    found += unlike_recordings(recordings) if statistics.pools else []
    rows = _rows(trials, statistics, classes)
    found += incomplete_floors(rows)
    trackers = with_ceiling(rows)
    found += turned_rankings(recordings, trackers, statistics.horizons_s if statistics.pools else ())
    return RunSummary(
        interrupted=interrupted,
        notices=(*notices, *found),
        pooled_horizons_s=statistics.horizons_s if statistics.pools else (),
        recordings={
            name: RecordingSummary.model_validate({**dict(described), "parity": not statistics.mismatched[name]})
            for name, described in recordings.items()
        },
        trackers=trackers,
        reference=statistics.reference,
        differences=tuple(statistics.differences()),
        class_differences=tuple(classes.differences()),
        occluded_differences=tuple(OccludedStatistics(statistics).differences()),
        pairs=tuple(PairStatistics(statistics).families()),
        trainings=tuple(TrainingStatistics(statistics).found()),
    )


def _rows(
    trials: Sequence[FinishedTrial], statistics: RunStatistics, classes: ClassStatistics
) -> dict[str, TrackerSummary]:
    """The rows by label, with the scores of each trial and those pooled, without the shares of the oracle."""
    rows = {}
    for label in dict.fromkeys(trial.record.label for trial in trials):
        own = [trial for trial in trials if trial.record.label == label]
        rows[label] = TrackerSummary(
            tracker=own[0].tracker,
            role=_role(own),
            options=dict(own[0].options),
            points=own[0].points,
            recordings={trial.record.recording: _trial_summary(trial, statistics, classes) for trial in own},
            pooled=_pooled_summary(own, statistics, classes) if statistics.pools else None,
        )
        statistics.comparisons(label)  # now, while the histograms of the row are kept
    return rows


def _role(trials: Sequence[FinishedTrial]) -> Role:
    """The role in the description of the tracker; a trial that did not start has no description."""
    return next((trial.record.role for trial in trials if trial.record.role != "tracker"), "tracker")


def _trial_summary(trial: FinishedTrial, statistics: RunStatistics, classes: ClassStatistics) -> TrialSummary:
    record = trial.record
    strata = statistics.strata_of(trial)
    by_class = classes.scores([trial], [record.recording])
    return TrialSummary(
        outcome=record.outcome,
        reason=record.reason,
        card=record.card,
        leak=record.leak,
        frames_scored=record.frames_scored,
        frames_expected=record.frames_expected,
        threshold_chosen_on=record.thresholds.chosen_on,
        strata=strata,
        recall_by_class=by_class.recall_by_class,
        semantics=by_class.semantics,
        weights_sha256=record.weights_sha256,
        recoveries=record.recoveries,
        latency_ms=record.latency_ms,
        deadline=record.deadline,
        robustness=with_undegraded(record.robustness, strata) if record.robustness else None,
        times=record.times,
        peak_rss_mb=record.peak_rss_mb,
    )


def _pooled_summary(
    trials: Sequence[FinishedTrial], statistics: RunStatistics, classes: ClassStatistics
) -> PooledSummary:
    pooled = statistics.pooled(trials[0].record.label)
    complete = statistics.together(trial for trial in trials if trial.complete)
    by_class = classes.scores(complete, list(statistics.recordings))
    leak = next((trial.record.leak for trial in trials if trial.record.leak), "")
    card = ", ".join(sorted({trial.record.card for trial in trials} - {""}))
    return pooled.model_copy(
        update={
            "recall_by_class": by_class.recall_by_class,
            "semantics": by_class.semantics,
            "card": card,
            "leak": leak,
        }
    )


def _notices(
    recordings: Mapping[str, RecordingDescription],
    trials: Sequence[FinishedTrial],
    mismatched: Mapping[str, Sequence[str]],
) -> list[str]:
    """What to know before a comparison; `mismatched` are the labels that received other frames, by recording."""
    found: list[str] = []
    for name, description in recordings.items():
        of_recording = trials_on(name, trials)
        found += filter(None, (unknown_classes(trial.record, description) for trial in of_recording))
        found += [
            f"{label} on {name} was delivered other degraded frames than the rest: its robustness is not comparable"
            for label in mismatched_degradations((trial.points, trial.record) for trial in of_recording)
        ]
        found += [
            f"{label} on {name} was delivered other frames than the rest: its scores are not comparable"
            for label in mismatched[name]
        ]
    found += [
        f"{trial.record.label} on {trial.record.recording} continued after {trial.record.recoveries}"
        f" failure{'s' * (trial.record.recoveries > 1)} inside it, which it counted itself"
        for trial in trials
        if trial.record.recoveries
    ]
    found += [
        f"{trial.record.label} on {trial.record.recording} reports far shorter times than the round trips of its calls:"
        " the round trips count"
        for trial in trials
        if "host" in {measured.clock for measured in (trial.record.latency_ms, trial.record.deadline) if measured}
    ]
    return found

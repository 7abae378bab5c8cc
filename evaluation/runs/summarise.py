"""The summary of a run, computed from the records and the sums of its trials."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Any, TypeVar

import numpy as np

from gridtrack.common.notices import Notice
from gridtrack.evaluation.hosting.timing import CLOCK_FACTOR, TRANSPORT_MS
from gridtrack.evaluation.referee.splits import ORACLE
from gridtrack.evaluation.runs.comparisons import Comparisons
from gridtrack.evaluation.runs.estimates import (
    estimated,
    estimates_of,
    selected,
    thresholds_of_scope,
)
from gridtrack.evaluation.runs.finished import (
    HEADLINE_STRATA,
    FinishedTrial,
    RunTrials,
    detail_step,
    headline_steps,
    unlike_most,
    unlike_recordings,
)
from gridtrack.evaluation.runs.headline import leading_scores
from gridtrack.evaluation.runs.later_passes import with_memories
from gridtrack.evaluation.runs.passes import AtStrength, Robustness
from gridtrack.evaluation.runs.result_files import rounded_curve
from gridtrack.evaluation.runs.run_record import RecordingDescription, RecordingSummary
from gridtrack.evaluation.runs.summary import (
    ALL_RECORDINGS,
    Estimate,
    Estimates,
    PooledSummary,
    RunSummary,
    ScopeSummary,
    ScoreDescription,
    TrackerSummary,
    TrialSummary,
)
from gridtrack.evaluation.runs.trial_record import TrialRecord
from gridtrack.evaluation.scores.definition import CurvesByStratum, Floats, Output, ScoreDefinition
from gridtrack.evaluation.scores.f1 import F1
from gridtrack.evaluation.scores.registry import built_in, find_output
from gridtrack.evaluation.statistics.jackknife import LEAST_UNITS
from gridtrack.evaluation.statistics.units import UnitRule
from gridtrack.trackers.contract import Role

STARTED_BEFORE = "the tracker was started before, in a trial that did not end"
AS_IN_RECORD = TrialSummary.model_fields.keys() & (TrialRecord.model_fields.keys() - {"thresholds", "robustness"})
"""The fields that the summary of a trial copies from its record."""
LEAST_LEAD = 0.001
"""A row is ahead of another by at least this much in either order: less is not shown in a table."""


def summarise(
    recordings: Mapping[str, RecordingDescription],
    trials: Iterable[FinishedTrial],
    notices: Sequence[Notice],
    interrupted: bool,
    reference: str | None = None,
    scores: Sequence[ScoreDefinition] | None = None,
    headline: str = "",
) -> RunSummary:
    """The summary of `trials` on `recordings`; `notices` precede the trials' own.

    `reference` is the label of the row that the others are compared with; None: the default one. `scores`: None are the
    built-in ones. `headline`: the score that leads; empty: the first one with enough events. Raises ScoresError.
    """
    run = RunTrials(recordings, list(trials), reference)
    return _Summary(run, scores or built_in(), headline).made(notices, interrupted)


_Scope = TypeVar("_Scope", bound=ScopeSummary)


class _Summary:
    """Makes the summary of a run."""

    def __init__(self, run: RunTrials, scores: Sequence[ScoreDefinition], headline: str) -> None:
        self._run, self._scores = run, scores
        self._may_lead, self._too_few = leading_scores(run, scores)
        self._headline = find_output(headline or self._may_lead[0].name, scores)
        self._comparisons = Comparisons(run, scores, self._headline)

    def made(self, notices: Sequence[Notice], interrupted: bool) -> RunSummary:
        run, comparisons = self._run, self._comparisons
        rows = {label: self._row(label) for label in run.labels}
        found = [*self._too_few, *_notices(run), *_incomplete_floors(rows)]
        if not run.pools and len(run.recordings) > 1:
            found.append(Notice(text="the recordings have no horizons in common: no scores are pooled over them"))
        found += unlike_recordings(run.recordings) if run.pools else []
        horizons_s = {name: run.horizons_of([name]) for name in run.recordings} | {ALL_RECORDINGS: run.horizons_s}
        trackers = related(rows, self._scores, self._headline, horizons_s)
        found += _reversed_rankings(run, trackers, self._may_lead)
        families = comparisons.families()
        may_remember = {trial.record.label for trial in run.all if trial.record.may_remember}
        trackers, memories = with_memories(trackers, families, may_remember)
        found += memories
        score, output = self._headline
        shown = {
            score for row in trackers.values() for scope in _scopes(row) for es in scope.strata.values() for score in es
        }
        return RunSummary(
            interrupted=interrupted,
            notices=(*notices, *found),
            scores=tuple(ScoreDescription.of(one) for one in self._scores if one.name in shown),
            headline=f"{score.name}.{output.name}",
            pooled_horizons_s=run.horizons_s if run.pools else (),
            recordings={
                name: RecordingSummary.model_validate({**dict(described), "parity": not run.mismatched[name]})
                for name, described in run.recordings.items()
            },
            trackers=trackers,
            reference=run.reference_for("occupancy"),
            differences=tuple(comparisons.differences()),
            pairs=tuple(families),
            false_differences=comparisons.false_differences(),
            trainings=tuple(comparisons.trainings()),
        )

    def _row(self, label: str) -> TrackerSummary:
        """A row with the scores of each trial and those pooled, without values relative to other rows."""
        own = self._run.of(label, list(self._run.recordings))
        self._run.forget_rows()  # of the row before: the pooled scores need this one's again
        return TrackerSummary(
            tracker=own[0].tracker,
            role=_role(own),
            options=dict(own[0].options),
            points=own[0].points,
            recordings={trial.record.recording: self._trial(trial) for trial in own},
            pooled=self._pooled(label, own) if self._run.pools else None,
        )

    def _trial(self, trial: FinishedTrial) -> TrialSummary:
        record = trial.record
        summary = TrialSummary(
            **{name: getattr(record, name) for name in AS_IN_RECORD},
            memory=STARTED_BEFORE if record.started_before else "",
            threshold_chosen_on=record.thresholds.chosen_on,
        )
        if record.frames_scored:
            summary = self._scored(summary, [trial], self._run.unit_rule([record.recording]))
        degraded = record.robustness and self._with_undegraded(record.robustness, summary)
        return summary.model_copy(update={"robustness": degraded})

    def _with_undegraded(self, robustness: Robustness, trial: TrialSummary) -> Robustness:
        """The scores under each kind by its strength; at strength 0 they are those of `trial`."""
        own = trial.leading({score.name: score.lead.name for score in self._scores if score.may_lead})
        undegraded = AtStrength(strength=0.0, value=0.0, delivered="", scores=own)
        kinds = {kind: (undegraded, *points) for kind, points in robustness.kinds.items()}
        return Robustness(degradation=robustness.degradation, kinds=kinds)

    def _pooled(self, label: str, trials: Sequence[FinishedTrial]) -> PooledSummary:
        """One tracker over all recordings that it completed, together.

        In the units of all recordings, also where the one with the longest blocks is not among them.
        """
        names = list(self._run.recordings)
        complete = self._run.together(trial for trial in trials if trial.complete)
        chosen = {trial.record.thresholds.chosen_on for trial in complete}
        whole = len(complete) == len(names)
        summary = PooledSummary(
            outcome="ok" if whole else "partial",
            reason="" if whole else _why_partial(trials, len(names)),
            recordings_complete=len(complete),
            recordings_expected=len(names),
            frames_scored=sum(trial.record.frames_scored for trial in complete),
            frames_expected=sum(trial.record.frames_expected for trial in trials),
            frames_missing=sum(trial.record.frames_missing for trial in complete),
            made_by=next((trial.record.made_by for trial in trials if trial.record.made_by), ""),
            threshold_chosen_on=chosen.pop() if len(chosen) == 1 else "",
            card=", ".join(sorted({trial.record.card for trial in trials} - {""})),
            leak=next((trial.record.leak for trial in trials if trial.record.leak), ""),
        )
        if not complete:
            return summary
        return self._scored(summary, complete, self._run.unit_rule([t.record.recording for t in complete], names))

    def _scored(self, summary: _Scope, trials: Sequence[FinishedTrial], rule: UnitRule) -> _Scope:
        """`summary` with the scores of `trials` together."""
        chosen = selected(self._run, trials, rule)
        found = {score.name: one for score in self._scores if (one := estimated(self._run, chosen, score)) is not None}
        if len(trials) == len(self._run.groups[0]):  # the comparisons of the row need them
            self._comparisons.keep(chosen, found)
        why = rule.too_short(chosen.number) if chosen.number < LEAST_UNITS else ""
        strata = estimates_of(found, self._scores)
        return summary.model_copy(update={"strata": strata, "thresholds": thresholds_of_scope(trials), "interval": why})


def _role(trials: Sequence[FinishedTrial]) -> Role:
    """The role in the description of the tracker; a trial that did not start has no description."""
    return next((trial.record.role for trial in trials if trial.record.role != "tracker"), "tracker")


def _why_partial(trials: Sequence[FinishedTrial], recordings: int) -> str:
    missing = [f"{trial.record.recording}: {trial.record.outcome}" for trial in trials if not trial.complete]
    complete = f"{len(trials) - len(missing)} of {recordings} recordings complete"
    shown = "; ".join(missing[:3]) + (", ..." if len(missing) > 3 else "")
    return f"{complete} ({shown})" if missing else complete


def _scopes(row: TrackerSummary) -> Iterator[ScopeSummary]:
    yield from row.recordings.values()
    if row.pooled is not None:
        yield row.pooled


def related(
    rows: Mapping[str, TrackerSummary],
    scores: Sequence[ScoreDefinition],
    headline: tuple[ScoreDefinition, Output],
    horizons_s: Mapping[str, Sequence[float]],
) -> dict[str, TrackerSummary]:
    """The rows with the outputs of `ScoreDefinition.relate`, the best floor, and whether they are below it.

    `horizons_s`: of the steps on each recording, and of ALL_RECORDINGS.
    """
    found = dict(rows)
    for name in horizons_s:
        pooled = name == ALL_RECORDINGS
        scopes = {label: row.pooled if pooled else row.recordings.get(name) for label, row in rows.items()}
        known = {label: scope for label, scope in scopes.items() if scope is not None}
        for label, update in _relations(rows, known, scores, headline, horizons_s[name]):
            scope = known[label].model_copy(update=update)
            recordings = found[label].recordings
            where = {"pooled": scope} if pooled else {"recordings": {**recordings, name: scope}}
            found[label] = found[label].model_copy(update=where)
    return found


def _relations(
    rows: Mapping[str, TrackerSummary],
    scopes: Mapping[str, ScopeSummary],
    scores: Sequence[ScoreDefinition],
    headline: tuple[ScoreDefinition, Output],
    horizons_s: Sequence[float],
) -> Iterator[tuple[str, dict[str, Any]]]:
    """The fields of each scope that depend on other rows; without one of the floors none is known to be the best."""
    comparable = {label: scope for label, scope in scopes.items() if _may_bound(scope)}
    floors = {label: scope for label, scope in comparable.items() if rows[label].floor}
    complete = bool(floors) and all(label in floors for label in scopes if rows[label].floor)
    better, best, values = headline[1].direction, "", {}
    if complete:
        values = _headline_values(comparable, headline, detail_step(horizons_s))
        best = max((label for label in floors if label in values), key=lambda one: better * values[one], default="")
    lowest = {score.name: _best_of(floors.values(), score) for score in scores} if complete else {}
    for label, scope in scopes.items():
        row = rows[label]
        oracle = None if row.ceiling else scopes.get(ORACLE)
        worse = bool(best) and label in values and better * (values[label] - values[best]) < 0
        yield (
            label,
            {
                "strata": _with_relations(scope, scores, oracle, lowest),
                "best_floor": best,
                "below_floor": worse and not row.floor and not row.ceiling,
            },
        )


def _headline_values(
    scopes: Mapping[str, ScopeSummary], headline: tuple[ScoreDefinition, Output], step: int
) -> dict[str, float]:
    """The headline score at `step` of each scope, in the first headline stratum in which any has one."""
    score, output = headline
    for stratum in (score.stratum, *HEADLINE_STRATA):
        values = {label: scope.at(stratum, score.name, output.name, step).value for label, scope in scopes.items()}
        if known := {label: value for label, value in values.items() if value is not None}:
            return known
    return {}


def _with_relations(
    own: ScopeSummary,
    scores: Sequence[ScoreDefinition],
    oracle: ScopeSummary | None,
    floors: Mapping[str, CurvesByStratum],
) -> dict[str, Estimates]:
    """The strata of a scope with the outputs of `ScoreDefinition.relate`; `floors`: the best floor of each score.

    A row that was scored in part was scored on other frames than the oracle.
    """
    strata = {name: dict(found) for name, found in own.strata.items()}
    for score in scores:
        if score.relate is None:
            continue
        start, bound = (floors.get(score.name), _lead_of(oracle, score)) if own.outcome == "ok" else (None, None)
        for output, by_stratum in score.relate(_curves(own, score), start, bound).items():
            for stratum, values in by_stratum.items():
                added = {output: Estimate(value=rounded_curve(values))}
                strata[stratum][score.name] = strata[stratum][score.name] | added
    return strata


def _best_of(floors: Iterable[ScopeSummary], score: ScoreDefinition) -> CurvesByStratum:
    """The best value (S,) of any floor by stratum, at each step."""
    better = np.fmax if score.lead.direction > 0 else np.fmin
    found: dict[str, Floats] = {}
    for floor in floors:
        for stratum, values in _curves(floor, score).items():
            found[stratum] = better(found[stratum], values) if stratum in found else values
    return found


def _lead_of(scope: ScopeSummary | None, score: ScoreDefinition) -> CurvesByStratum | None:
    """The leading output of a scope that may be the ceiling of others; None if it is none."""
    return _curves(scope, score) if scope is not None and _may_bound(scope) else None


def _may_bound(scope: ScopeSummary) -> bool:
    """Whether a scope may be the floor or the ceiling of others."""
    return scope.outcome == "ok" and not scope.leak


def _curves(scope: ScopeSummary, score: ScoreDefinition) -> CurvesByStratum:
    found = {
        name: scores[score.name][score.lead.name].value for name, scores in scope.strata.items() if score.name in scores
    }
    return {name: np.array([np.nan if one is None else one for one in values]) for name, values in found.items()}


def _incomplete_floors(rows: Mapping[str, TrackerSummary]) -> Iterator[Notice]:
    """A notice of each floor without which no share of the oracle is known, on some of the recordings or on all."""
    for label, row in rows.items() if ORACLE in rows else ():
        missing = sum(trial.outcome != "ok" or bool(trial.leak) for trial in row.recordings.values())
        if row.floor and missing:
            trials = len(row.recordings)
            where = f" on {missing} of {trials} recordings, nor on all together" if trials > 1 else ""
            kind = "a floor that is not complete: no share of the oracle"
            yield Notice(text=f"{kind}{where}", row=label, kind=kind)


def _notices(run: RunTrials) -> Iterator[Notice]:
    """Facts to know before a comparison."""
    for name, description in run.recordings.items():
        trials = run.on(name)
        for trial in trials:
            yield from _unknown_classes(trial.record, description)
        for label in _mismatched_degradations((trial.points, trial.record) for trial in trials):
            text = "was delivered other degraded frames: its robustness is not comparable"
            yield Notice(text=text, row=label, recording=name)
        for label in run.mismatched[name]:
            text = "was delivered other frames than the rest: its scores are not comparable"
            yield Notice(text=text, row=label, recording=name)
    for record in (trial.record for trial in run.all):
        for notice in _of_trial(record):
            yield notice.model_copy(update={"row": record.label, "recording": record.recording})


def _of_trial(record: TrialRecord) -> Iterator[Notice]:
    """The notices about a trial, without its names."""
    if record.recoveries:
        failures = f"{record.recoveries} failure{'s' * (record.recoveries > 1)}"
        yield Notice(
            text=f"continued after {failures} inside it, which it counted itself",
            kind="continued after {} failures inside it, which it counted itself",
            values=(record.recoveries,),
        )
    if "host" in {measured.clock for measured in (record.latency_ms, record.deadline) if measured}:
        yield Notice(text="reports far shorter times than the round trips of its calls: the round trips count")
    yield from _slower_when_scored(record)


def _slower_when_scored(record: TrialRecord) -> Iterator[Notice]:
    """A notice of each kind of call with a median round trip, while the tracker was scored, of more than CLOCK_FACTOR
    times that in a pass that timed it alone, and TRANSPORT_MS more."""
    timed = [one.round_trips for one in (record.latency_ms, record.deadline) if one]
    for call, name in (("an update", "update_ms"), ("a forecast", "predict_ms")):
        scored_ms, alone_ms = getattr(record.round_trips, name), min((getattr(one, name) for one in timed), default=0.0)
        if alone_ms and scored_ms > CLOCK_FACTOR * alone_ms + TRANSPORT_MS:
            why = "the machine was busy with other work, or the tracker is fast only when it is timed"
            yield Notice(
                text=f"{call} took {scored_ms:.0f} ms while it was scored and {alone_ms:.1f} ms when it was timed"
                f" alone: {why}",
                kind=f"slower when scored than when timed alone: {why}",
            )


def _unknown_classes(record: TrialRecord, recording: RecordingDescription) -> Iterator[Notice]:
    """A notice of the recording's classes that the tracker does not have, if there are any."""
    missing = [name for name in recording.classes if name not in record.classes]
    if record.classes and missing:
        counted = "their cells count as misclassified, with probability 0"
        text = f"does not forecast the classes {', '.join(missing)}: {counted}"
        yield Notice(text=text, row=record.label, recording=record.recording)


def _mismatched_degradations(records: Iterable[tuple[str, TrialRecord]]) -> list[str]:
    """Labels of the trials of one recording that received other degraded frames than most, at equal strength.

    Each record comes with the returns that it requested: trials with other returns are compared among themselves.
    """
    return unlike_most(
        (record.label, (points, kind, point.value), point.delivered)
        for points, record in records
        if record.robustness
        for kind, curve in record.robustness.kinds.items()
        for point in curve
    )


@dataclass(frozen=True)
class _Order:
    """A score that orders rows, a higher value first, its stratum, and the words for "by this score"."""

    score: str
    output: str
    stratum: str
    words: str


def _reversed_rankings(
    run: RunTrials, trackers: Mapping[str, TrackerSummary], may_lead: Sequence[ScoreDefinition]
) -> Iterator[Notice]:
    """A notice for each headline stratum in which the ranking by F1 reverses between the chosen thresholds and 0.5, and
    one where the ranking by F1 is not that of the first score without a threshold that may lead.

    Over all recordings at the horizons of their pooled scores, on each if there are none. Ranked rows count, and the
    floors; not the ceiling.
    """
    beside = next((one for one in may_lead if not one.thresholded), None)
    names = [ALL_RECORDINGS] if run.pools else list(run.recordings)
    for name in names:
        horizons_s = run.horizons_s if run.pools else run.recordings[name].horizons_s
        scopes = {
            label: scope
            for label, row in trackers.items()
            if not row.ceiling and (scope := row.pooled if run.pools else row.recordings.get(name)) and scope.ranked
        }
        if beside is not None:
            by_f1, by_other = (_Order(one.name, one.lead.name, one.stratum, f"in {one.title}") for one in (F1, beside))
            about = Notice(text=f"the order of trackers depends on the score, {beside.title} or F1", recording=name)
            yield from _reversal(about, scopes, horizons_s, (by_other, by_f1))
        for stratum in HEADLINE_STRATA:
            chosen = _Order("f1", "f1", stratum, "in F1 at the chosen thresholds")
            half = _Order("f1", "at_half", stratum, "in F1 at a threshold of 0.5")
            about = Notice(text="the order of trackers depends on the threshold", recording=name)
            yield from _reversal(about, scopes, horizons_s, (chosen, half))


def _reversal(
    about: Notice,
    scopes: Mapping[str, ScopeSummary],
    horizons_s: Sequence[float],
    orders: tuple[_Order, _Order],
) -> Iterator[Notice]:
    """The notice `about` it with the largest reversal and the number of the others; none without any."""
    pairs = sorted(_reversed_pairs(scopes, horizons_s, orders), key=lambda pair: -pair[0])
    if pairs:
        pairs_of = "pair of rows and horizon" if len(pairs) == 2 else "pairs of rows and horizons"
        more = f"; {len(pairs) - 1} more such {pairs_of}" if len(pairs) > 1 else ""
        yield about.model_copy(update={"text": f"{about.text}: {pairs[0][1]}{more}", "kind": about.text})


def _reversed_pairs(
    scopes: Mapping[str, ScopeSummary], horizons_s: Sequence[float], orders: tuple[_Order, _Order]
) -> Iterator[tuple[float, str]]:
    """Every pair of rows that reverses: the smaller of its two leads, and the pair in words."""
    one, other = orders
    cells, other_cells = (
        f"on {one.stratum} cells ",
        f" on {other.stratum} cells" if other.stratum != one.stratum else "",
    )
    for horizon_s, step in headline_steps(horizons_s):
        values = {
            label: tuple(scope.at(by.stratum, by.score, by.output, step).value for by in orders)
            for label, scope in scopes.items()
        }
        for ahead, behind in permutations(values, 2):
            (first, second), (its_first, its_second) = values[ahead], values[behind]
            if first is None or second is None or its_first is None or its_second is None:
                continue
            lead = min(first - its_first, its_second - second)
            if lead >= LEAST_LEAD:
                yield (
                    lead,
                    f"{cells}{horizon_s:g} s ahead {ahead} is above {behind} {one.words} ({first:.3f} and"
                    f" {its_first:.3f}) and below it {other.words}{other_cells} ({second:.3f} and {its_second:.3f})",
                )

"""Paired comparisons of the rows of a run: each with the reference, all pairs, and trackers by their trainings."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from itertools import combinations
from typing import NamedTuple

import numpy as np

from gridtrack.evaluation.referee.splits import ORACLE
from gridtrack.evaluation.referee.strata import OCCLUDED
from gridtrack.evaluation.runs.estimates import Estimated, Selected, estimate_of, estimated, selected
from gridtrack.evaluation.runs.finished import HEADLINE_STRATA, FinishedTrial, RunTrials, headline_steps
from gridtrack.evaluation.runs.result_files import rounded, rounded_p
from gridtrack.evaluation.runs.summary import (
    ALL_RECORDINGS,
    Estimates,
    HeadlineTest,
    PairFamily,
    PairTest,
    PointEstimate,
    TrackerDifference,
    TrackerTrainings,
    TrainingsScore,
)
from gridtrack.evaluation.runs.sums import Layout
from gridtrack.evaluation.scores.definition import Floats, Output, ScoreDefinition
from gridtrack.evaluation.statistics.jackknife import (
    LEAST_UNITS,
    IntervalEstimate,
    Replicates,
    difference,
    holm,
    verdict_of,
)
from gridtrack.evaluation.statistics.trainings import LEAST_TRAININGS, Trainings, spread_between, training_differences
from gridtrack.evaluation.statistics.wild_bootstrap import false_difference_rate

TESTED_STRATA = (*HEADLINE_STRATA, OCCLUDED)
"""The strata in which trackers are compared with the reference."""
OTHER_FRAMES = "no frames in common: it was delivered other frames than the reference"
OTHER_RETURNS = (
    "not compared: a row of raw returns and one of the centres of cells receive other frames, so they are not paired"
)
FEW_TRAININGS = f"fewer than {LEAST_TRAININGS} trainings: the spread between them is hardly known"


class Place(NamedTuple):
    """A stratum and step of the headline tests, with the horizon of the step."""

    stratum: str
    horizon_s: float
    step: int


class Comparisons:
    """The comparisons of a run by its `scores`; `headline` is the score and output that decides."""

    def __init__(
        self, run: RunTrials, scores: Sequence[ScoreDefinition], headline: tuple[ScoreDefinition, Output]
    ) -> None:
        self._run, self._headline = run, headline
        self._scores = [score for score in scores if score.tested]
        self._estimated: dict[tuple[object, ...], dict[str, Estimated]] = {}

    def differences(self) -> list[TrackerDifference]:
        """Each tracker against the reference: over all recordings if they are pooled, else on each.

        Class scores have a reference of their own. The tests of the headline score are one family of Holm's correction.
        Raises ScoresError.
        """
        found = [one for names in self._run.groups for one in self._against_reference(names)]
        corrected = _corrected([test for _, test in tests] for _, tests in found)
        return [
            compared.model_copy(update={"tests": tuple(map(self._headline_test, tests, p))})
            for (compared, tests), p in zip(found, corrected, strict=True)
        ]

    def _headline_test(self, test: tuple[Place, IntervalEstimate], p: float) -> HeadlineTest:
        """A test at a place, with its corrected p-value."""
        place, found = test
        return HeadlineTest(
            stratum=place.stratum,
            horizon_s=round(place.horizon_s, 6),
            step=place.step,
            p_holm=rounded_p(p),
            verdict=verdict_of(self._headline[1].direction * float(found.value), p),
        )

    def _against_reference(self, names: list[str]) -> Iterator[_Compared]:
        for part in ("occupancy", "classes"):
            scores = [score for score in self._scores if score.compared_with == part]
            rows = self._rows_with(scores, names)
            reference = self._run.reference_for("occupancy") if part == "occupancy" else self._class_reference(rows)
            if reference is None:
                continue
            labels = self._run.labels if part == "occupancy" else list(rows)
            others = [label for label in labels if label != reference and not self._is_oracle(label)]
            yield from (self._compared(label, reference, names, scores, part == "occupancy") for label in others)

    def _rows_with(self, scores: Sequence[ScoreDefinition], names: list[str]) -> dict[str, list[FinishedTrial]]:
        """The comparable rows that have any of these scores on every recording."""
        wanted = {score.name for score in scores}
        rows = {label: self._run.comparable(label, names) for label in self._run.labels if not self._is_oracle(label)}
        return {
            label: trials
            for label, trials in rows.items()
            if len(trials) == len(names) and all(wanted & set(self._run.sums(trial).scores) for trial in trials)
        }

    def _class_reference(self, rows: Mapping[str, Sequence[FinishedTrial]]) -> str | None:
        return self._run.reference_for("classes", rows) if len(rows) > 1 else None

    def _is_oracle(self, label: str) -> bool:
        return any(trial.tracker == ORACLE for trial in self._run.all if trial.record.label == label)

    def _compared(
        self, label: str, reference: str, names: list[str], scores: Sequence[ScoreDefinition], headline: bool
    ) -> _Compared:
        """`label` against the reference on `names`; both must be comparable on every one of them."""
        compared = TrackerDifference(recordings=_name_of(names), tracker=label, reference=reference)
        own, others = (self._run.comparable(row, names) for row in (label, reference))
        why = self._run.why_not_compared(reference, names) or self._run.why_not_compared(label, names)
        if why or own[0].points != others[0].points:
            interval = f"not compared: {why}" if why else OTHER_RETURNS
            return compared.model_copy(update={"interval": interval}), []
        mine, theirs = self._paired([own, others], names)
        frames = sum(int((units >= 0).sum()) for units in mine.units)
        if not frames:
            return compared.model_copy(update={"interval": OTHER_FRAMES}), []
        found = _differences(self._all(mine), self._all(theirs), scores)
        strata: dict[str, Estimates] = {}
        for (stratum, name, output), one in found.items():
            strata.setdefault(stratum, {}).setdefault(name, {})[output] = estimate_of(one)
        score, lead = self._headline
        places = self._places(names, [*own, *others], score) if headline else ()
        keys = ((place, (place.stratum, score.name, lead.name)) for place in places)
        tests = [(place, found[key].at(place.step)) for place, key in keys if key in found]
        short = self._run.unit_rule(names).too_short(mine.number) if mine.number < LEAST_UNITS else ""
        known = {"units": mine.number, "frames": frames, "interval": short, "strata": strata}
        return compared.model_copy(update=known), tests

    def _paired(self, rows: Sequence[Sequence[FinishedTrial]], names: Sequence[str]) -> list[Selected]:
        """The rows on the frames that all of them have, in the same units."""
        frames = [[self._run.frames(trial) for trial in trials] for trials in rows]
        common = [
            reduce(lambda one, other: one.at(one.common_with(other)), of_recording)
            for of_recording in zip(*frames, strict=True)
        ]
        units = self._run.unit_rule(names).units_of([one.stamps_ns for one in common])
        chosen = []
        for trials, own in zip(rows, frames, strict=True):
            numbers = [np.full(len(one.stamps_ns), -1) for one in own]
            for number, one, shared, unit in zip(numbers, own, common, units, strict=True):
                number[np.searchsorted(one.stamps_ns, shared.stamps_ns)] = unit
            chosen.append(Selected(tuple(trials), tuple(numbers)))
        return chosen

    def keep(self, chosen: Selected, found: Mapping[str, Estimated]) -> None:
        """Keep the tested scores of a row for its comparisons."""
        tested = ((score, found.get(score.name)) for score in self._scores)
        self._estimated[chosen.key] = {score.name: _tested(one, score) for score, one in tested if one is not None}

    def _all(self, chosen: Selected) -> dict[str, Estimated]:
        """The tested scores of a row over the chosen frames. Raises ScoresError."""
        if chosen.key not in self._estimated:
            found = {score.name: estimated(self._run, chosen, score) for score in self._scores}
            self.keep(chosen, {name: one for name, one in found.items() if one is not None})
        return self._estimated[chosen.key]

    def _places(
        self, names: Sequence[str], trials: Sequence[FinishedTrial], score: ScoreDefinition
    ) -> tuple[Place, ...]:
        """Strata and steps of the tests of a score that all `trials` have."""
        layouts = [self._run.sums(trial).layouts.get(score.name, Layout((), (), ())) for trial in trials]
        order = dict.fromkeys((score.stratum, *HEADLINE_STRATA))
        strata = [name for name in order if all(name in one.strata for one in layouts)]
        steps = headline_steps(self._run.horizons_of(names), score.horizons_s)
        return tuple(Place(stratum, horizon_s, step) for stratum in strata for horizon_s, step in steps)

    def families(self) -> list[PairFamily]:
        """All pairs of comparable rows: a family for each tested score, and each stratum and horizon where it leads.

        Rows of raw returns are compared among themselves. Nothing with fewer than LEAST_UNITS units. Raises
        ScoresError.
        """
        return [family for family, _ in self._tested_families]

    def false_differences(self) -> dict[str, float]:
        """How often at least one of the `families` has a difference between equal trackers, by their recordings.

        Raises ScoresError.
        """
        by_recordings: dict[str, list[Mapping[str, Replicates]]] = {}
        for family, rows in self._tested_families:
            by_recordings.setdefault(family.recordings, []).append(rows)
        return {name: round(false_difference_rate(rows), 2) for name, rows in by_recordings.items()}

    @cached_property
    def _tested_families(self) -> list[tuple[PairFamily, Mapping[str, Replicates]]]:
        """The families, with their rows by label."""
        return [family for names in self._run.groups for family in self._families_on(names)]

    def _families_on(self, names: list[str]) -> Iterator[tuple[PairFamily, Mapping[str, Replicates]]]:
        rows = self._rows_with(self._scores, names)
        for points in dict.fromkeys(trials[0].points for trials in rows.values()):
            alike = {label: trials for label, trials in rows.items() if trials[0].points == points}
            if len(alike) > 1:
                yield from self._families_among(alike, names)

    def _families_among(
        self, rows: Mapping[str, list[FinishedTrial]], names: list[str]
    ) -> Iterator[tuple[PairFamily, Mapping[str, Replicates]]]:
        chosen = dict(zip(rows, self._paired(list(rows.values()), names), strict=True))
        number = next(iter(chosen.values())).number
        if number < LEAST_UNITS:
            return
        found = {label: self._all(one) for label, one in chosen.items()}
        trials = [trial for own in rows.values() for trial in own]
        for score in self._scores:
            for place in self._places(names, trials, score):
                replicates = {label: _at(one, score, score.lead, place) for label, one in found.items()}
                known = {label: one for label, one in replicates.items() if one is not None}
                if tested := tuple(_pair_tests(known, score.lead)):
                    family = PairFamily(
                        recordings=_name_of(names),
                        score=score.name,
                        output=score.lead.name,
                        stratum=place.stratum,
                        horizon_s=round(place.horizon_s, 6),
                        step=place.step,
                        units=number,
                        pairs=tested,
                    )
                    yield family, known

    def trainings(self) -> list[TrackerTrainings]:
        """Every tracker with its trainings, if a tracker has several: over all recordings if pooled, else on each.

        Rows of the same tracker, options and points that differ in their weights are trainings of one tracker. Raises
        ScoresError.
        """
        found = [self._trained(one) for names in self._run.groups for one in _training_rows(self._run, names)]
        corrected = _corrected(tests for _, tests in found)
        return [
            trained.model_copy(update={"scores": tuple(map(self._tested_trainings, trained.scores, tests, p))})
            if trained.reference not in trained.labels
            else trained
            for (trained, tests), p in zip(found, corrected, strict=True)
        ]

    def _tested_trainings(self, score: TrainingsScore, test: IntervalEstimate, p: float) -> TrainingsScore:
        """The score of the trainings with the corrected p-value of its difference."""
        verdict = verdict_of(self._headline[1].direction * float(test.value), p)
        return score.model_copy(update={"p_holm": rounded_p(p), "verdict": verdict})

    def _trained(self, rows: _TrainingRows) -> tuple[TrackerTrainings, list[IntervalEstimate]]:
        """The headline score of the trainings, and at each place its uncorrected difference from the reference's."""
        places = self._places(rows.names, [*rows.own[0], *rows.reference[0]], self._headline[0])
        own, why = self._each(rows.own, places, rows.names), rows.why_partial or self._why_unpaired(rows)
        difference = IntervalEstimate.unknown(np.full(len(places), np.nan))
        if not why and rows.own is not rows.reference:
            reference = self._each(rows.reference, places, rows.names)
            difference = training_differences(own, reference)
            if own.each[0].units < LEAST_UNITS:
                why = self._run.unit_rule(rows.names).too_short(own.each[0].units)
            elif not (own.spread_known and reference.spread_known):
                why = FEW_TRAININGS
        values = np.stack([one.value for one in own.each])
        spread = spread_between(own.each).deviation if len(values) > 1 else np.full(len(places), np.nan)
        tests = [difference.at(i) for i in range(len(places))]
        trained = TrackerTrainings(
            recordings=_name_of(rows.names),
            tracker=rows.own[0][0].tracker,
            labels=tuple(trials[0].record.label for trials in rows.own),
            reference=rows.reference[0][0].record.label,
            units=own.each[0].units,
            interval=why,
            scores=tuple(
                TrainingsScore(
                    stratum=place.stratum,
                    horizon_s=round(place.horizon_s, 6),
                    step=place.step,
                    values=tuple(map(rounded, values[:, i].tolist())),
                    mean=rounded(float(values[:, i].mean())),
                    spread=rounded(float(spread[i])),
                    difference=_point_of(tests[i]),
                )
                for i, place in enumerate(places)
            ),
        )
        return trained, tests

    def _each(
        self, rows: Sequence[Sequence[FinishedTrial]], places: Sequence[Place], names: Sequence[str]
    ) -> Trainings:
        score, output = self._headline
        each = []
        for trials in rows:
            chosen = selected(self._run, trials, self._run.unit_rule(names))
            found = self._all(chosen)[score.name]
            each.append(_stacked(found, output.name, places, chosen.number))
        return Trainings(tuple(each), learned=any(_weights(rows[0])))

    def _why_unpaired(self, rows: _TrainingRows) -> str:
        if rows.own[0][0].points != rows.reference[0][0].points:
            return OTHER_RETURNS
        return OTHER_FRAMES if len({self._frames_key(one) for one in (*rows.own, *rows.reference)}) > 1 else ""

    def _frames_key(self, trials: Sequence[FinishedTrial]) -> tuple[bytes, ...]:
        """Equal for two rows that were scored on the same frames."""
        frames = map(self._run.frames, trials)
        return tuple(one.stamps_ns.tobytes() + one.delivered.tobytes() for one in frames)


_Compared = tuple[TrackerDifference, list[tuple[Place, IntervalEstimate]]]
"""A comparison without its tests, and the uncorrected differences () of the headline score that are tested."""


def _name_of(names: Sequence[str]) -> str:
    """The name in the summary of these recordings together."""
    return ALL_RECORDINGS if len(names) > 1 else names[0]


def _corrected(families: Iterable[Iterable[IntervalEstimate]]) -> list[list[float]]:
    """The p-values of tests (), corrected over all of them."""
    p = [[float(test.p) for test in own] for own in families]
    corrected = iter(holm(np.array([one for own in p for one in own])).tolist())
    return [[next(corrected) for _ in own] for own in p]


def _tested(found: Estimated, score: ScoreDefinition) -> Estimated:
    """The tested outputs of a score in the tested strata: a run of many recordings has gigabytes of all."""
    strata = tuple(name for name in TESTED_STRATA if name in found.strata)
    k, names = [found.strata.index(name) for name in strata], [output.name for output in score.tested]
    values = {name: found.values[name][:, k] for name in names}
    replicates = {name: found.replicates[name].at(slice(None), k) for name in names if name in found.replicates}
    return Estimated(strata, values, replicates)


def _differences(
    own: Mapping[str, Estimated], reference: Mapping[str, Estimated], scores: Iterable[ScoreDefinition]
) -> dict[tuple[str, str, str], IntervalEstimate]:
    """The differences (S,) of the tested outputs that both rows have, by stratum, score and output."""
    found: dict[tuple[str, str, str], IntervalEstimate] = {}
    for score in scores:
        if score.name not in own or score.name not in reference:
            continue
        mine, theirs = own[score.name], reference[score.name]
        strata = [name for name in mine.strata if name in theirs.strata]
        for output in score.tested:
            for stratum in strata:
                less = _difference_in(mine, theirs, output.name, stratum)
                found[stratum, score.name, output.name] = less
    return found


def _difference_in(own: Estimated, reference: Estimated, output: str, stratum: str) -> IntervalEstimate:
    """The difference (S,) in one stratum; without intervals if there are too few units."""
    k, n = own.strata.index(stratum), reference.strata.index(stratum)
    if output in own.replicates and output in reference.replicates:
        steps = slice(None)
        return difference(own.replicates[output].at(steps, k), reference.replicates[output].at(steps, n))
    return IntervalEstimate.unknown(own.values[output][:, k] - reference.values[output][:, n])


def _at(found: Mapping[str, Estimated], score: ScoreDefinition, output: Output, place: Place) -> Replicates | None:
    """The replicates of a score at one place; None if the row has none."""
    one = found.get(score.name)
    if one is None or place.stratum not in one.strata or output.name not in one.replicates:
        return None
    return one.replicates[output.name].at(place.step, one.strata.index(place.stratum))


def _stacked(found: Estimated, output: str, places: Sequence[Place], units: int) -> Replicates:
    """The replicates (R,) of an output at the places; with too few units only its values."""
    at = [place.step for place in places], [found.strata.index(place.stratum) for place in places]
    value: Floats = found.values[output][at]
    if output in found.replicates:
        return replace(found.replicates[output].at(*at), value=value)
    nothing = np.full((units, len(places)), np.nan)
    return Replicates(value, nothing, nothing)


def _pair_tests(rows: Mapping[str, Replicates], output: Output) -> Iterator[PairTest]:
    """The test of each pair of rows with a result, corrected over the pairs."""
    pairs = list(combinations(rows, 2))
    found = [difference(rows[one], rows[other]) for one, other in pairs]
    (adjusted,) = _corrected([found])
    for (tracker, other), one, p in zip(pairs, found, adjusted, strict=True):
        if not np.isnan(p):
            yield PairTest(
                tracker=tracker,
                other=other,
                difference=_point_of(one),
                p_holm=rounded_p(p),
                verdict=verdict_of(output.direction * float(one.value), p),
            )


def _point_of(found: IntervalEstimate) -> PointEstimate:
    """An estimate () as the summary holds it."""
    value, low, high = (rounded(float(one)) for one in (found.value, found.low, found.high))
    return PointEstimate(value=value, low=low, high=high, p=rounded_p(float(found.p)))


_Tracker = tuple[str, str, str]
"""Name, options and points, which all trainings of one tracker have in common."""


def _tracker_of(trial: FinishedTrial) -> _Tracker:
    return trial.tracker, json.dumps(dict(trial.options), sort_keys=True, default=str), trial.points


@dataclass(frozen=True, slots=True)
class _TrainingRows:
    """The rows of one tracker and of the reference on the recordings `names`: the trials of each training.

    `why_partial`: one of the two has trainings that did not complete these recordings, and they may be its worse ones.
    """

    names: tuple[str, ...]
    own: Sequence[Sequence[FinishedTrial]]
    reference: Sequence[Sequence[FinishedTrial]]
    why_partial: str


def _training_rows(run: RunTrials, names: Sequence[str]) -> list[_TrainingRows]:
    """The trackers on these recordings by their trainings; none if no tracker has several."""
    groups: dict[tuple[_Tracker, str], dict[tuple[str, ...], list[FinishedTrial]]] = {}  # by card, then by weights
    group_of: dict[str | None, tuple[_Tracker, str]] = {}
    for label in run.labels:
        trials = run.comparable(label, names)
        if len(trials) == len(names) and trials[0].tracker != ORACLE:
            group = group_of[label] = _tracker_of(trials[0]), trials[0].record.card
            groups.setdefault(group, {}).setdefault(_weights(trials), trials)
    of_reference = group_of.get(run.reference_for("occupancy"))
    if of_reference is None or all(len(one) == 1 for one in groups.values()):
        return []
    incomplete = [run.of(label, names) for label in run.labels]
    failed = Counter(_tracker_of(trials[0]) for trials in incomplete if trials and not all(t.complete for t in trials))
    rows = {group: list(of_group.values()) for group, of_group in groups.items()}
    why = {group: _why_partial(group[0][0], len(rows[group]), failed[group[0]]) for group in groups}
    return [
        _TrainingRows(tuple(names), own, rows[of_reference], why[group] or why[of_reference])
        for group, own in rows.items()
    ]


def _why_partial(tracker: str, complete: int, failed: int) -> str:
    """Why a tracker with `failed` trainings is not compared; empty if all are complete."""
    if not failed:
        return ""
    return f"{complete} of {complete + failed} trainings of {tracker} are complete, and the others may be worse"


def _weights(trials: Sequence[FinishedTrial]) -> tuple[str, ...]:
    """The hash of the weights of each trial of a row; empty texts of a tracker without weights."""
    return tuple(trial.record.weights_sha256 for trial in trials)

"""Estimates of every score of a trial, or of several pooled, from their sums."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.referee.strata import STRATA_WITH_TRUTH
from gridtrack.evaluation.runs.finished import FinishedTrial, RunTrials, common_strata
from gridtrack.evaluation.runs.result_files import rounded_curve, rounded_p_curve
from gridtrack.evaluation.runs.summary import Estimate, Estimates
from gridtrack.evaluation.scores.definition import Floats, Ratio, Scale, ScoreDefinition, Sums, value_of
from gridtrack.evaluation.statistics import jackknife
from gridtrack.evaluation.statistics.jackknife import LEAST_UNITS, Replicates, interval
from gridtrack.evaluation.statistics.units import UnitRule

KEPT_BYTES = 512 << 20
"""Sums of units that are kept while a score is estimated; more of them are read twice."""
_ORDER = {name: place for place, name in enumerate(STRATA_WITH_TRUTH)}
"""Strata of cells come first."""


@dataclass(frozen=True, slots=True)
class Selected:
    """Trials with the frames of each that count: `units` (F,) has the unit of each scored frame, -1 of one left out."""

    trials: tuple[FinishedTrial, ...]
    units: tuple[NDArray[np.int64], ...]

    @property
    def number(self) -> int:
        """The number of units."""
        return 1 + max((int(own.max(initial=-1)) for own in self.units), default=-1)

    @property
    def key(self) -> tuple[object, ...]:
        """Equal for the same trials and frames."""
        return tuple(trial.folder.name for trial in self.trials), tuple(own.tobytes() for own in self.units)


@dataclass(frozen=True, slots=True)
class Estimated:
    """A score of one row, in `strata` (K): the values (S, K) of its outputs, and with enough units the replicates."""

    strata: tuple[str, ...]
    values: Mapping[str, Floats]
    replicates: Mapping[str, Replicates]


def selected(run: RunTrials, trials: Sequence[FinishedTrial], rule: UnitRule) -> Selected:
    """All scored frames of `trials` in the units of `rule`. Raises ScoresError."""
    units = rule.units_of([run.frames(trial).stamps_ns for trial in trials])
    return Selected(tuple(trials), tuple(units))


def estimated(run: RunTrials, chosen: Selected, score: ScoreDefinition) -> Estimated | None:
    """A score over the chosen frames; None if a trial has no sums of it. Raises ScoresError."""
    sums = [run.sums(trial) for trial in chosen.trials]
    layouts = [one.layouts[score.name] for one in sums if score.name in one.scores]
    if len(layouts) < len(sums) or not layouts or len({one.parts for one in layouts}) > 1:
        return None
    strata = tuple(name for name in layouts[0].strata if all(name in one.strata for one in layouts))
    steps_of = list(zip(*(trial.steps for trial in chosen.trials), strict=True))
    at = [i for i, own in enumerate(steps_of) if all(n in one.steps for n, one in zip(own, layouts, strict=True))]

    def groups() -> Iterator[Sums]:
        for first, group in _groups(chosen):
            units = [np.where(own >= 0, own - first, -1) for own in (chosen.units[i] for i in group)]
            found = [
                sums[i].by_unit(score.name, own, [steps_of[n][i] for n in at], strata)
                for i, own in zip(group, units, strict=True)
            ]
            yield _added(found)

    size = 8 * chosen.number * len(at) * len(strata) * len(layouts[0].parts)
    kept = list(groups()) if size <= KEPT_BYTES else None
    again: Callable[[], Iterator[Sums]] = groups if kept is None else lambda: iter(kept)
    total = _total(again())
    values = {name: value_of(found) for name, found in score.value(total).items()}
    replicates = jackknife.replicates(score.value, again, total) if chosen.number >= LEAST_UNITS else {}
    return _at_all_steps(Estimated(strata, values, replicates), at, len(steps_of))


def _at_all_steps(found: Estimated, at: Sequence[int], number: int) -> Estimated:
    """A score of some steps, `at`, as one of all `number` steps: undefined at the others."""
    if len(at) == number:
        return found

    def spread(own: Floats, missing: float) -> Floats:
        every = np.full((*own.shape[:-2], number, own.shape[-1]), missing)
        every[..., at, :] = own
        return every

    def all_of(own: Replicates) -> Replicates:
        ratio = own.ratio and Ratio(spread(own.ratio.part, 0), spread(own.ratio.whole, 0), counted=own.ratio.counted)
        return Replicates(spread(own.value, np.nan), spread(own.without, np.nan), spread(own.size, 0), ratio)

    values = {name: spread(own, np.nan) for name, own in found.values.items()}
    return Estimated(found.strata, values, {name: all_of(own) for name, own in found.replicates.items()})


def _groups(chosen: Selected) -> Iterator[tuple[int, list[int]]]:
    """Trials that share units, as indices, with the first of their units; in the order of the units."""
    spans = [
        (int(own[own >= 0].min()), int(own.max()), i) for i, own in enumerate(chosen.units) if own.max(initial=-1) >= 0
    ]
    first, last, group = 0, -1, list[int]()
    for low, high, i in sorted(spans):
        if group and low > last:
            yield first, group
            group = []
        first = first if group else low
        group.append(i)
        last = max(last, high)
    if group:
        yield first, group


def _added(found: Sequence[Sums]) -> Sums:
    """The sums (U, ...) of trials that share units."""
    total = np.zeros((max(len(one.values) for one in found), *found[0].values.shape[1:]))
    for one in found:
        total[: len(one.values)] += one.values
    return Sums(total, found[0].parts)


def _total(groups: Iterator[Sums]) -> Sums:
    first = next(groups)
    total = first.values.sum(axis=0)
    for one in groups:
        total += one.values.sum(axis=0)
    return Sums(total, first.parts)


def estimates_of(found: Mapping[str, Estimated], scores: Sequence[ScoreDefinition]) -> dict[str, Estimates]:
    """The estimates of a scope as the summary holds them: by stratum, score and output."""
    named = dict.fromkeys(name for one in found.values() for name in one.strata)
    strata: dict[str, Estimates] = {name: {} for name in sorted(named, key=lambda name: _ORDER.get(name, len(_ORDER)))}
    for score in scores:
        if (one := found.get(score.name)) is not None:
            for output in score.outputs:
                if output.name in one.values:
                    _add(strata, score.name, output.name, one, output.scale)
    return strata


def _add(strata: dict[str, Estimates], score: str, output: str, one: Estimated, scale: Scale) -> None:
    values, replicates = one.values[output], one.replicates.get(output)
    ends = interval(replicates, scale) if replicates is not None and scale else None
    for k, stratum in enumerate(one.strata):
        estimate = Estimate(
            value=rounded_curve(values[:, k]),
            low=None if ends is None else rounded_curve(ends.low[:, k]),
            high=None if ends is None else rounded_curve(ends.high[:, k]),
        )
        strata[stratum].setdefault(score, {})[output] = estimate


def estimate_of(found: jackknife.IntervalEstimate) -> Estimate:
    """A difference (S,) as the summary holds it."""
    return Estimate(
        value=rounded_curve(found.value),
        low=rounded_curve(found.low),
        high=rounded_curve(found.high),
        p=rounded_p_curve(found.p),
    )


def thresholds_of_scope(trials: Sequence[FinishedTrial]) -> dict[str, tuple[float | None, ...]]:
    """The threshold of each step by stratum; None if the trials differ."""
    found = {}
    for stratum in common_strata(trials):
        values = [np.array(trial.record.thresholds.values[stratum])[trial.steps] for trial in trials]
        found[stratum] = rounded_curve(np.where(np.ptp(values, axis=0) == 0, values[0], np.nan))
    return found

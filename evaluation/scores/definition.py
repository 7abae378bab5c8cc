"""Definition of a score: how it counts a forecast, and its values from the counts.

A score is one object. Storage, pooling, intervals, paired tests, the gate, tables, pages and exports ask it for its
title, unit and direction, and for its values; they name no score. Counts are additive sums, so that scores of several
recordings, of resampled units and of differences follow from the same sums without a tracker.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.referee.referee import ScoredForecast
from gridtrack.evaluation.scores.robot import SMALL_ROBOT, Robot
from gridtrack.evaluation.scores.thresholds import Thresholds
from gridtrack.trackers.contract import ComparedPart

Floats = NDArray[np.float64]
Scale = Literal["", "odds", "log", "linear"]
"""The scale on which an interval is symmetric: log odds of a share in [0, 1], logarithm of a positive value, the value
itself; empty: no interval."""
Relation = Callable[
    ["CurvesByStratum", "CurvesByStratum | None", "CurvesByStratum | None"], dict[str, "CurvesByStratum"]
]
CurvesByStratum = Mapping[str, Floats]
"""Values (S,) by stratum."""
LEADING_HORIZONS_S = (0.5, 1.0, 2.5)
"""Horizons at which a score leads, seconds; the last is the longest of the paper."""


@dataclass(frozen=True, slots=True)
class Output:
    """One value of a score, as tables, pages and exports show it.

    `better`: whether higher or lower values are better; empty for a value that ranks nothing. `tested`: trackers are
    compared by it. `margin`: the gate allows a value that is worse by as much, as a share of the value where
    `relative_margin`; None: the gate does not judge it. `decimals` of a value in a table. `saying`: the predicate of a
    tracker, `foresees {share} of 100 contacts within {ahead}`. `of_trial`: it is the same for every tracker.
    `beside`: a ranking by the first output shows it too.
    """

    name: str
    title: str
    unit: str = ""
    better: Literal["", "higher", "lower"] = ""
    scale: Scale = ""
    tested: bool = False
    margin: float | None = None
    relative_margin: bool = False
    decimals: int = 3
    saying: str = ""
    of_trial: bool = False
    beside: bool = False

    @property
    def direction(self) -> int:
        """1 if higher values are better, -1 if lower ones are, else 0."""
        return {"higher": 1, "lower": -1, "": 0}[self.better]


@dataclass(frozen=True, slots=True)
class Ratio:
    """A value (...) that is `part` / `whole`, both sums; undefined if the sum of `support` is 0 (None: of `whole`).

    `counted`: both sums are counts of cells, so that half a count is added before a logarithm.
    """

    part: Floats
    whole: Floats
    support: Floats | None = None
    counted: bool = False


@dataclass(frozen=True, slots=True)
class Measure:
    """A value (...) that is no ratio of sums, such as an area; `size`: its number of events, beam ends or forecasts."""

    value: Floats
    size: Floats


@dataclass(frozen=True, slots=True)
class Sums:
    """Sums (..., P) of a score; `parts` names the P sums."""

    values: Floats
    parts: tuple[str, ...]

    def __getitem__(self, part: str) -> Floats:
        """The sums (...) called `part`."""
        sums: Floats = self.values[..., _places(self.parts)[part]]
        return sums

    def block(self, name: str) -> Floats:
        """The sums (..., N) called `name 0` to `name N-1`."""
        sums: Floats = self.values[..., _span(self.parts, name)]
        return sums


@cache
def _span(parts: tuple[str, ...], name: str) -> slice:
    """The places of `name 0` to `name N-1`."""
    places = _places(parts)
    first = places[f"{name} 0"]
    size = next((n for n in range(len(parts) - first) if f"{name} {n}" not in places), len(parts) - first)
    return slice(first, first + size)


@cache
def _places(parts: tuple[str, ...]) -> dict[str, int]:
    return {part: place for place, part in enumerate(parts)}


def block(name: str, size: int) -> tuple[str, ...]:
    """Names of the parts of a histogram, `name 0` to `name size-1`."""
    return tuple(f"{name} {n}" for n in range(size))


@dataclass(frozen=True, slots=True)
class TrialFacts:
    """A trial as scores see it: cells of `cell_m` metres, steps 0..`steps`, the strata that are scored, the
    classes of the recording and of the tracker, its thresholds, and whether there are ground truth and annotated
    people. Frames are `period_s` seconds apart, and contacts are of `robot`."""

    cell_m: float
    steps: int
    strata: tuple[str, ...]
    thresholds: Thresholds
    classes: tuple[str, ...] = ()
    tracker_classes: tuple[str, ...] = ()
    has_truth: bool = False
    has_people: bool = False
    period_s: float = 0.1
    robot: Robot = SMALL_ROBOT


@dataclass(frozen=True, slots=True)
class RareEvents:
    """The events of a score: their `name`, in the plural, and their numbers (...) from sums (..., P)."""

    name: str
    count: Callable[[Sums], Floats]


Count = Callable[[ScoredForecast, TrialFacts, Any], "Floats | None"]


@dataclass(frozen=True, kw_only=True)
class ScoreDefinition:
    """A score.

    `count(forecast, facts, memory)` gives the sums (S, K, P) of one forecast, per step of `steps`, stratum and part, or
    None if the forecast has nothing to count. `memory` is made by `new_memory` for each trial and kept between its
    forecasts. `value(sums)` gives every output that follows from sums (..., P), pooled, of units, or without one of
    them: intervals, differences and tests are made from it. The first output leads. `strata`, `parts` and `steps` (by
    default 0 to the last) of a trial follow from its facts; a score without strata does not apply to the trial.
    `relate` gives outputs (S,) by stratum that need other rows: the best floor at each step, and the oracle.
    `figure` gives the points (N,) of its figure from sums (U, P) of units; those that are ratios get an interval.
    `needed` names files of the recording or parts of the forecast that not every trial has. `compared_with`: the row
    that others are compared with is the reference for occupancy, or for classes. `thresholded`: its values depend on
    the threshold that was chosen for the trial. `about`: what the score says, what it
    does not say, and its source. `position`: scores are listed in this order, and the first one leads a run.
    With too few of its `events` in a run the next score leads. It leads in `stratum`, at `horizons_s`.
    """

    name: str
    title: str
    position: int
    outputs: tuple[Output, ...]
    about: str
    count: Count
    value: Callable[[Sums], Mapping[str, Ratio | Measure | Floats]]
    parts: Callable[[TrialFacts], tuple[str, ...]]
    strata: Callable[[TrialFacts], tuple[str, ...]] = lambda facts: facts.strata
    steps: Callable[[TrialFacts], tuple[int, ...]] = lambda facts: tuple(range(facts.steps + 1))
    new_memory: Callable[[TrialFacts], Any] = lambda facts: None
    relate: Relation | None = None
    figure: Callable[[Sums], dict[str, Floats | Ratio]] | None = None
    events: RareEvents | None = None
    stratum: str = "in-motion"
    horizons_s: tuple[float, ...] = LEADING_HORIZONS_S
    needed: str = ""
    compared_with: ComparedPart = "occupancy"
    thresholded: bool = False

    @property
    def lead(self) -> Output:
        """The output that stands for the score."""
        return self.outputs[0]

    @property
    def counts_every_step(self) -> bool:
        """Whether it is counted at each step, and not only at some horizons."""
        return self.steps is ScoreDefinition.steps

    def leading(self, sums: Floats, facts: TrialFacts) -> Floats:
        """The leading values (steps+1, K) of a trial from its sums (H, K, P); NaN at steps without this score."""
        values = np.full((facts.steps + 1, len(self.strata(facts))), np.nan)
        found = self.value(Sums(sums, self.parts(facts)))[self.lead.name]
        values[list(self.steps(facts))] = value_of(found)
        return values

    def output(self, name: str) -> Output:
        """An output by its name. Raises KeyError."""
        return {output.name: output for output in self.outputs}[name]

    @property
    def may_lead(self) -> bool:
        """Whether the score may lead a run: trackers are compared by it, and higher values are better."""
        return self.lead.tested and self.lead.direction > 0

    @property
    def tested(self) -> tuple[Output, ...]:
        """The outputs by which trackers are compared."""
        return tuple(output for output in self.outputs if output.tested)


def divided(part: NDArray[Any], whole: NDArray[Any], defined: NDArray[np.bool_] | None = None) -> Floats:
    """part / whole, broadcast; NaN if `whole` is 0 or the ratio is not `defined`."""
    divisible = whole > 0 if defined is None else defined & (whole > 0)
    found = np.full(np.broadcast_shapes(part.shape, whole.shape), np.nan)
    np.divide(part, whole, out=found, where=divisible)
    return found


def value_of(found: Ratio | Measure | Floats) -> Floats:
    """The value (...) of what `ScoreDefinition.value` gives of pooled sums; NaN if it is undefined."""
    if isinstance(found, Ratio):
        return divided(found.part, found.whole, None if found.support is None else found.support > 0)
    return found.value if isinstance(found, Measure) else found

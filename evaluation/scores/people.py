"""People: forecasts of annotated persons, and of the cells that are in motion by the annotation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.referee.people import PeopleInWindow
from gridtrack.evaluation.referee.referee import ScoredForecast
from gridtrack.evaluation.referee.targets import Target
from gridtrack.evaluation.scores.cells import PROBABILITY_BINS, count_cells
from gridtrack.evaluation.scores.definition import (
    Floats,
    Measure,
    Output,
    Ratio,
    ScoreDefinition,
    Sums,
    TrialFacts,
    block,
)
from gridtrack.evaluation.scores.pr_auc import area_under_precision_recall

ALL, MOVING, SEEN, UNSEEN = "people", "people in motion", "people seen", "people hidden"
_PERSONS_OF = "dynamic"
"""The stratum with the threshold of persons: of the moving and the standing."""
_PARTS = (
    *("persons", "found", "found half", "away", "called away"),
    *("tp", "fp", "fn"),
    *block("cells", PROBABILITY_BINS),
    *block("occupied", PROBABILITY_BINS),
)


def people_strata(facts: TrialFacts) -> tuple[str, ...]:
    """All annotated persons, those in motion, and those with and without a visible return; none without annotations."""
    return (ALL, MOVING, SEEN, UNSEEN) if facts.has_people else ()


def _count(forecast: ScoredForecast, facts: TrialFacts, memory: None) -> Floats | None:
    """Sums (S, K, P) of the steps at which people are annotated; None without any."""
    annotated = {n: target.people for n, target in enumerate(forecast.targets) if target.people is not None}
    if not annotated:
        return None
    sums = Sums(np.zeros((len(forecast.targets), len(people_strata(facts)), len(_PARTS))), _PARTS)
    threshold = facts.thresholds.values[:, facts.strata.index(_PERSONS_OF)].astype(np.float32)
    dynamic = forecast.region_maps.dynamic.ravel()
    for n, people in annotated.items():
        p = forecast.occupancy[n].ravel()
        at_step = Sums(sums.values[n], _PARTS)
        _add_persons(at_step, people, forecast.targets[n], dynamic, p >= threshold[n], p >= np.float32(0.5))
    _add_cells_in_motion(sums, annotated, forecast, facts)
    return sums.values


def _add_persons(
    sums: Sums,
    people: PeopleInWindow,
    target: Target,
    dynamic: NDArray[np.bool_],
    called: NDArray[np.bool_],
    called_half: NDArray[np.bool_],
) -> None:
    """Add the persons with a dynamic cell to the sums (K, P) of a step, and the cells away from all people."""
    visible, occupied = target.frame.visible.ravel(), target.frame.occupied.ravel()
    for cells, moves in zip(people.cells, people.moving, strict=True):
        own = cells[dynamic[cells]]
        if not own.size:
            continue
        is_seen = bool(occupied[own].any())
        strata = np.array([True, moves, is_seen, not is_seen])
        sums["persons"][strata] += 1
        sums["found"][strata] += called[own].any()
        sums["found half"][strata] += called_half[own].any()
    away = dynamic & ~people.near.ravel() & ~occupied
    for k, part in ((0, away), (2, away & visible), (3, away & ~visible)):
        sums["away"][k] += np.count_nonzero(part)
        sums["called away"][k] += np.count_nonzero(part & called)


def _add_cells_in_motion(
    sums: Sums, annotated: Mapping[int, PeopleInWindow], forecast: ScoredForecast, facts: TrialFacts
) -> None:
    """Add the cells that are in motion by the annotation, as those of the stratum in-motion, to MOVING."""
    steps = list(annotated)
    targets = [replace(forecast.targets[n], motion=people.motion) for n, people in annotated.items()]
    tally = count_cells(forecast.occupancy[steps], targets, forecast.region_maps, forecast.ages).of(("in-motion",))
    bins = facts.thresholds.bins[steps, facts.strata.index("in-motion")]
    k = people_strata(facts).index(MOVING)
    for part, count in zip(("tp", "fp", "fn"), tally.confusion(bins[:, None])[:, 0].T, strict=False):
        sums[part][steps, k] += count
    sums.block("cells")[steps, k] += tally.cells[:, 0]
    sums.block("occupied")[steps, k] += tally.positives[:, 0]


def _value(sums: Sums) -> Mapping[str, Ratio | Measure | Floats]:
    cells, positives = sums.block("cells"), sums.block("occupied")
    tp, fp, fn = sums["tp"], sums["fp"], sums["fn"]
    persons = sums["persons"]
    return {
        "found": Ratio(sums["found"], persons, counted=True),
        "at_half": Ratio(sums["found half"], persons, counted=True),
        "called_away": Ratio(sums["called away"], sums["away"], counted=True),
        "f1": Ratio(2 * tp, 2 * tp + fp + fn, support=tp + fn, counted=True),
        "area": Measure(area_under_precision_recall(cells, positives), positives.sum(axis=-1)),
        "persons": persons,
    }


PEOPLE_SCORE = ScoreDefinition(
    name="people",
    title="People",
    position=115,
    outputs=(
        Output("found", "Persons found", better="higher", scale="odds"),
        Output("at_half", "Persons found at 0.5", better="higher", scale="odds"),
        Output("called_away", "Free cells away from people called occupied", better="lower", scale="odds"),
        Output("f1", "F1, in motion by the annotation", better="higher", scale="odds"),
        Output("area", "PR-AUC, in motion by the annotation", better="higher", scale="odds"),
        Output("persons", "Persons", decimals=0, of_trial=True),
    ),
    about="On annotated frames. A person has the dynamic cells within 0.4 m, is hidden if none of them was seen"
    " occupied, and found if one is called occupied, at the threshold of `dynamic`. Calling everything occupied finds"
    " everyone: the price is the share of other dynamic cells, not seen occupied, that are called. F1 and PR-AUC are"
    " of `in-motion`, with returns in motion within 0.4 m of persons faster than 0.3 m/s. Annotators miss people: no"
    " tracker is compared by it.",
    strata=people_strata,
    parts=lambda facts: _PARTS,
    count=_count,
    value=_value,
    stratum=ALL,
    needed="annotated people",
    thresholded=True,
)

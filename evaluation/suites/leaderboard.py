"""The leaderboard of a suite: its rows by the headline score, with intervals and paired tests of all pairs.

Values are of a step band, as in the gate, because rows hold the sums of bands: contacts are counted within 1 s, cells
from 0.5 to 1.5 s ahead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from gridtrack.evaluation.regression.measurement import Measurement
from gridtrack.evaluation.regression.pairing import differing_key
from gridtrack.evaluation.scores.definition import Floats, Output, ScoreDefinition, Sums
from gridtrack.evaluation.scores.registry import scores
from gridtrack.evaluation.statistics.jackknife import (
    IntervalEstimate,
    Replicates,
    difference,
    holm,
    interval,
    replicates,
    verdict_of,
)
from gridtrack.evaluation.suites.published import PublishedRow
from gridtrack.trackers.contract import Role

BAND = "middle"


@dataclass(frozen=True, slots=True)
class BoardValue:
    """A score of a row: its value and the ends of its interval; NaN if undefined, or without enough units."""

    score: ScoreDefinition
    estimate: IntervalEstimate

    @property
    def output(self) -> Output:
        """The leading output of the score."""
        return self.score.lead


@dataclass(frozen=True, slots=True)
class BoardRow:
    """A row of the leaderboard.

    `rank`: one more than the number of rows that are better by their paired tests. `values`: the headline score first.
    `difference`: from the reference; NaN if it is not tested. `verdict`: of its test, corrected for all pairs.
    """

    row: PublishedRow
    rank: int
    values: tuple[BoardValue, ...]
    difference: IntervalEstimate
    verdict: str

    @property
    def label(self) -> str:
        """The label of the row."""
        return self.row.label

    @property
    def role(self) -> Role:
        """The role of its tracker: a floor, which every tracker must beat, and recorded forecasts are marked."""
        return self.row.measurement.trackers[self.label].role


@dataclass(frozen=True, slots=True)
class Leaderboard:
    """The rows that pair, the best first; `left_out`: a line for each row that does not pair with the first one."""

    rows: tuple[BoardRow, ...]
    reference: str
    units: int
    left_out: tuple[str, ...]

    @property
    def scores(self) -> tuple[ScoreDefinition, ...]:
        """The scores of the columns."""
        return tuple(value.score for value in self.rows[0].values)


def leaderboard(published: Sequence[PublishedRow], reference: str, headline: str) -> Leaderboard:
    """The leaderboard of rows with unlike labels.

    `reference`: the label of the row that differences are from; empty: the best one.
    """
    first = next(row for row in published if reference in ("", row.label))
    why = {row.label: why_not_paired(first.measurement, row.measurement) for row in published}
    paired = [row for row in published if not why[row.label]]
    columns = _columns(paired, headline)
    found = {row.label: [_replicates(row, score) for score in columns] for row in paired}
    ordered = sorted(paired, key=lambda row: -np.nan_to_num(float(found[row.label][0].value), nan=-np.inf))
    reference = reference or ordered[0].label
    pairs = list(combinations(found, 2))
    tests = [difference(found[one][0], found[other][0]) for one, other in pairs]
    corrected = holm(np.array([float(test.p) for test in tests]))
    verdicts: dict[tuple[str, str], str] = {}
    for (one, other), test, p in zip(pairs, tests, corrected.tolist(), strict=True):
        verdicts[one, other] = verdict_of(float(test.value), p)
        verdicts[other, one] = verdict_of(-float(test.value), p)
    rows = tuple(
        BoardRow(
            row,
            1 + sum(verdicts[row.label, other] == "worse" for other in found if other != row.label),
            tuple(
                BoardValue(score, interval(own, score.lead.scale))
                for score, own in zip(columns, found[row.label], strict=True)
            ),
            difference(found[row.label][0], found[reference][0]),
            verdicts.get((row.label, reference), ""),
        )
        for row in ordered
    )
    left_out = tuple(f"{label}: {text}" for label, text in why.items() if text)
    return Leaderboard(rows, reference, found[reference][0].units, left_out)


def why_not_paired(one: Measurement, other: Measurement) -> str:
    """Why two rows were not scored on the same frames by the same rules; empty if they were."""
    if one.scoring_rules != other.scoring_rules:
        return f"scored by the rules {other.scoring_rules}, and not {one.scoring_rules}: run it again"
    if one.recordings.keys() != other.recordings.keys() or one.block_s != other.block_s:
        return "other recordings or units"
    for name, split in one.recordings.items():
        if key := differing_key(split, other.recordings[name]):
            return f"{name} was compared otherwise ({key})"
    mine, others = ({name: _delivered(trial, name) for name in one.recordings} for trial in (one, other))
    return next((f"other frames of {name}" for name in mine if mine[name] != others[name]), "")


def _delivered(measured: Measurement, name: str) -> list[tuple[int, str]]:
    (entry,) = measured.trackers.values()
    return [(unit.unit, unit.delivered) for unit in entry.recordings[name].units]


def _columns(rows: Sequence[PublishedRow], headline: str) -> list[ScoreDefinition]:
    """The scores that may lead (higher is better) and that every row has, the `headline` first."""
    has = [set(row.measurement.scores[row.label]) for row in rows]
    found = [score for score in scores(()) if score.may_lead and score.lead.margin is not None]
    known = [score for score in found if all(score.name in own for own in has)]
    return sorted(known, key=lambda score: score.name != headline)


def _replicates(row: PublishedRow, score: ScoreDefinition) -> Replicates:
    """The replicates () of the leading output of a row in the score's own stratum, over units."""
    parts = row.measurement.scores[row.label][score.name]
    by_unit: dict[int, Floats] = {}
    for trial in row.measurement.trackers[row.label].recordings.values():
        for unit in trial.units:
            sums = np.array(unit.sums[score.name].get(score.stratum, {}).get(BAND, (0.0,) * len(parts)))
            by_unit[unit.unit] = by_unit.get(unit.unit, np.zeros(len(parts))) + sums
    summed = Sums(np.stack([by_unit[unit] for unit in sorted(by_unit)]), parts)
    total = Sums(summed.values.sum(axis=0), parts)
    return replicates(score.value, lambda: iter([summed]), total)[score.lead.name]

"""The rows of the gate: one judged output of one tracker in a stratum and step band, baseline and run paired."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from gridtrack.evaluation.regression.measurement import BANDS, Baseline, Measurement
from gridtrack.evaluation.scores.definition import Floats, Measure, Output, Ratio, ScoreDefinition, Sums, value_of
from gridtrack.evaluation.statistics.jackknife import (
    LEAST_UNITS,
    IntervalEstimate,
    Replicates,
    degrees_of_freedom,
    replicates,
)
from gridtrack.evaluation.statistics.trainings import Spread, Trainings, one_more
from gridtrack.evaluation.statistics.wild_bootstrap import Variation, family_p, influence_on_difference


@dataclass(frozen=True, slots=True)
class PairedRow:
    """One output of a score of one tracker in one stratum and step band.

    `trainings` (K, P, N) and `run` (P, N): the N sums of the score in the K runs of the baseline and in the run. Each
    of the P parts has the frames of one recording in one unit; `units` (P,) and `recordings` (P,) identify it.
    """

    label: str
    score: ScoreDefinition
    output: Output
    stratum: str
    band: str
    parts: tuple[str, ...]
    trainings: Floats
    run: Floats
    units: NDArray[np.int64]
    recordings: tuple[str, ...]

    @property
    def key(self) -> tuple[str, str, str, str]:
        """Equal for the same row of another run."""
        return self.label, f"{self.score.name}.{self.output.name}", self.stratum, self.band

    @property
    def equal(self) -> bool:
        """Whether a run of the baseline has exactly these sums."""
        return bool((self.trainings == self.run).all(axis=(1, 2)).any())

    @property
    def baseline(self) -> Floats:
        """The mean sums (P, N) of the runs of the baseline."""
        mean: Floats = self.trainings.mean(axis=0)
        return mean

    def value(self, sums: Floats) -> Floats:
        """The output (...) of sums (..., N); NaN if it is undefined."""
        return value_of(self.score.value(Sums(sums, self.parts))[self.output.name])

    def by_unit(self, sums: Floats) -> Floats:
        """Sums (..., P, N) over the parts of each of U units, (..., U, N)."""
        numbers = np.unique(self.units, return_inverse=True)[1]
        member = (np.arange(numbers.max() + 1)[:, None] == numbers).astype(np.float64)
        summed: Floats = member @ sums
        return summed

    def size(self, sums: Floats) -> Floats:
        """The weight of sums (..., N): the denominator of a ratio."""
        found = self.score.value(Sums(sums, self.parts))[self.output.name]
        assert isinstance(found, Ratio | Measure), "an output with a margin is a ratio or a measure"
        return found.whole if isinstance(found, Ratio) else found.size

    def fall(self, then: float, now: float) -> float:
        """The fall from `then` to `now` in the unit of margins: a share of `then` if the margin is a share."""
        fall = self.output.direction * (then - now)
        return fall / then if self.output.relative_margin and then else fall

    def replicates(self, sums: Floats) -> Replicates:
        """The replicates () of sums (P, N) over units."""
        by_unit = Sums(self.by_unit(sums), self.parts)
        total = Sums(by_unit.values.sum(axis=0), self.parts)
        return replicates(self.score.value, lambda: iter([by_unit]), total)[self.output.name]


@dataclass(frozen=True, slots=True)
class RowTest:
    """The test of a row: `p`, one-sided and corrected over all rows, and the difference of run and baseline; None with
    too few units. `spread`: the standard deviation between trainings; None with one run in the baseline."""

    p: float | None = None
    difference: IntervalEstimate | None = None
    spread: float | None = None
    critical: float = 0.0
    """The smallest fall, alike in all units, that would have been significant."""


def paired_rows(baseline: Baseline, run: Measurement, scores: Sequence[ScoreDefinition]) -> tuple[PairedRow, ...]:
    """The rows of every tracker of the baseline. The runs must pair (`pairing.require_paired`)."""
    return tuple(row for label in baseline.first.trackers for row in _rows_of(label, baseline, run, scores))


def _rows_of(
    label: str, baseline: Baseline, run: Measurement, scores: Sequence[ScoreDefinition]
) -> Iterator[PairedRow]:
    sides = [side.trackers[label].recordings for side in (*baseline.runs, run)]
    members = [(name, part) for name, trial in sides[0].items() for part in range(len(trial.units))]
    first = [sides[0][name].units[part] for name, part in members]
    units, recordings = np.array([unit.unit for unit in first]), tuple(name for name, _ in members)
    for score in scores:
        parts = baseline.first.scores[label].get(score.name)
        strata = dict.fromkeys(stratum for unit in first for stratum in unit.sums.get(score.name, {}))
        for stratum in strata if parts else ():
            for band in BANDS:
                nothing = (0.0,) * len(parts or ())
                found = [
                    [side[name].units[part].sums[score.name].get(stratum, {}).get(band) for name, part in members]
                    for side in sides
                ]
                if any(one is not None for one in found[0]):
                    sums = np.array([[one or nothing for one in side] for side in found], np.float64)
                    for output in score.outputs:
                        if output.margin is not None:
                            yield PairedRow(
                                label, score, output, stratum, band, parts or (), sums[:-1], sums[-1], units, recordings
                            )


@dataclass(frozen=True, slots=True)
class _Compared:
    """The difference between run and baseline in one row, before the correction.

    `spread`: between the trainings of the baseline; None with one. `influence` (U,): of each unit on the gain, for the
    correction.
    """

    difference: IntervalEstimate
    spread: Spread | None
    influence: Floats
    freedom: float
    p: float
    """Of a fall, one-sided."""

    @classmethod
    def of(cls, row: PairedRow) -> _Compared:
        trainings = [row.replicates(sums) for sums in row.trainings]
        own, mean = row.replicates(row.run), Trainings(tuple(trainings), learned=True).mean
        found, spread = one_more(own, trainings)
        worse = row.output.direction * float(found.value) < 0
        return cls(
            found,
            spread,
            row.output.direction * influence_on_difference(own, mean),
            float(degrees_of_freedom(own.size, mean.size)),
            1.0 if found.p == 1 else float(found.p) / 2 if worse else 1.0 - float(found.p) / 2,
        )


def row_tests(rows: Sequence[PairedRow]) -> list[RowTest]:
    """The test of each row, corrected for all rows together; empty tests with fewer than LEAST_UNITS units.

    With several runs in the baseline the run counts as one more training: the variance includes the spread between
    trainings.
    """
    if not rows or len(np.unique(rows[0].units)) < LEAST_UNITS:
        return [RowTest() for _ in rows]
    compared = [_Compared.of(row) for row in rows]
    corrected, level = family_p(np.array([one.p for one in compared]), _variation(compared))
    return [
        RowTest(
            None if np.isnan(p) else p,
            one.difference,
            None if one.spread is None else float(one.spread.deviation),
            _critical(one.difference, level),
        )
        for p, one in zip(corrected.tolist(), compared, strict=True)
    ]


def _variation(compared: Sequence[_Compared]) -> Variation:
    """The chance variation of the rows. Conservative assumption: between trainings they vary independently."""
    spreads = [one.spread for one in compared]
    return Variation(
        np.stack([one.influence for one in compared], axis=1),
        np.array([one.freedom for one in compared]),
        np.array([0.0 if spread is None else float(spread.error) for spread in spreads]),
        next((spread.freedom for spread in spreads if spread), 1.0),
    )


def _critical(found: IntervalEstimate, level: float) -> float:
    """The smallest fall with a one-sided p-value of `level`, from the interval of 95 %."""
    reach = float(found.high - found.low) / 2
    return reach * float(ndtri(1 - level) / ndtri(0.975)) if np.isfinite(reach) else 0.0

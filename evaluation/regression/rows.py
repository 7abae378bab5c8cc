"""The rows of the gate: one judged output of one tracker in a stratum and step band, baseline and run paired."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from gridtrack.evaluation.regression.measurement import BANDS, Baseline, Measurement
from gridtrack.evaluation.scores.definition import Floats, Measure, Output, Ratio, ScoreDefinition, Sums, value_of
from gridtrack.evaluation.statistics.jackknife import LEAST_UNITS, IntervalEstimate, Replicates, holm, replicates
from gridtrack.evaluation.statistics.trainings import one_more, spread_between


@dataclass(frozen=True, slots=True)
class PairedRow:
    """One output of a score of one tracker in one stratum and step band.

    `trainings` (K, P, N) and `run` (P, N): the N sums of the score, of the K runs of the baseline and of the run, in P
    parts: the frames of one recording in one unit. `units` (P,) and `recordings` (P,) identify the parts.
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
        """Whether every sum is that of one run of the baseline."""
        return bool((self.trainings == self.run).all(axis=(1, 2)).any())

    @property
    def baseline(self) -> Floats:
        """The sums (P, N), the mean over the runs of the baseline."""
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
        """How much sums (..., N) count: the denominator of a ratio."""
        found = self.score.value(Sums(sums, self.parts))[self.output.name]
        assert isinstance(found, Ratio | Measure), "an output with a margin is a ratio or a measure"
        return found.whole if isinstance(found, Ratio) else found.size

    def fall(self, then: float, now: float) -> float:
        """How much worse `now` is than `then`, as margins are given: a share of `then` where the margin is one."""
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
    """The rows of every tracker of the baseline; the two are paired (`pairing.require_paired`)."""
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


def row_tests(rows: Sequence[PairedRow]) -> list[RowTest]:
    """The test of each row, with Holm's correction over all of them. With fewer than LEAST_UNITS units there is none.

    With several runs in the baseline the difference is that from one more training, so that its variance includes the
    spread between trainings.
    """
    if not rows or len(np.unique(rows[0].units)) < LEAST_UNITS:
        return [RowTest() for _ in rows]
    compared = [_compared(row) for row in rows]
    p = [_one_sided(row, found) for row, (found, _) in zip(rows, compared, strict=True)]
    adjusted = holm(np.array(p)).tolist()
    return [
        RowTest(None if np.isnan(own) else own, found, spread, _critical(found, len(rows)))
        for own, (found, spread) in zip(adjusted, compared, strict=True)
    ]


def _compared(row: PairedRow) -> tuple[IntervalEstimate, float | None]:
    """The run less the baseline, and the standard deviation between the trainings of the baseline."""
    trainings = [row.replicates(sums) for sums in row.trainings]
    found = one_more(row.replicates(row.run), trainings)
    spread = float(spread_between(trainings).deviation) if len(trainings) > 1 else None
    return found, spread


def _one_sided(row: PairedRow, found: IntervalEstimate) -> float:
    """The p-value of a fall."""
    worse = row.output.direction * float(found.value) < 0
    return float(found.p) / 2 if worse else 1.0 - float(found.p) / 2


def _critical(found: IntervalEstimate, family: int) -> float:
    """The smallest fall with a p-value that the correction for `family` rows leaves significant, from the interval."""
    reach = float(found.high - found.low) / 2
    return reach * _quantile_ratio(family) if np.isfinite(reach) else 0.0


def _quantile_ratio(family: int) -> float:
    """The normal quantile of a one-sided level of 5 % over `family` rows, over that of a two-sided one of 5 %."""
    return float(ndtri(1 - 0.05 / family) / ndtri(0.975))

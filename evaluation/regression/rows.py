"""The rows of a comparison: one score of one tracker in a part of the cells and a step band, baseline and run paired.

F1, the log loss of cells and that of classes are ratios of two sums over units: 2 TP over 2 TP + FP + FN, nats over
cells, nats over scans.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.regression.measurement import BANDS, Baseline, Measurement, TrialCounts, UnitCounts
from gridtrack.evaluation.scoring.counting import CLIP
from gridtrack.evaluation.statistics.jackknife import Floats

JudgedScore = Literal["F1", "log loss", "class log loss"]
LARGEST: dict[JudgedScore, float] = {"F1": 1.0, "log loss": -np.log(CLIP), "class log loss": -np.log(CLIP)}
"""The largest value of each score; the smallest is 0."""
SHARE_PER_F1 = 10.0
"""A fall of 0.005 F1 weighs as much as a rise of a log loss by 10 times that, 5 % of its value."""

CountsOf = Callable[[UnitCounts], tuple[float, ...] | None]


@dataclass(frozen=True, slots=True)
class PairedRow:
    """One score of one tracker in one region of cells (a stratum; of classes a visibility) and step band.

    `trainings` (K, P, 2) and `run` (P, 2): numerator and denominator of the score, of the K runs of the baseline and
    of the run, in P parts: the frames of one recording in one unit. `units` (P,) and `recordings` (P,) say which;
    `occurs` (P,) where there is something to score. `equal`: every count is that of one run of the baseline.
    """

    label: str
    score: JudgedScore
    region: str
    band: str
    trainings: Floats
    run: Floats
    units: NDArray[np.int64]
    recordings: tuple[str, ...]
    occurs: NDArray[np.bool_]
    equal: bool

    @property
    def baseline(self) -> Floats:
        """Numerator and denominator (P, 2), the mean over the runs of the baseline."""
        mean: Floats = self.trainings.mean(axis=0)
        return mean

    def by_unit(self, sums: Floats) -> Floats:
        """Sums (..., P, 2) over the parts of each of U units, (..., U, 2)."""
        numbers = np.unique(self.units, return_inverse=True)[1]
        member = (np.arange(numbers.max() + 1)[:, None] == numbers).astype(np.float64)
        summed: Floats = member @ sums
        return summed

    @property
    def sign(self) -> float:
        """1 where a lower value is worse, -1 where a higher one is."""
        return 1.0 if self.score == "F1" else -1.0

    def in_margin_units(self, fall: float, baseline: float) -> float:
        """A deterioration as margins are given: of F1 as it is, of a loss as a share of the baseline's."""
        return fall if self.score == "F1" else fall / baseline

    def margin_of(self, f1_margin: float) -> float:
        """The margin of this row for a margin of F1."""
        return f1_margin if self.score == "F1" else SHARE_PER_F1 * f1_margin


def paired_rows(baseline: Baseline, run: Measurement) -> tuple[PairedRow, ...]:
    """The rows of every tracker of the baseline; the two are paired (`pairing.require_paired`)."""
    return tuple(row for label in baseline.first.trackers for row in _rows_of(label, baseline, run))


def _rows_of(label: str, baseline: Baseline, run: Measurement) -> Iterator[PairedRow]:
    sides = [side.trackers[label].recordings for side in (*baseline.runs, run)]
    parts = [(name, part) for name, trial in sides[0].items() for part in range(len(trial.units))]
    first = [sides[0][name].units[part] for name, part in parts]
    members = np.array([unit.unit for unit in first]), tuple(name for name, _ in parts)
    for region, band in _regions(unit.counts for unit in first):
        counts = _stacked(sides, parts, _counts_in(region, band), 5)
        tp, fp, fn, tn, loss = np.moveaxis(counts, -1, 0)
        occupied = (tp + fn)[0] > 0
        # F1 is undefined where no cell is occupied
        f1 = np.stack([2 * tp, 2 * tp + fp + fn], axis=-1) * (1.0 if occupied.any() else 0.0)
        cells = np.stack([loss, tp + fp + fn + tn], axis=-1)
        yield _row(label, "F1", region, band, f1, members, occupied, counts[..., :4])
        yield _row(label, "log loss", region, band, cells, members, cells[0, :, 1] > 0, cells)
    for region, band in _regions(unit.classes for unit in first):
        sums = _stacked(sides, parts, _classes_in(region, band), 2)
        yield _row(label, "class log loss", region, band, sums, members, sums[0, :, 1] > 0, sums)


def _row(
    label: str,
    score: JudgedScore,
    region: str,
    band: str,
    sums: Floats,
    members: tuple[NDArray[np.int64], tuple[str, ...]],
    occurs: NDArray[np.bool_],
    counts: Floats,
) -> PairedRow:
    """A row of sums (K + 1, P, 2), the run's last; it is equal where `counts` (K + 1, P, C) are."""
    equal = bool((counts[:-1] == counts[-1]).all(axis=(1, 2)).any())
    return PairedRow(label, score, region, band, sums[:-1], sums[-1], *members, occurs, equal)


def _counts_in(region: str, band: str) -> CountsOf:
    return lambda unit: unit.counts.get(region, {}).get(band)


def _classes_in(region: str, band: str) -> CountsOf:
    return lambda unit: unit.classes.get(region, {}).get(band)


def _regions(counts: Iterator[Mapping[str, Mapping[str, object]]]) -> list[tuple[str, str]]:
    """Region and band of every count of any unit, the bands of a region together."""
    found: dict[str, set[str]] = {}
    for regions in counts:
        for region, bands in regions.items():
            found.setdefault(region, set()).update(bands)
    return [(region, band) for region, bands in found.items() for band in BANDS if band in bands]


def _stacked(
    sides: Sequence[Mapping[str, TrialCounts]], parts: Sequence[tuple[str, int]], counts_of: CountsOf, size: int
) -> Floats:
    """The counts (K + 1, P, size) of every side; zeros in a part without any."""
    zeros = (0.0,) * size
    rows = [[counts_of(side[name].units[part]) or zeros for name, part in parts] for side in sides]
    return np.array(rows, np.float64)

"""The histograms of a trial, read from its scores store: summed over statistical units, or above thresholds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.results.columns import CALIBRATION_BINS, HISTOGRAM_TABLE, PROBABILITY_BINS, SCORES_TABLE
from gridtrack.evaluation.scoring.counting import Tally
from gridtrack.evaluation.scoring.score_store import ScoresError, batches, read_losses
from gridtrack.evaluation.scoring.strata import STRATA, STRATA_WITH_TRUTH

_ENTRIES = ("bin", "count", "positives")
"""The columns that list, for each row, the bins that have cells."""


@dataclass(frozen=True, slots=True)
class UnitHistograms:
    """Histograms of one trial for U statistical units, S steps, K `strata` and B bins.

    `cells`, `positives` (U, S, K, B) int64: cells scored and those of them occupied; `p_sum` (S, K, C) float64: sum of
    the forecast probability in each bin for calibration, over all units.
    """

    cells: NDArray[np.int64]
    positives: NDArray[np.int64]
    p_sum: NDArray[np.float64]
    strata: tuple[str, ...]

    @classmethod
    def empty(cls, units: int, steps: int, strata: tuple[str, ...]) -> UnitHistograms:
        """Counts of zero for steps 0..steps."""
        plain = steps + 1, len(strata)
        cells, positives = np.zeros((2, units, *plain, PROBABILITY_BINS), np.int64)
        return cls(cells, positives, np.zeros((*plain, CALIBRATION_BINS)), strata)

    def tally(self, squared_error: NDArray[np.float64], log_loss: NDArray[np.float64]) -> Tally:
        """All units together, with the sums (S, K) of `score_store.read_losses`."""
        cells, positives = self.cells.sum(axis=0), self.positives.sum(axis=0)
        return Tally(cells, positives, self.p_sum, squared_error, log_loss, self.strata)


def read_unit_histograms(
    folder: Path, steps: int, strata: tuple[str, ...], stamps_ns: NDArray[np.int64], units: NDArray[np.int64]
) -> UnitHistograms:
    """Histograms of a trial whose scored frames `stamps_ns` (F,) are in `units` (F,); those in unit -1 are left out.

    Raises ScoresError, also where the file has other frames.
    """
    total = UnitHistograms.empty(int(units.max(initial=-1)) + 1, steps, strata)
    for columns in batches(folder, HISTOGRAM_TABLE, ["stamp_ns", *_ENTRIES, "p_sum"], steps):
        _add(folder, columns, units[_frames(folder, columns["stamp_ns"], stamps_ns)], total)
    return total


def read_tally(folder: Path, steps: int, strata: tuple[str, ...] = STRATA) -> Tally:
    """Counts of a trial in `strata`, pooled over its scored frames. Raises ScoresError."""
    if not set(strata) <= set(STRATA_WITH_TRUTH):
        raise ScoresError(f"{folder}: strata {', '.join(strata)}; expected some of {', '.join(STRATA_WITH_TRUTH)}")
    total = UnitHistograms.empty(1, steps, strata)
    for columns in batches(folder, HISTOGRAM_TABLE, [*_ENTRIES, "p_sum"], steps):
        _add(folder, columns, np.zeros(len(columns["where"][0]), np.int64), total)
    return total.tally(*read_losses(folder, steps, strata))


def read_called(
    folder: Path, stamps_ns: NDArray[np.int64], steps: int, stratum: str, bins: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Cells of a stratum that are called occupied at thresholds `bins` (T, S), and those of them occupied.

    (T, F, S, 2) at the scored frames `stamps_ns` (F,) and steps 0..steps. Raises ScoresError.
    """
    called = np.zeros((len(bins), len(stamps_ns), steps + 1, 2), np.int64)
    for columns in batches(folder, HISTOGRAM_TABLE, ["stamp_ns", *_ENTRIES], steps):
        frame = _frames(folder, columns["stamp_ns"], stamps_ns)
        step, strata = columns["where"]
        frame = np.where(strata == STRATA_WITH_TRUTH.index(stratum), frame, -1)
        ends, of_entries, counts, counts_of_positives = _entries(folder, columns)
        _add_called(frame, step, ends, of_entries, counts, counts_of_positives, bins, called)
    return called


def _frames(folder: Path, stamps: NDArray[np.int64], stamps_ns: NDArray[np.int64]) -> NDArray[np.intp]:
    """Where the stamps of rows (R,) stand among those of the scored frames (F,), which increase."""
    frame = np.searchsorted(stamps_ns, stamps).clip(max=len(stamps_ns) - 1)
    if len(stamps) and not (len(stamps_ns) and (stamps_ns[frame] == stamps).all()):
        raise ScoresError(f"{folder / HISTOGRAM_TABLE.file}: other frames than in {SCORES_TABLE.file}; run it again")
    return frame


def _add(folder: Path, columns: dict[str, Any], units: NDArray[np.int64], total: UnitHistograms) -> None:
    """Add rows (R,) of these `units` to the histograms `total`."""
    step, stratum = columns["where"]
    number_of = np.full(len(STRATA_WITH_TRUTH), -1)
    number_of[[STRATA_WITH_TRUTH.index(name) for name in total.strata]] = np.arange(len(total.strata))
    counted = (units >= 0) & (number_of[stratum] >= 0)
    place = np.where(counted, step * len(total.strata) + number_of[stratum], -1)
    sums = total.p_sum.reshape(-1, CALIBRATION_BINS)
    histogram = units * len(sums) + place
    cells, positives = (counts.reshape(-1, PROBABILITY_BINS) for counts in (total.cells, total.positives))
    ends, bins, counts, counts_of_positives = _entries(folder, columns)
    _add_entries(np.where(counted, histogram, -1), ends, bins, counts, counts_of_positives, cells, positives)
    _add_sums(place, columns["p_sum"], sums)


def _entries(folder: Path, columns: dict[str, Any]) -> tuple[NDArray[np.integer], ...]:
    """Where the entries of each row end (R + 1,), and the bins, cells and positives (N,) of the entries.

    Raises ScoresError for a bin that is none.
    """
    ends = [np.asarray(columns[name].offsets) for name in _ENTRIES]
    ends = [own - own[0] for own in ends]
    bins, cells, positives = (np.asarray(columns[name].flatten()) for name in _ENTRIES)
    alike = all(np.array_equal(own, ends[0]) for own in ends)
    if not alike or bins.min(initial=0) < 0 or bins.max(initial=0) >= PROBABILITY_BINS:
        path = folder / HISTOGRAM_TABLE.file
        raise ScoresError(f"{path}: not histograms of {PROBABILITY_BINS} bins; run it again")
    return ends[0], bins, cells, positives


@numba.njit(cache=True, nogil=True)
def _add_entries(histogram, ends, bins, counts, counts_of_positives, cells, positives):  # type: ignore[no-untyped-def]
    """Add the entries of each row to its `histogram` (R,) of `cells` and `positives` (H, B); -1: to none."""
    for row in range(histogram.size):
        if histogram[row] >= 0:
            for i in range(ends[row], ends[row + 1]):
                cells[histogram[row], bins[i]] += counts[i]
                positives[histogram[row], bins[i]] += counts_of_positives[i]


@numba.njit(cache=True, nogil=True)
def _add_sums(place, p_sum, total):  # type: ignore[no-untyped-def]
    """Add `p_sum` (R, C) of each row to its `place` (R,) in `total` (N, C); -1: to none."""
    for row in range(place.size):
        if place[row] >= 0:
            for c in range(total.shape[1]):
                total[place[row], c] += p_sum[row, c]


@numba.njit(cache=True, nogil=True)
def _add_called(frame, step, ends, bins, counts, counts_of_positives, thresholds, called):  # type: ignore[no-untyped-def]
    """Add the entries at or above each of `thresholds` (T, S) to `called` (T, F, S, 2); a row of frame -1 to none."""
    for row in range(frame.size):
        if frame[row] >= 0:
            for t in range(thresholds.shape[0]):
                for i in range(ends[row], ends[row + 1]):
                    if bins[i] >= thresholds[t, step[row]]:
                        called[t, frame[row], step[row], 0] += counts[i]
                        called[t, frame[row], step[row], 1] += counts_of_positives[i]

"""The files of finished trials as the statistics read them: what was read last is kept, up to a number of bytes."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.scoring.histograms import UnitHistograms, read_unit_histograms
from gridtrack.evaluation.statistics.finished_trial import FinishedTrial
from gridtrack.evaluation.statistics.frame_counts import FrameCounts, read_frame_counts
from gridtrack.evaluation.statistics.jackknife import JackknifedScore
from gridtrack.evaluation.statistics.pr_auc import pr_auc_of_units
from gridtrack.evaluation.statistics.spatial_scores import Ratios, spatial_ratios

KEPT_BYTES = 512 << 20
"""Of counts of frames, and again of histograms. What ten trackers have on thirty recordings of a minute fits; of more
it is read again where it is asked for again, so that memory does not grow with the number of trials."""

_Value = TypeVar("_Value")


@dataclass(frozen=True, slots=True)
class HeadlineSums:
    """Scores of one row at N steps and strata that do not follow from the counts of frames.

    PR-AUC (N,), and the sums (U, N) of the scores that forgive a few cells.
    """

    pr_auc: JackknifedScore
    spatial: Ratios


class TrialFiles:
    """Reads the files of trials. The headline's sums are kept of all trials, the rest of those read last.

    The trials of a row are scored one by one, then together, and then compared.
    """

    def __init__(self) -> None:
        self._frames = _Recent[FrameCounts](lambda frames: frames.counts.nbytes)
        self._histograms = _Recent[UnitHistograms](lambda one: one.cells.nbytes + one.positives.nbytes)
        self._headlines: dict[tuple[object, ...], HeadlineSums] = {}

    def frames(self, trial: FinishedTrial) -> FrameCounts:
        """The counts of a trial at each frame and at every step. Raises ScoresError."""
        return self._frames.of(
            trial.folder.name, lambda: read_frame_counts(trial.folder, trial.record.steps, trial.strata)
        )

    def histograms(
        self,
        trials: Sequence[FinishedTrial],
        stamps_ns: Sequence[NDArray[np.int64]],
        units: Sequence[NDArray[np.int64]],
    ) -> Iterable[UnitHistograms]:
        """The histograms of each trial at every step, of the units from the first to the last of its `units` (F,).

        `stamps_ns` (F,) are the frames that count, some of the scored ones. They are read whenever one goes through
        them, which raises ScoresError.
        """
        return _ReadAgain(lambda: (self._of_units(*one) for one in zip(trials, stamps_ns, units, strict=True)))

    def _of_units(self, trial: FinishedTrial, stamps_ns: NDArray[np.int64], units: NDArray[np.int64]) -> UnitHistograms:
        scored_ns = self.frames(trial).stamps_ns
        of_frame = np.full(len(scored_ns), -1)
        of_frame[np.searchsorted(scored_ns, stamps_ns)] = units - (units.min() if len(units) else 0)
        return self._histograms.of(
            (trial.folder.name, of_frame.tobytes()),
            lambda: read_unit_histograms(trial.folder, trial.record.steps, trial.strata, scored_ns, of_frame),
        )

    def headline_sums(
        self,
        trials: Sequence[FinishedTrial],
        stamps_ns: Sequence[NDArray[np.int64]],
        units: Sequence[NDArray[np.int64]],
        chosen: Sequence[tuple[int, str]],
    ) -> HeadlineSums:
        """The sums of `trials` at the `chosen` steps and strata, over the frames `stamps_ns` (F,) of the `units` (F,).

        Raises ScoresError.
        """
        arrays = tuple(one.tobytes() for one in (*stamps_ns, *units))
        key = tuple(trial.folder.name for trial in trials), arrays, tuple(chosen)
        if key not in self._headlines:
            scored_ns = [self.frames(trial).stamps_ns for trial in trials]
            self._headlines[key] = HeadlineSums(
                pr_auc_of_units(trials, self.histograms(trials, stamps_ns, units), units, chosen),
                spatial_ratios(trials, scored_ns, stamps_ns, units, chosen),
            )
        return self._headlines[key]


class _Recent(Generic[_Value]):
    """Values that were made last, of at most KEPT_BYTES together; `size_of` tells their bytes."""

    def __init__(self, size_of: Callable[[_Value], int]) -> None:
        self._size_of, self._bytes = size_of, 0
        self._values: dict[Hashable, _Value] = {}

    def of(self, key: Hashable, make: Callable[[], _Value]) -> _Value:
        if key not in self._values:
            value = make()
            self._bytes += self._size_of(value)
            while self._values and self._bytes > KEPT_BYTES:
                self._bytes -= self._size_of(self._values.pop(next(iter(self._values))))
            self._values[key] = value
        return self._values[key]


class _ReadAgain(Iterable[_Value]):
    """Items that `read` reads anew whenever they are gone through."""

    def __init__(self, read: Callable[[], Iterator[_Value]]) -> None:
        self._read = read

    def __iter__(self) -> Iterator[_Value]:
        return self._read()

"""The files of finished trials as the statistics read them: each once, as long as the rows are taken one by one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.scoring.histograms import UnitHistograms, read_unit_histograms
from gridtrack.evaluation.statistics.finished_trial import FinishedTrial
from gridtrack.evaluation.statistics.frame_counts import FrameCounts, read_frame_counts
from gridtrack.evaluation.statistics.jackknife import JackknifedScore
from gridtrack.evaluation.statistics.pr_auc import pr_auc_of_units
from gridtrack.evaluation.statistics.spatial_scores import Ratios, spatial_ratios


@dataclass(frozen=True, slots=True)
class HeadlineSums:
    """Scores of one row at N steps and strata that do not follow from the counts of frames.

    PR-AUC (N,), and the sums (U, N) of the scores that forgive a few cells.
    """

    pr_auc: JackknifedScore
    spatial: Ratios


class TrialFiles:
    """Reads the files of trials. The counts of frames and the headline's sums are kept of all trials.

    Histograms are larger: they are kept of the `kept` trials read last, which is one row where `kept` is the number of
    recordings. Its trials are scored one by one, then together, and then compared.
    """

    def __init__(self, kept: int) -> None:
        self._kept = kept
        self._frames: dict[str, FrameCounts] = {}
        self._histograms: dict[tuple[str, bytes], UnitHistograms] = {}
        self._headlines: dict[tuple[object, ...], HeadlineSums] = {}

    def frames(self, trial: FinishedTrial) -> FrameCounts:
        """The counts of a trial at each frame and at every step. Raises ScoresError."""
        key = trial.folder.name
        if key not in self._frames:
            self._frames[key] = read_frame_counts(trial.folder, trial.record.steps, trial.strata)
        return self._frames[key]

    def histograms(
        self, trial: FinishedTrial, stamps_ns: NDArray[np.int64], units: NDArray[np.int64]
    ) -> UnitHistograms:
        """The histograms of a trial at every step, of the units from the first to the last of `units` (F,).

        `stamps_ns` (F,) are the frames that count, some of the scored ones. Raises ScoresError.
        """
        scored_ns = self.frames(trial).stamps_ns
        of_frame = np.full(len(scored_ns), -1)
        of_frame[np.searchsorted(scored_ns, stamps_ns)] = units - (units.min() if len(units) else 0)
        key = trial.folder.name, of_frame.tobytes()
        if key not in self._histograms:
            while len(self._histograms) >= self._kept:
                del self._histograms[next(iter(self._histograms))]
            self._histograms[key] = read_unit_histograms(
                trial.folder, trial.record.steps, trial.strata, scored_ns, of_frame
            )
        return self._histograms[key]

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
            histograms = [self.histograms(*one) for one in zip(trials, stamps_ns, units, strict=True)]
            scored_ns = [self.frames(trial).stamps_ns for trial in trials]
            self._headlines[key] = HeadlineSums(
                pr_auc_of_units(trials, histograms, units, chosen),
                spatial_ratios(trials, scored_ns, stamps_ns, units, chosen),
            )
        return self._headlines[key]

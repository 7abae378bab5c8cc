"""The statistics of a run for its summary: intervals of each trial, recordings pooled, and the paired differences."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.scoring.counting import Tally
from gridtrack.evaluation.scoring.record import TrialRecord
from gridtrack.evaluation.scoring.scores import read_tally
from gridtrack.evaluation.scoring.splits import ORACLE
from gridtrack.evaluation.statistics.curves import curve, curves_of, plain_number
from gridtrack.evaluation.statistics.frame_counts import FrameCounts, read_frame_counts
from gridtrack.evaluation.statistics.pooling import (
    OTHER_RETURNS,
    Comparison,
    Scope,
    common_strata,
    compare_with,
    correct,
    intervals,
    poolable,
)

ALL_RECORDINGS = "all recordings"
P_VALUES = ("f1_p", "nll_per_scan_p", "p_holm")
USUAL_REFERENCE = "persistence"
"""The tracker whose row is the reference unless another is named: what the field compares with."""


@dataclass(frozen=True, slots=True)
class Ended:
    """A trial that has ended: its record, and its folder with what it scored."""

    record: TrialRecord
    folder: Path
    tracker: str
    options: Mapping[str, Any]
    points: str

    @property
    def complete(self) -> bool:
        """Whether every frame that was to be scored was scored."""
        return self.record.outcome == "ok" and 0 < self.record.frames_scored == self.record.frames_expected

    @property
    def strata(self) -> tuple[str, ...]:
        """What it was scored in."""
        return tuple(self.record.thresholds.values)


class Inference:
    """A run's trials under one set of rules: units, common frames, and one family of tests."""

    def __init__(
        self, recordings: Mapping[str, Mapping[str, Any]], trials: Sequence[Ended], reference: str | None = None
    ) -> None:
        """`recordings` as the summary describes them; `reference` the label of a row, else the usual one, if it ran."""
        self._recordings = recordings
        self._trials = [trial for trial in trials if trial.record.recording in recordings]
        self.labels = list(dict.fromkeys(trial.record.label for trial in self._trials))
        self._reference = reference
        self._blocks: dict[str, float] = {}
        self._frames: dict[str, FrameCounts] = {}
        self._tallies: dict[str, Tally] = {}

    @cached_property
    def reference(self) -> str | None:
        """Label of the row that all others are set against: the one asked for, `persistence`, or the first."""
        usual = [t.record.label for t in self._trials if t.tracker == USUAL_REFERENCE]
        ranked = [t.record.label for t in self._trials if t.tracker != ORACLE]
        return self._reference or next(iter(usual + ranked), None)

    @property
    def groups(self) -> list[list[str]]:
        """The recordings that trackers are compared on together: all of them where they are pooled, else each."""
        together = len(self._recordings) > 1 and poolable(self._recordings)
        return [list(self._recordings)] if together else [[name] for name in self._recordings]

    def intervals_of(self, trial: Ended) -> dict[str, dict[str, Any]]:
        """Intervals of every score of one trial, by stratum."""
        name = trial.record.recording
        return _by_stratum(intervals([self.frames_of(trial)], trial.strata, self.block_s([name])))

    def tally_of(self, trial: Ended) -> Tally:
        """Everything that a trial counted, read once. Raises ScoresError."""
        key = trial.folder.name
        if key not in self._tallies:
            self._tallies[key] = read_tally(trial.folder, trial.record.steps, trial.strata)
        return self._tallies[key]

    def pooled(self) -> dict[str, Any] | None:
        """Every tracker over all recordings together, by label; None where there is only one, or they do not add up."""
        if len(self._recordings) < 2 or not poolable(self._recordings):
            return None
        return {label: self._pooled_trial(label) for label in self.labels}

    def differences(self) -> list[dict[str, Any]]:
        """Each tracker against the reference: over all recordings where they are pooled, else on each."""
        found = [
            (names, self._compared(label, names))
            for names in self.groups
            for label in self.labels
            if label != self.reference and self._tracker(label) != ORACLE
        ]
        correct([comparison for _, comparison in found])
        return [self._as_data(names, comparison) for names, comparison in found]

    def _pooled_trial(self, label: str) -> dict[str, Any]:
        trials = [trial for trial in self._trials if trial.record.label == label]
        complete = [trial for trial in trials if trial.complete]
        missing = [f"{t.record.recording}: {t.record.outcome}" for t in trials if not t.complete]
        strata = common_strata([trial.strata for trial in complete]) if complete else ()
        curves: dict[str, dict[str, Any]] = {}
        if complete:
            curves = dict(curves_of([(trial.record, self.tally_of(trial)) for trial in complete], strata))
            frames = [_in(self.frames_of(trial), trial.strata, strata) for trial in complete]
            found = _by_stratum(intervals(frames, strata, self.block_s([t.record.recording for t in complete])))
            curves = {name: {**curves[name], **found[name]} for name in strata}
        whole = len(complete) == len(self._recordings)
        chosen = {trial.record.thresholds.chosen_on for trial in complete}
        return {
            "outcome": "ok" if whole else "partial",
            "reason": ""
            if whole
            else f"{len(complete)} of {len(self._recordings)} recordings complete"
            + (f" ({'; '.join(missing[:3])}{', ...' if len(missing) > 3 else ''})" if missing else ""),
            "recordings_complete": len(complete),
            "recordings_expected": len(self._recordings),
            "frames_scored": sum(trial.record.frames_scored for trial in complete),
            "frames_expected": sum(trial.record.frames_expected for trial in trials),
            "threshold_chosen_on": chosen.pop() if len(chosen) == 1 else "",
            "strata": curves,
        }

    def _compared(self, label: str, names: Sequence[str]) -> Comparison:
        """`label` against the reference on `names`; both must have been scored in full on every one of them."""
        own, others = (self.complete(row, names) for row in (label, self.reference))
        for row, complete in ((self.reference, others), (label, own)):
            if len(complete) < len(names):
                what = f"{len(complete)} of {len(names)} recordings complete" if len(names) > 1 else "not complete"
                return Comparison(label, 0, 0, f"not compared: {row} is {what}" if len(names) == 1 else
                                  f"not compared: {row} has {what}")  # fmt: skip
        if own[0].points != others[0].points:
            return Comparison(label, 0, 0, OTHER_RETURNS)
        scope = self._scope(names, own + others)
        sides = [[_in(self.frames_of(trial), trial.strata, scope.strata) for trial in side] for side in (others, own)]
        return compare_with(sides[0], sides[1], label, scope, self.block_s(names))

    def _as_data(self, names: Sequence[str], comparison: Comparison) -> dict[str, Any]:
        return {
            "recordings": ALL_RECORDINGS if len(names) > 1 else names[0],
            "tracker": comparison.tracker,
            "reference": self.reference,
            "units": comparison.units,
            "frames": comparison.frames,
            "interval": comparison.why_none,
            "strata": {
                name: {key: plain_curve(key, values) for key, values in curves.items()}
                for name, curves in comparison.curves.items()
            },
            "headline": [
                {key: _plain(key, value) if isinstance(value, float) else value for key, value in test.items()}
                for test in comparison.headline
            ],
        }

    def _scope(self, names: Iterable[str], trials: Sequence[Ended]) -> Scope:
        described = [self._recordings[name] for name in names]
        cycles = [cycle for one in described if (cycle := one.get("cycle_s"))]
        return Scope(
            described[0]["horizons_s"], common_strata([trial.strata for trial in trials]), max(cycles, default=None)
        )

    def block_s(self, names: Sequence[str]) -> float:
        """How long blocks are on these recordings: the same for every tracker, so that they can be paired."""
        for name in names:
            if name not in self._blocks:
                scored = [t for t in self._trials if t.record.recording == name and t.record.frames_scored]
                trials = [t for t in scored if t.complete] or scored
                scope = self._scope([name], trials)
                frames = [[_in(self.frames_of(trial), trial.strata, scope.strata)] for trial in trials]
                self._blocks[name] = scope.block_s(frames)
        return max(self._blocks[name] for name in names)

    def complete(self, label: str | None, names: Sequence[str]) -> list[Ended]:
        """The complete trials of one row on these recordings, in their order."""
        found = {t.record.recording: t for t in self._trials if t.record.label == label and t.complete}
        return [found[name] for name in names if name in found]

    def _tracker(self, label: str) -> str:
        return next(trial.tracker for trial in self._trials if trial.record.label == label)

    def frames_of(self, trial: Ended) -> FrameCounts:
        """What a trial counted at each frame, read once. Raises ScoresError."""
        key = trial.folder.name
        if key not in self._frames:
            self._frames[key] = read_frame_counts(trial.folder, trial.record.steps, trial.strata)
        return self._frames[key]


def _in(frames: FrameCounts, own: tuple[str, ...], strata: tuple[str, ...]) -> FrameCounts:
    """What was counted in `strata`, some of the trial's own."""
    if strata == own:
        return frames
    chosen = [own.index(name) for name in strata]
    return FrameCounts(frames.stamps_ns, frames.delivered, frames.counts[:, :, chosen])


def _by_stratum(by_stratum: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    return {
        name: {key: curve(value) if isinstance(value, np.ndarray) else value for key, value in found.items()}
        for name, found in by_stratum.items()
    }


def plain_curve(key: str, values: NDArray[np.float64]) -> list[float | None]:
    """One value per step as JSON has it, by its key in `differences`: a score, an end of its interval or a p-value."""
    return [_plain(key, value) for value in values.tolist()]


def _plain(key: str, value: float) -> float | None:
    """As JSON has it: a p-value to three digits that count, however small it is."""
    if key in P_VALUES and not math.isnan(value):
        return float(f"{value:.3g}")
    return plain_number(value)

"""The finished trials of a run: which rows are compared on which recordings, at which steps, in which units."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from gridtrack.common.grid import nearest_step
from gridtrack.common.notices import Notice
from gridtrack.evaluation.referee.splits import ORACLE
from gridtrack.evaluation.runs.run_record import RecordingDescription
from gridtrack.evaluation.runs.sums import KeptRows, ScoredFrames, TrialSums
from gridtrack.evaluation.runs.trial_record import TrialRecord
from gridtrack.evaluation.scores.definition import LEADING_HORIZONS_S, Ratio
from gridtrack.evaluation.scores.f1 import F1
from gridtrack.evaluation.statistics.units import (
    UnitRule,
    autocorrelation_time,
    enough_sources,
    residuals,
    shortest_block_s,
)
from gridtrack.trackers.contract import ComparedPart

HEADLINE_STRATA = ("in-motion", "dynamic", "visible")
"""Strata of the headline tests: the family of Holm's correction is the headline score in these, at its horizons, for
each tracker."""
DETAIL_HORIZON_S = 1.0
"""The horizon of the scores beside the headline, and of the order of rows."""
POOLED_EVERY_S = 0.5
"""Spacing of the common horizons, seconds: headline horizons are multiples of it."""


@dataclass(frozen=True, slots=True)
class FinishedTrial:
    """A trial that has ended: its record, the folder of its files, its tracker, options and kind of points.

    `chosen_steps`: the steps of its forecasts that are read, in their order; None: all.
    """

    record: TrialRecord
    folder: Path
    tracker: str
    options: Mapping[str, Any]
    points: str
    chosen_steps: tuple[int, ...] | None = None

    @property
    def steps(self) -> list[int]:
        """The steps that are read."""
        return list(range(self.record.steps + 1) if self.chosen_steps is None else self.chosen_steps)

    @property
    def complete(self) -> bool:
        """Whether every forecast was scored."""
        return self.record.complete

    @property
    def comparable(self) -> bool:
        """Whether the trial is complete, and its weights learned from no scored frame."""
        return self.complete and not self.record.leak

    @property
    def strata(self) -> tuple[str, ...]:
        """The strata that it was scored in."""
        return tuple(self.record.thresholds.values)


def common_strata(trials: Sequence[FinishedTrial]) -> tuple[str, ...]:
    """The strata that every trial has, in the order of the first."""
    return tuple(name for name in trials[0].strata if all(name in other.strata for other in trials))


def headline_steps(horizons_s: Sequence[float], at_s: Sequence[float] = LEADING_HORIZONS_S) -> list[tuple[float, int]]:
    """Horizon of the step, and step, of the tests of a score that leads at `at_s`, as far as the run forecasts.

    Each nearest step once.
    """
    period_s = horizons_s[1] - horizons_s[0]
    steps = dict.fromkeys(nearest_step(h, period_s) for h in at_s)
    return [(float(horizons_s[step]), step) for step in steps if 0 < step < len(horizons_s)]


def detail_step(horizons_s: Sequence[float]) -> int:
    """The step of the scores beside the headline: nearest to DETAIL_HORIZON_S, else the first of the headline."""
    steps = sorted(step for _, step in headline_steps(horizons_s)) or [len(horizons_s) - 1]
    detail = nearest_step(DETAIL_HORIZON_S, horizons_s[1] - horizons_s[0])
    return detail if detail in steps else steps[0]


def unlike_most(received: Iterable[tuple[str, Hashable, str]]) -> list[str]:
    """The labels that `received` another digest than most under a condition: (label, condition, digest) of each."""
    received, found = list(received), defaultdict[Hashable, Counter[str]](Counter)
    for _, condition, digest in received:
        found[condition][digest] += 1
    usual = {condition: digests.most_common(1)[0][0] for condition, digests in found.items()}
    return list(dict.fromkeys(label for label, condition, digest in received if digest != usual[condition]))


class RunTrials:
    """The trials of a run: the same units and frames for all rows."""

    def __init__(
        self,
        recordings: Mapping[str, RecordingDescription],
        trials: Sequence[FinishedTrial],
        reference: str | None = None,
    ) -> None:
        """`reference` is the label of a row; None: the tracker that is the reference for occupancy, if it ran."""
        self.recordings = recordings
        self.all = [trial for trial in trials if trial.record.recording in recordings]
        self.labels = list(dict.fromkeys(trial.record.label for trial in self.all))
        self._requested = reference
        self._blocks: dict[str, float] = {}
        self._sums: dict[str, TrialSums] = {}
        self._kept = KeptRows()

    def reference_for(self, part: ComparedPart, among: Iterable[str] | None = None) -> str | None:
        """Label of the row that others are compared with: as requested, by its description, or the first row.

        `among`: the rows that may be it; None: all but the oracle. None if there is none.
        """
        rows = [t for t in self.all if t.tracker != ORACLE]
        labels = list(dict.fromkeys(t.record.label for t in rows)) if among is None else list(among)
        described = [t.record.label for t in rows if part in t.record.reference_for]
        requested = [self._requested] if self._requested else []
        if among is None and requested:
            return requested[0]
        return next((label for label in (*requested, *described, *labels) if label in labels), None)

    def sums(self, trial: FinishedTrial) -> TrialSums:
        """The sums of a trial. Raises ScoresError."""
        key = trial.folder.name
        if key not in self._sums:
            self._sums[key] = TrialSums(trial.folder, self._kept)
        return self._sums[key]

    def forget_rows(self) -> None:
        """Let go of the rows of sums that were read, to keep others."""
        self._kept.clear()

    def frames(self, trial: FinishedTrial) -> ScoredFrames:
        """The scored frames of a trial. Raises ScoresError."""
        return self.sums(trial).frames

    @cached_property
    def mismatched(self) -> dict[str, list[str]]:
        """By recording the labels of the rows that received other frames than most. Raises ScoresError."""
        return {name: self._mismatched_on(name) for name in self.recordings}

    def _mismatched_on(self, recording: str) -> list[str]:
        """Labels of the trials of one recording that were delivered other frames than most at a stamp they share.

        Trials of raw returns are compared among themselves: their frames differ by design.
        """
        frames = ((trial, self.frames(trial)) for trial in self.on(recording) if trial.record.frames_scored)
        return unlike_most(
            (trial.record.label, (trial.points, stamp), digest)
            for trial, own in frames
            for stamp, digest in zip(own.stamps_ns.tolist(), own.delivered.tolist(), strict=True)
        )

    def on(self, recording: str) -> list[FinishedTrial]:
        """The trials of one recording."""
        return [trial for trial in self.all if trial.record.recording == recording]

    def of(self, label: str | None, names: Sequence[str]) -> list[FinishedTrial]:
        """All trials of one row on these recordings."""
        return [trial for trial in self.all if trial.record.label == label and trial.record.recording in names]

    def comparable(self, label: str | None, names: Sequence[str]) -> list[FinishedTrial]:
        """The comparable trials of one row on these recordings, in their order; of several at common horizons."""
        found = {trial.record.recording: trial for trial in self.of(label, names) if trial.comparable}
        trials = [found[name] for name in names if name in found and label not in self.mismatched[name]]
        return self.together(trials) if len(names) > 1 else trials

    def why_not_compared(self, label: str | None, names: Sequence[str]) -> str:
        """Why the row is not comparable on all of these recordings; empty if it is."""
        trials = self.of(label, names)
        complete = sum(trial.complete for trial in trials)
        if complete < len(names):
            return f"{label} {f'has {complete} of {len(names)} recordings' if len(names) > 1 else 'is not'} complete"
        if other := [name for name in names if label in self.mismatched[name]]:
            return f"{label} was delivered other frames than the rest on {other[0]}"
        return f"{label} learned from frames that it is scored on" if any(t.record.leak for t in trials) else ""

    @property
    def pools(self) -> bool:
        """Whether the scores of the recordings are pooled: there are several, with horizons in common."""
        return len(self.recordings) > 1 and bool(self.horizons_s)

    @cached_property
    def horizons_s(self) -> tuple[float, ...]:
        """The horizons of the pooled scores, seconds; empty if the recordings have none in common."""
        return common_horizons(self.recordings.values())

    def horizons_of(self, names: Sequence[str]) -> tuple[float, ...]:
        """The horizons of the scores on one recording, or on several together, seconds."""
        return self.recordings[names[0]].horizons_s if len(names) == 1 else self.horizons_s

    def together(self, trials: Iterable[FinishedTrial]) -> list[FinishedTrial]:
        """`trials` with their steps at the horizons of the pooled scores only."""
        return [
            replace(trial, chosen_steps=steps_at(self.horizons_s, self.recordings[trial.record.recording]))
            for trial in trials
        ]

    @property
    def groups(self) -> list[list[str]]:
        """The recordings that trackers are compared on together: all of them if they are pooled, else each."""
        return [list(self.recordings)] if self.pools else [[name] for name in self.recordings]

    def unit_rule(self, names: Sequence[str], among: Sequence[str] | None = None) -> UnitRule:
        """How the frames of these recordings become units: the same for every tracker, so that they are paired.

        `among`: the recordings that decide the length of blocks, if these are some of them only.
        """
        among = names if among is None else among
        enough = enough_sources([self._source(name) for name in among])
        return UnitRule(tuple(map(self._source, names)), None if enough else self._block_s(among))

    def _source(self, name: str) -> str:
        return self.recordings[name].source_sha256 or name

    def _block_s(self, names: Sequence[str]) -> float:
        """Length of the blocks on these recordings, seconds: the longest of theirs."""
        for name in names:
            if name not in self._blocks:
                self._blocks[name] = self._block_of(name)
        return max(self._blocks[name] for name in names)

    def _block_of(self, name: str) -> float:
        """Length of the blocks on one recording, seconds, for the longest autocorrelation time of F1 of any of its
        trials; 0 where no frame was scored.
        """
        scored = [trial for trial in self.on(name) if trial.record.frames_scored]
        if not scored:
            return 0.0
        trials = [trial for trial in scored if trial.complete] or scored
        horizons_s = self.recordings[name].horizons_s
        steps = sorted({step for _, step in headline_steps(horizons_s)}) or [len(horizons_s) - 1]
        correlated_s = max(self._correlated_s(trial, steps, common_strata(trials)) for trial in trials)
        return shortest_block_s(correlated_s, self.recordings[name].cycle_s)

    def _correlated_s(self, trial: FinishedTrial, steps: Sequence[int], strata: Sequence[str]) -> float:
        """The autocorrelation time, seconds, of F1 of a trial at these steps in any stratum."""
        stamps_ns = self.frames(trial).stamps_ns
        if len(stamps_ns) < 2:
            return 0.0
        spacing_s = float(np.median(np.diff(stamps_ns))) / 1e9
        sums = self.sums(trial)
        found = F1.value(sums.by_frame(F1.name, steps, strata, sums.layouts[F1.name].parts))[F1.lead.name]
        assert isinstance(found, Ratio)
        return spacing_s * autocorrelation_time(residuals(found.part, found.whole))


def common_horizons(recordings: Iterable[RecordingDescription]) -> tuple[float, ...]:
    """The horizons, seconds, of the scores of `recordings` together, 0 first; empty if they have none in common.

    Recordings of one period and horizon share their steps. Else a step is another time in each, and the counts are
    added up at horizons in seconds: the multiples of POOLED_EVERY_S that every one reaches, each by the nearest step of
    a recording. A period above POOLED_EVERY_S has no step for each of these.
    """
    described = list(recordings)
    if all(one.horizons_s == other.horizons_s for one, other in pairwise(described)):
        return described[0].horizons_s
    if any(one.period_s > POOLED_EVERY_S for one in described):
        return ()
    reached = min(_reached(one) for one in described)
    return tuple(k * POOLED_EVERY_S for k in range(reached + 1)) if reached else ()


def _reached(described: RecordingDescription) -> int:
    """How many multiples of POOLED_EVERY_S lie nearest to one of the steps of a recording."""
    steps, reached = len(described.horizons_s) - 1, 0
    while nearest_step((reached + 1) * POOLED_EVERY_S, described.period_s) <= steps:
        reached += 1
    return reached


def steps_at(horizons_s: Sequence[float], described: RecordingDescription) -> tuple[int, ...]:
    """The steps of a recording that are nearest to these horizons, which increase."""
    if tuple(horizons_s) == described.horizons_s:
        return tuple(range(len(horizons_s)))
    return tuple(nearest_step(horizon_s, described.period_s) for horizon_s in horizons_s)


def unlike_recordings(recordings: Mapping[str, RecordingDescription]) -> list[Notice]:
    """Notices of differences among pooled recordings."""
    described = list(recordings.values())
    texts, horizons_s = [], common_horizons(described)
    if any(one.horizons_s != horizons_s for one in described):
        off_s = max(_off_s(horizons_s, one) for one in described)
        texts.append(
            "the recordings differ in rate or horizon: scores over all of them are given every"
            f" {POOLED_EVERY_S:g} s; of each recording the nearest step counts, at most {off_s * 1000:.0f} ms away"
        )
    if len({one.grid.partition("@")[0].partition("x")[2] for one in described}) > 1:
        texts.append("the recordings differ in the size of their cells: together every cell counts as one")
    return [Notice(text=text) for text in texts]


def _off_s(horizons_s: Sequence[float], described: RecordingDescription) -> float:
    """The largest distance, seconds, from one of these horizons to its step in a recording."""
    steps = steps_at(horizons_s, described)
    return max(abs(described.horizons_s[step] - h) for h, step in zip(horizons_s, steps, strict=True))

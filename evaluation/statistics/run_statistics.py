"""The statistics of a run: intervals of each trial, recordings pooled, and paired differences from a reference."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

from gridtrack.evaluation.results.recording import RecordingDescription
from gridtrack.evaluation.results.summary import (
    ALL_RECORDINGS,
    ORACLE,
    DifferenceCurves,
    HeadlineTest,
    TrackerDifference,
)
from gridtrack.evaluation.results.trial_summary import PooledSummary, StratumScores
from gridtrack.evaluation.results.values import rounded_curve, rounded_p_curve
from gridtrack.evaluation.scoring.histograms import UnitHistograms
from gridtrack.evaluation.scoring.score_store import read_label_free, read_losses
from gridtrack.evaluation.statistics.curves import CountedTrial, stratum_scores
from gridtrack.evaluation.statistics.finished_trial import FinishedTrial, trials_on
from gridtrack.evaluation.statistics.frame_counts import FrameCounts
from gridtrack.evaluation.statistics.optional_scores import optional_scores
from gridtrack.evaluation.statistics.paired_tests import (
    OTHER_RETURNS,
    ComparedRow,
    TrackerComparison,
    compare_with,
    headline_tests,
)
from gridtrack.evaluation.statistics.parity import mismatched_deliveries
from gridtrack.evaluation.statistics.pooled_horizons import common_horizons, steps_at
from gridtrack.evaluation.statistics.score_intervals import Scope, common_strata, intervals
from gridtrack.evaluation.statistics.spatial_scores import spatial_scores
from gridtrack.evaluation.statistics.trial_files import TrialFiles
from gridtrack.evaluation.statistics.units import UnitRule, enough_sources


class RunStatistics:
    """Statistics of the trials of a run: the same units and frames for all trackers, and one family of tests."""

    def __init__(
        self,
        recordings: Mapping[str, RecordingDescription],
        trials: Sequence[FinishedTrial],
        reference: str | None = None,
    ) -> None:
        """`reference` is the label of a row; None: the tracker that is the reference for occupancy, if it ran."""
        self.recordings = recordings
        self._trials = [trial for trial in trials if trial.record.recording in recordings]
        self.labels = list(dict.fromkeys(trial.record.label for trial in self._trials))
        self._reference = reference
        self._blocks: dict[str, float] = {}
        self._comparisons: dict[str, list[TrackerComparison]] = {}
        self.files = TrialFiles()

    @cached_property
    def reference(self) -> str | None:
        """Label of the row that all others are compared with: as requested, by its description, or the first row."""
        described = [t.record.label for t in self._trials if "occupancy" in t.record.reference_for]
        ranked = [t.record.label for t in self._trials if t.tracker != ORACLE]
        return self._reference or next(iter(described + ranked), None)

    @cached_property
    def mismatched(self) -> dict[str, list[str]]:
        """By recording the labels of the rows that received other frames than most. Raises ScoresError."""
        return {name: mismatched_deliveries(trials_on(name, self._trials), self.files) for name in self.recordings}

    @property
    def pools(self) -> bool:
        """Whether the scores of the recordings are pooled: there are several, with horizons in common."""
        return len(self.recordings) > 1 and bool(self.horizons_s)

    @cached_property
    def horizons_s(self) -> tuple[float, ...]:
        """The horizons of the pooled scores, seconds; empty where the recordings have none in common."""
        return common_horizons(self.recordings.values())

    def together(self, trials: Iterable[FinishedTrial]) -> list[FinishedTrial]:
        """`trials` with their steps at the horizons of the pooled scores only."""
        return [
            replace(trial, chosen_steps=steps_at(self.horizons_s, self.recordings[trial.record.recording]))
            for trial in trials
        ]

    @property
    def groups(self) -> list[list[str]]:
        """The recordings that trackers are compared on together: all of them where they are pooled, else each."""
        return [list(self.recordings)] if self.pools else [[name] for name in self.recordings]

    def strata_of(self, trial: FinishedTrial) -> dict[str, StratumScores]:
        """Scores of one trial with their intervals, by stratum; empty where nothing was scored."""
        if not trial.record.frames_scored:
            return {}
        return self._scores_of([trial], trial.strata, self.unit_rule([trial.record.recording]))

    def _scores_of(
        self, trials: Sequence[FinishedTrial], strata: tuple[str, ...], rule: UnitRule
    ) -> dict[str, StratumScores]:
        """Scores of `trials` pooled, with their intervals over the units of `rule`, by stratum."""
        frames = [self.frames_in(trial, strata) for trial in trials]
        stamps_ns = [one.stamps_ns for one in frames]
        histograms = self.files.histograms(trials, stamps_ns, rule.units_of(stamps_ns))
        ends = intervals(frames, trials, histograms, strata, rule)
        spatial = spatial_scores(trials, stamps_ns, strata, rule)
        optional = optional_scores(trials, stamps_ns, strata, rule)
        described = {name: {**ends[name], **spatial[name], **optional[name]} for name in strata}
        counted = (_counted(trial, own) for trial, own in zip(trials, histograms, strict=True))
        return stratum_scores(counted, len(trials[0].steps), strata, described)

    def differences(self) -> list[TrackerDifference]:
        """Each tracker against the reference: over all recordings where they are pooled, else on each."""
        found = [
            (names, comparison)
            for i, names in enumerate(self.groups)
            for label in self.labels
            for comparison in self.comparisons(label)[i : i + 1]
        ]
        tests = headline_tests([comparison for _, comparison in found])
        return [self._difference(names, one, of_it) for (names, one), of_it in zip(found, tests, strict=True)]

    def comparisons(self, label: str) -> list[TrackerComparison]:
        """A row against the reference on each of `groups`; none of the reference and the oracle. Raises ScoresError."""
        if label == self.reference or self._tracker(label) == ORACLE:
            return []
        if label not in self._comparisons:
            self._comparisons[label] = [self._compared(label, names) for names in self.groups]
        return self._comparisons[label]

    def pooled(self, label: str) -> PooledSummary:
        """One tracker over all recordings together, of those that it completed."""
        trials = [trial for trial in self._trials if trial.record.label == label]
        complete = self.together(trial for trial in trials if trial.complete)
        chosen = {trial.record.thresholds.chosen_on for trial in complete}
        whole = len(complete) == len(self.recordings)
        return PooledSummary(
            outcome="ok" if whole else "partial",
            reason="" if whole else self._why_partial(trials),
            recordings_complete=len(complete),
            recordings_expected=len(self.recordings),
            frames_scored=sum(trial.record.frames_scored for trial in complete),
            frames_expected=sum(trial.record.frames_expected for trial in trials),
            threshold_chosen_on=chosen.pop() if len(chosen) == 1 else "",
            strata=self._strata_together(complete) if complete else {},
        )

    def _strata_together(self, trials: Sequence[FinishedTrial]) -> dict[str, StratumScores]:
        """Scores of some recordings pooled: in the units of all, also where the one with the longest blocks is not in
        them."""
        rule = self.unit_rule([trial.record.recording for trial in trials], list(self.recordings))
        return self._scores_of(trials, common_strata([trial.strata for trial in trials]), rule)

    def _why_partial(self, trials: Sequence[FinishedTrial]) -> str:
        missing = [f"{trial.record.recording}: {trial.record.outcome}" for trial in trials if not trial.complete]
        complete = f"{len(trials) - len(missing)} of {len(self.recordings)} recordings complete"
        shown = "; ".join(missing[:3]) + (", ..." if len(missing) > 3 else "")
        return f"{complete} ({shown})" if missing else complete

    def _compared(self, label: str, names: Sequence[str]) -> TrackerComparison:
        """`label` against the reference on `names`; both must be comparable on every one of them."""
        why = self._why_not_compared(self.reference, names) or self._why_not_compared(label, names)
        if why:
            return TrackerComparison(label, 0, 0, f"not compared: {why}")
        own, others = (self.comparable(row, names) for row in (label, self.reference))
        if own[0].points != others[0].points:
            return TrackerComparison(label, 0, 0, OTHER_RETURNS)
        scope = self.scope(names, own + others)
        theirs, mine = (
            ComparedRow([self.frames_in(trial, scope.strata) for trial in side], side) for side in (others, own)
        )
        return compare_with(theirs, mine, label, scope, self.unit_rule(names), self.files)

    def _difference(
        self, names: Sequence[str], comparison: TrackerComparison, tests: tuple[HeadlineTest, ...]
    ) -> TrackerDifference:
        assert self.reference is not None
        return TrackerDifference(
            recordings=ALL_RECORDINGS if len(names) > 1 else names[0],
            tracker=comparison.tracker,
            reference=self.reference,
            units=comparison.units,
            frames=comparison.frames,
            interval=comparison.why_none,
            strata={
                name: DifferenceCurves(
                    f1=rounded_curve(found.value),
                    f1_low=rounded_curve(found.low),
                    f1_high=rounded_curve(found.high),
                    f1_p=rounded_p_curve(found.p),
                )
                for name, found in comparison.curves.items()
            },
            headline=tests,
        )

    def scope(self, names: Iterable[str], trials: Sequence[FinishedTrial]) -> Scope:
        """The recordings `names` with the strata that all `trials` have."""
        names = list(names)
        described = [self.recordings[name] for name in names]
        cycles = [one.cycle_s for one in described if one.cycle_s]
        strata = common_strata([trial.strata for trial in trials])
        return Scope(self.horizons_of(names), strata, max(cycles, default=None))

    def horizons_of(self, names: Sequence[str]) -> tuple[float, ...]:
        """The horizons of the scores on one recording, or on several together, seconds."""
        return self.recordings[names[0]].horizons_s if len(names) == 1 else self.horizons_s

    def unit_rule(self, names: Sequence[str], among: Sequence[str] | None = None) -> UnitRule:
        """How the frames of these recordings become units: the same for every tracker, so that they are paired.

        `among`: the recordings whose units they are, if these are some of them only.
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
        """Length of the blocks on one recording, seconds; 0 where no frame was scored."""
        scored = [trial for trial in trials_on(name, self._trials) if trial.record.frames_scored]
        if not scored:
            return 0.0
        trials = [trial for trial in scored if trial.complete] or scored
        scope = self.scope([name], trials)
        return scope.block_s([self.frames_in(trial, scope.strata) for trial in trials])

    def _why_not_compared(self, label: str | None, names: Sequence[str]) -> str:
        """Why the row is not comparable on all of these recordings; empty where it is."""
        trials = self.trials_of(label, names)
        complete = sum(trial.complete for trial in trials)
        if complete < len(names):
            return f"{label} {f'has {complete} of {len(names)} recordings' if len(names) > 1 else 'is not'} complete"
        if other := [name for name in names if label in self.mismatched[name]]:
            return f"{label} was delivered other frames than the rest on {other[0]}"
        return f"{label} learned from frames that it is scored on" if any(t.record.leak for t in trials) else ""

    def trials_of(self, label: str | None, names: Sequence[str]) -> list[FinishedTrial]:
        """All trials of one row on these recordings."""
        return [trial for trial in self._trials if trial.record.label == label and trial.record.recording in names]

    def comparable(self, label: str | None, names: Sequence[str]) -> list[FinishedTrial]:
        """The comparable trials of one row on these recordings, in their order; of several at common horizons."""
        found = {trial.record.recording: trial for trial in self.trials_of(label, names) if trial.comparable}
        trials = [found[name] for name in names if name in found and label not in self.mismatched[name]]
        return self.together(trials) if len(names) > 1 else trials

    def _tracker(self, label: str) -> str:
        return next(trial.tracker for trial in self._trials if trial.record.label == label)

    def frames_of(self, trial: FinishedTrial) -> FrameCounts:
        """The counts of a trial at each frame and at every step, read once. Raises ScoresError."""
        return self.files.frames(trial)

    def frames_in(self, trial: FinishedTrial, strata: tuple[str, ...]) -> FrameCounts:
        """The counts of a trial at each frame and its steps in `strata`, some of its own. Raises ScoresError."""
        frames = self.frames_of(trial).of_steps(trial)
        if strata == trial.strata:
            return frames
        chosen = [trial.strata.index(name) for name in strata]
        return FrameCounts(frames.stamps_ns, frames.delivered, frames.counts[:, :, chosen])


def _counted(trial: FinishedTrial, histograms: UnitHistograms) -> CountedTrial:
    """The counts of a trial at its steps. Raises ScoresError."""
    steps, strata = trial.record.steps, trial.strata
    tally = histograms.tally(*read_losses(trial.folder, steps, strata)).at(trial.steps)
    return CountedTrial(trial.record, trial.steps, tally, read_label_free(trial.folder, steps, strata)[trial.steps])

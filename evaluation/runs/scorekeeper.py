"""The scorekeeper: counts every score of each forecast of a trial when its last frame is observed."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Self

from gridtrack.evaluation.referee.referee import ScoredForecast
from gridtrack.evaluation.referee.samples import SAMPLES, SampleWriter, kept_forecasts
from gridtrack.evaluation.referee.splits import EvaluationSplit
from gridtrack.evaluation.runs.sums import SUMS_FILE, Layout, SumsWriter
from gridtrack.evaluation.scores.contact_foresight import robots_of
from gridtrack.evaluation.scores.definition import ScoreDefinition, TrialFacts
from gridtrack.evaluation.scores.robot import Robot
from gridtrack.evaluation.scores.thresholds import Thresholds

SCORE_FILES = (SUMS_FILE, SAMPLES)
"""Files of the scores of a trial."""


def facts_of(
    split: EvaluationSplit, thresholds: Thresholds, robot: Robot, tracker_classes: Sequence[str] = ()
) -> TrialFacts:
    """The facts of a trial on `split` of a tracker with these classes."""
    return TrialFacts(
        cell_m=split.test.grid.cell_m,
        steps=split.steps,
        strata=thresholds.strata,
        thresholds=thresholds,
        classes=tuple(split.test.classes),
        tracker_classes=tuple(tracker_classes),
        has_truth=split.test.has_truth,
        has_people=split.test.has_people,
        period_s=split.test.period_s,
        robot=robot,
    )


class Counter:
    """Counts the scores of the forecasts of one trial, in their order."""

    def __init__(self, scores: Sequence[ScoreDefinition], facts: TrialFacts) -> None:
        self._facts = facts
        self._scores = [score for score in scores if score.strata(facts)]
        self._memories: dict[str, Any] = {score.name: score.new_memory(facts) for score in self._scores}

    @property
    def layouts(self) -> dict[str, Layout]:
        """Strata, parts and steps of each score that applies to the trial."""
        facts = self._facts
        return {one.name: Layout(one.strata(facts), one.parts(facts), one.steps(facts)) for one in self._scores}

    def count(self, forecast: ScoredForecast) -> dict[str, Any]:
        """The sums (S, K, P) of each score that the forecast has something to count for."""
        counted = {s.name: s.count(forecast, self._facts, self._memories[s.name]) for s in self._scores}
        return {name: sums for name, sums in counted.items() if sums is not None}


class Scorekeeper:
    """A context manager; on exit, also by an error, the sums so far are a complete file."""

    def __init__(
        self, folder: Path, split: EvaluationSplit, facts: TrialFacts, scores: Sequence[ScoreDefinition]
    ) -> None:
        self._counter, self._facts, self._origin = Counter(scores, facts), facts, split.test.grid.origin
        self._kept = kept_forecasts(split.schedule)
        self.scored = 0
        with ExitStack() as files:
            self._sums = files.enter_context(SumsWriter(folder, self._counter.layouts, split.steps))
            samples = SampleWriter(folder / SAMPLES, split.test.grid, split.test.period_s, split.steps)
            self._samples = files.enter_context(samples)
            self._files = files.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: Any) -> None:
        self._files.__exit__(*error)

    def add(self, forecast: ScoredForecast, delivered: str) -> None:
        """Score one forecast; `delivered` is the digest of the frames delivered up to its last step."""
        for score, sums in self._counter.count(forecast).items():
            self._sums.add(forecast.stamp_ns, delivered, score, sums)
        if self.scored in self._kept:
            self._samples.add(forecast, robots_of(forecast, self._facts, self._origin))
        self.scored += 1

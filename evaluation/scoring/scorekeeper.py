"""The scorekeeper: writes the score of each forecast of a trial when its last frame is observed."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Self

from gridtrack.evaluation.results.columns import SCORE_TABLES
from gridtrack.evaluation.scoring.beam_errors import beam_errors
from gridtrack.evaluation.scoring.class_store import ClassWriter
from gridtrack.evaluation.scoring.counting import count_forecast
from gridtrack.evaluation.scoring.energy import energy_terms
from gridtrack.evaluation.scoring.energy_store import EnergyWriter
from gridtrack.evaluation.scoring.flow_store import FlowWriter
from gridtrack.evaluation.scoring.neighbourhoods import sum_neighbourhoods
from gridtrack.evaluation.scoring.referee import ScoredForecast
from gridtrack.evaluation.scoring.samples import SAMPLES, SampleWriter, kept_forecasts
from gridtrack.evaluation.scoring.score_store import ScoreWriter
from gridtrack.evaluation.scoring.semantics import count_classes, count_found, match_classes
from gridtrack.evaluation.scoring.spatial_store import SpatialWriter
from gridtrack.evaluation.scoring.splits import EvaluationSplit
from gridtrack.evaluation.scoring.strata import OCCLUDED
from gridtrack.evaluation.scoring.thresholds import Thresholds

SCORE_FILES = (*(table.file for table in SCORE_TABLES), SAMPLES)
"""Files of a trial's scores; classes only where the recording has classes, semantics, flow and energy where the
tracker has them."""


class Scorekeeper:
    """A context manager; on exit, also by an error, the scores so far are complete files."""

    def __init__(
        self,
        folder: Path,
        split: EvaluationSplit,
        thresholds: Thresholds,
        classes: tuple[str, ...],
    ) -> None:
        """`classes` are those for which the tracker forecasts probabilities."""
        known = split.test.classes
        self._thresholds, self._classes, self._cell_m = thresholds, len(known), split.test.grid.cell_m
        self._matching = match_classes(classes, known) if classes and known else None
        self._kept = kept_forecasts(split.schedule)
        self.scored = 0
        with ExitStack() as files:
            self._scores = files.enter_context(ScoreWriter(folder, split.steps, thresholds))
            self._spatial = files.enter_context(SpatialWriter(folder, split.steps, thresholds.strata))
            self._energy = files.enter_context(EnergyWriter(folder, split.steps))
            flow = FlowWriter(folder, split.steps) if OCCLUDED in thresholds.strata else None
            self._flow = flow and files.enter_context(flow)
            by_class = ClassWriter(folder, known, self._matching is not None) if known else None
            self._by_class = by_class and files.enter_context(by_class)
            samples = SampleWriter(folder / SAMPLES, split.test.grid, split.test.period_s, split.steps)
            self._samples = files.enter_context(samples)
            self._files = files.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._files.__exit__(kind, error, trace)

    def add(self, scored: ScoredForecast, delivered: str) -> None:
        """Score one forecast; `delivered` is the digest of the frames delivered up to its last step."""
        occupancy, targets, maps = scored.forecast.occupancy, scored.targets, scored.region_maps
        tally = count_forecast(occupancy, targets, maps, scored.ages)
        sums = sum_neighbourhoods(occupancy, targets, maps, scored.ages)
        errors = beam_errors(occupancy, targets, maps, self._cell_m)
        self._scores.add(scored.stamp_ns, delivered, tally, scored.frames[-1].stamp_ns)
        self._spatial.add(scored.stamp_ns, sums, errors)
        futures = scored.forecast.futures
        if futures is not None:
            self._energy.add(scored.stamp_ns, energy_terms(futures, targets, maps, scored.ages))
        if self._flow is not None:
            self._flow.add(scored)
        if self._by_class is not None:
            self._count_classes(scored, self._by_class)
        if self.scored in self._kept:
            self._samples.add(scored)
        self.scored += 1

    def _count_classes(self, scored: ScoredForecast, writer: ClassWriter) -> None:
        forecast, targets = scored.forecast, scored.targets
        kinds = scored.region_maps.cell_kinds
        found = count_found(forecast.occupancy, targets, kinds, self._thresholds, self._classes)
        writer.add_found(scored.stamp_ns, found)
        if self._matching is not None and forecast.semantics is not None:
            writer.add_semantics(scored.stamp_ns, *count_classes(forecast.semantics, targets, self._matching))

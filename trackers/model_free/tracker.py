"""The model-free pipeline behind the plugin contract; a subclass for each estimator registers as a tracker."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.config import Settings
from gridtrack.common.grid import GridFrame
from gridtrack.trackers.contract import FitTask, Forecast, StreamSpec, TrackedObject
from gridtrack.trackers.model_free.arrays import Array
from gridtrack.trackers.model_free.background import BackgroundMap, without_map
from gridtrack.trackers.model_free.classes import ClassFilter, ClassModel, compile_densities
from gridtrack.trackers.model_free.estimators import MotionEstimator
from gridtrack.trackers.model_free.forecast import compile_flow, flow_of, objects
from gridtrack.trackers.model_free.motion import MotionModel
from gridtrack.trackers.model_free.pipeline import Pipeline, compile_pipeline
from gridtrack.trackers.model_free.residence import residence_of
from gridtrack.trackers.model_free.settings import ModelFreeSettings, PipelineSettings
from gridtrack.trackers.model_free.tracks import Track, Window
from gridtrack.trackers.training.calibration import CalibratedTracker
from gridtrack.trackers.training.weights import cell_probabilities


class ModelFreeTracker(CalibratedTracker):
    """Tracks of clusters against a fitted background, with one motion estimator each.

    The weights are the background map, the life table of returns, the calibration of the probabilities, the tuned
    settings (a given option has precedence) and, if they have classes, a model of the features of each class. The
    `objects` of a forecast are the confirmed tracks.
    """

    Options: ClassVar[type[Settings]] = ModelFreeSettings
    estimator: ClassVar[staticmethod[[Array, Array, MotionModel], MotionEstimator]]
    """Makes the motion estimator of a track: the only difference between the subclasses."""

    def __init__(self, stream: StreamSpec, options: PipelineSettings) -> None:
        """Raises WeightsError without a fitted background for the stream's site, grid and period."""
        super().__init__(stream, options)
        weights = self._weights
        self._background = BackgroundMap(
            *(cell_probabilities(weights, name, stream.grid) for name in BackgroundMap._fields)
        )
        self._residence = residence_of(weights, stream.period_s)
        self.classes = weights.card.classes
        self._model = ClassModel.of(weights, stream.grid) if self.classes else None
        if self._settings.background == "none":
            self._background = without_map(self._background)
            self._model = self._model and self._model.without_site()
        compile_pipeline(stream.period_s, self._residence, self._settings, type(self).estimator)
        if stream.velocity_scored:
            compile_flow()
        if self._model is not None:
            compile_densities(self._model)
        self.reset(seed=0)

    def reset(self, seed: int) -> None:
        """Delete every track and its class evidence; the pipeline has no randomness."""
        stream = self.stream
        self._pipeline = Pipeline(
            stream.grid,
            stream.period_s,
            self._background,
            self._residence,
            self._settings,
            type(self).estimator,
            self._world_T_map,
        )
        self._filter = None if self._model is None else ClassFilter(self._model, stream.grid, self._world_T_map)

    def update(self, frame: GridFrame) -> None:
        """Update the state with frame x_t."""
        self._pipeline.update(frame)
        if self._filter is not None:
            self._filter.observe(self.tracks, frame, self.window)

    @property
    def tracks(self) -> Sequence[Track]:
        """The tracks after the last update."""
        return self._pipeline.tracks

    @property
    def window(self) -> Window:
        """The window after the last update, in the fixed frame of the tracks."""
        return self._pipeline.window

    @property
    def hidden_s(self) -> NDArray[np.float32]:
        """Time since each cell (M, M) was last seen, seconds; infinite if never."""
        return self._pipeline.background.hidden_s

    def predict(self, steps: int) -> Forecast:
        """Forecast steps 0..steps."""
        tracks = self.tracks
        if self._filter is None:
            occupancy = self._pipeline.forecast(steps)
            return Forecast(self._calibrated(occupancy), velocity=self._flow(steps), objects=self._objects())
        kinds = self._filter.posteriors(tracks)
        occupancy, semantics = self._pipeline.forecast_classes(steps, self._filter.cell_prior, kinds)
        labels = {track.identity: self.classes[kind.argmax()] for track, kind in zip(tracks, kinds, strict=True)}
        labelled = tuple(replace(one, label=labels[one.track]) for one in self._objects())
        return Forecast(self._calibrated(occupancy), semantics, self._flow(steps), labelled)

    def _flow(self, steps: int) -> NDArray[np.float16] | None:
        if not self.stream.velocity_scored:
            return None
        return flow_of(self.tracks, steps, self._pipeline.regimes.models[0], self.window.fixed_grid)

    def _objects(self) -> tuple[TrackedObject, ...]:
        return objects(self.tracks, self.window)

    def _calibrated(self, occupancy: NDArray[np.float32]) -> NDArray[np.float32]:
        """The forecast of the pipeline (n+1, M, M), calibrated in place."""
        self._calibration.apply(occupancy, self.hidden_s)
        return occupancy

    @property
    def recoveries(self) -> int:
        """Number of re-initialisations of estimators since `reset`, after numerical failures and divergences."""
        return self._pipeline.restarts

    @classmethod
    def starts_from_general(cls, options: ModelFreeSettings) -> bool:
        """The search starts from the settings of the general weights, except for classes, which need the site's."""
        return options.stage != "classes"

    @classmethod
    def fit(cls, task: FitTask) -> None:
        """Fit the background map and tune the settings on `task.train`; with labels, then fit the features of the
        tracks of each class to a few labelled scans."""
        from gridtrack.trackers.model_free.training import draw_scans, fit_classes, fit_pipeline

        labelled = draw_scans(task)
        if task.options.stage != "classes":
            fit_pipeline(cls, task)
        if labelled is not None:
            fit_classes(cls, labelled, task)

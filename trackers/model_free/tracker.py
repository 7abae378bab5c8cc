"""The `kalman` and `factor-graph` trackers: one model-free pipeline, two estimators, behind the plugin contract."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

from gridtrack.common.config import Settings
from gridtrack.common.grid import GridFrame
from gridtrack.trackers.contract import FitOutput, Forecast, FrameSource, Score, StreamSpec, Tracker
from gridtrack.trackers.model_free.background import BackgroundMap, unknown_place
from gridtrack.trackers.model_free.dwell import table_shape
from gridtrack.trackers.model_free.forecast import objects
from gridtrack.trackers.model_free.motion import FactorGraphEstimator, KalmanEstimator, MotionEstimator, MotionModel
from gridtrack.trackers.model_free.pipeline import Array, Pipeline, compile_ahead
from gridtrack.trackers.model_free.settings import PipelineSettings
from gridtrack.trackers.weights import array, load_weights, tuned_settings


class ModelFreeTracker(Tracker):
    """Clusters before a fitted background, the motion of each estimated for itself.

    Its weights are the background map, the life table of returns and the tuned settings; an option that is given goes
    before the tuned one. The forecast's `objects` are the confirmed tracks.
    """

    Options: ClassVar[type[Settings]] = PipelineSettings
    learns: ClassVar[bool] = True
    name: ClassVar[str]
    """What it is registered as."""
    estimator: ClassVar[staticmethod[[Array, Array, MotionModel], MotionEstimator]]
    """What estimates the motion of a track; the only thing in which the subclasses differ."""

    def __init__(self, stream: StreamSpec, options: PipelineSettings) -> None:
        """Raises WeightsError without a fitted background for the stream's site, grid and period."""
        super().__init__(stream, options)
        weights = load_weights(stream, self.name)
        self._settings = tuned_settings(PipelineSettings, weights, options)
        fitted = BackgroundMap(*(array(weights, name, stream.grid.shape) for name in BackgroundMap._fields))
        self._background = fitted if self._settings.background == "fitted" else unknown_place(fitted)
        self._dwell = array(weights, "dwell", table_shape(stream.period_s))
        compile_ahead(stream.period_s, self._dwell, self._settings, type(self).estimator)
        self.reset(seed=0)

    def reset(self, seed: int) -> None:
        """Forget every track; nothing here is random."""
        stream, begin = self.stream, type(self).estimator
        self._pipeline = Pipeline(stream.grid, stream.period_s, self._background, self._dwell, self._settings, begin)

    def update(self, frame: GridFrame) -> None:
        """Take in x_t."""
        self._pipeline.update(frame)

    def predict(self, steps: int) -> Forecast:
        """Forecast steps 0..steps."""
        return Forecast(self._pipeline.forecast(steps), objects=objects(self._pipeline.tracks))

    @classmethod
    def fit(
        cls,
        train: Sequence[FrameSource],
        validation: Sequence[FrameSource],
        score: Score,
        out: FitOutput,
        options: Any,
    ) -> None:
        """Fit the background map to `train`, tune the settings on it, and report the score on `validation`."""
        from gridtrack.trackers.model_free.tuning import fit_pipeline

        fit_pipeline(cls, train, validation, score, out, options)


class KalmanTracker(ModelFreeTracker):
    """The pipeline with extended Kalman filters."""

    name = "kalman"
    estimator = staticmethod(KalmanEstimator)


class FactorGraphTracker(ModelFreeTracker):
    """The pipeline with fixed-lag smoothers, whose measurements are robust."""

    name = "factor-graph"
    estimator = staticmethod(FactorGraphEstimator)

"""The kalman tracker: the model-free pipeline behind the plugin contract."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from gridtrack.common.config import Settings
from gridtrack.common.grid import GridFrame
from gridtrack.trackers.contract import Forecast, StreamSpec, Tracker
from gridtrack.trackers.model_free.pipeline import Pipeline
from gridtrack.trackers.model_free.settings import PipelineSettings


class KalmanTracker(Tracker):
    """Clusters before a fitted background, followed by constant-velocity Kalman filters."""
    Options: ClassVar[type[Settings]] = PipelineSettings
    learns = True

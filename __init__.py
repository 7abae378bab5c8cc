"""gridtrack: compare trackers on occupancy grids, on one stream of frames, with one set of scores.

The public names for the author of a tracker and for a notebook, imported at first use, and `__version__`.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gridtrack.common.config import Settings
    from gridtrack.common.errors import ConfigurationError, GridtrackError
    from gridtrack.common.geometry import SE2
    from gridtrack.common.grid import GridFrame, GridSpec
    from gridtrack.recordings import open_recording, packaged_recording
    from gridtrack.recordings.stream import open_stream
    from gridtrack.reports.python_api import Run, compare
    from gridtrack.trackers.contract import (
        FitTask,
        Forecast,
        FrameSource,
        Objective,
        StreamSpec,
        StretchScore,
        TrackedObject,
        Tracker,
        stream_of,
    )
    from gridtrack.trackers.training.card import Card, card_for
    from gridtrack.trackers.training.checkpoints import (
        load_checkpoint,
        save_checkpoint,
        training_device,
    )
    from gridtrack.trackers.training.networks import restore_network, trained_settings
    from gridtrack.trackers.training.progress import Progress
    from gridtrack.trackers.training.weights import Weights, load_start, load_weights, save_interrupted, save_weights

    __version__: str

__all__ = [
    "SE2",
    "Card",
    "ConfigurationError",
    "FitTask",
    "Forecast",
    "FrameSource",
    "GridFrame",
    "GridSpec",
    "GridtrackError",
    "Objective",
    "Progress",
    "Run",
    "Settings",
    "StreamSpec",
    "StretchScore",
    "TrackedObject",
    "Tracker",
    "Weights",
    "card_for",
    "compare",
    "load_checkpoint",
    "load_start",
    "load_weights",
    "open_recording",
    "open_stream",
    "packaged_recording",
    "restore_network",
    "save_checkpoint",
    "save_interrupted",
    "save_weights",
    "stream_of",
    "trained_settings",
    "training_device",
]

_HOMES = {
    "SE2": "common.geometry",
    "Card": "trackers.training.card",
    "ConfigurationError": "common.errors",
    "FitTask": "trackers.contract",
    "Forecast": "trackers.contract",
    "FrameSource": "trackers.contract",
    "GridFrame": "common.grid",
    "GridSpec": "common.grid",
    "GridtrackError": "common.errors",
    "Objective": "trackers.contract",
    "Progress": "trackers.training.progress",
    "Run": "reports.python_api",
    "Settings": "common.config",
    "StreamSpec": "trackers.contract",
    "StretchScore": "trackers.contract",
    "TrackedObject": "trackers.contract",
    "Tracker": "trackers.contract",
    "Weights": "trackers.training.weights",
    "card_for": "trackers.training.card",
    "compare": "reports.python_api",
    "load_checkpoint": "trackers.training.checkpoints",
    "load_start": "trackers.training.weights",
    "load_weights": "trackers.training.weights",
    "open_recording": "recordings",
    "open_stream": "recordings.stream",
    "packaged_recording": "recordings",
    "restore_network": "trackers.training.networks",
    "save_checkpoint": "trackers.training.checkpoints",
    "save_interrupted": "trackers.training.weights",
    "save_weights": "trackers.training.weights",
    "stream_of": "trackers.contract",
    "trained_settings": "trackers.training.networks",
    "training_device": "trackers.training.checkpoints",
}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return import_module("importlib.metadata").version("gridtrack")
    if name not in _HOMES:
        raise AttributeError(f"module 'gridtrack' has no attribute '{name}'")
    return getattr(import_module(f"gridtrack.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])

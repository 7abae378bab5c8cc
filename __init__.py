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
    from gridtrack.trackers.contract import FitTask, Forecast, Objective, StreamSpec, TrackedObject, Tracker

    __version__: str

__all__ = [
    "SE2",
    "ConfigurationError",
    "FitTask",
    "Forecast",
    "GridFrame",
    "GridSpec",
    "GridtrackError",
    "Objective",
    "Run",
    "Settings",
    "StreamSpec",
    "TrackedObject",
    "Tracker",
    "compare",
    "open_recording",
    "open_stream",
    "packaged_recording",
]

_HOMES = {
    "SE2": "common.geometry",
    "ConfigurationError": "common.errors",
    "FitTask": "trackers.contract",
    "Forecast": "trackers.contract",
    "GridFrame": "common.grid",
    "GridSpec": "common.grid",
    "GridtrackError": "common.errors",
    "Objective": "trackers.contract",
    "Run": "reports.python_api",
    "Settings": "common.config",
    "StreamSpec": "trackers.contract",
    "TrackedObject": "trackers.contract",
    "Tracker": "trackers.contract",
    "compare": "reports.python_api",
    "open_recording": "recordings",
    "open_stream": "recordings.stream",
    "packaged_recording": "recordings",
}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return import_module("importlib.metadata").version("gridtrack")
    if name not in _HOMES:
        raise AttributeError(f"module 'gridtrack' has no attribute '{name}'")
    return getattr(import_module(f"gridtrack.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])

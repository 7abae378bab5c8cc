"""`recorded`: forecasts from a file as a row of a comparison, without the program that made them.

docs/recorded.md describes the file, and how a forecast of it is read at a frame.
"""

from __future__ import annotations

from pathlib import Path

from gridtrack.common.config import Settings
from gridtrack.common.forecast_file import open_forecasts
from gridtrack.common.forecast_reader import ForecastReader
from gridtrack.common.grid import GridFrame
from gridtrack.trackers.contract import Forecast, StreamSpec, Tracker


class RecordedOptions(Settings):
    """The options of `recorded`."""

    file: Path
    """The `.npz` file, or the folder of `.npy` files, with the forecasts."""


class Recorded(Tracker):
    """Forecasts from a file of arrays, as another program made them: `mine=recorded:file=mine.npz`.

    That they use past frames only cannot be checked.
    """

    Options = RecordedOptions
    moving_sensor = True
    role = "recorded"

    def __init__(self, stream: StreamSpec, options: RecordedOptions) -> None:
        """Raises RecordingError for an unreadable file."""
        super().__init__(stream, options)
        self._reader = ForecastReader(open_forecasts(options.file), stream.grid, stream.period_s)

    def reset(self, seed: int) -> None:
        """Nothing is kept between streams."""

    def update(self, frame: GridFrame) -> None:
        """Note the stamp and the window of the frame."""
        self._frame = frame

    def predict(self, steps: int) -> Forecast:
        """The newest forecast that was available at the last frame; NaN in all cells without one."""
        read = self._reader.at(self._frame.stamp_ns, self._frame.world_T_grid, steps)
        return Forecast(read.occupancy, velocity=read.velocity, futures=read.futures)

"""A file of forecasts, as somebody's program writes it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gridtrack.common.forecast_file import write_forecasts
from gridtrack.recordings.stream import open_stream


def own_forecasts(path: Path, recording: Path) -> None:
    """Forecasts of a program that repeats each frame of a recording, for a second."""
    stream = open_stream(recording)
    frames = list(stream)
    arrays = {
        "occupancy": np.stack([[frame.occupied] * 2 for frame in frames]).astype(np.float32),
        "stamp_ns": np.array([frame.stamp_ns for frame in frames]),
        "lead_s": np.array([0.0, 1.0]),
        "cell_m": np.array(stream.grid.cell_m),
        "origin_xy": np.add(stream.grid.origin, (frames[0].world_T_grid.x, frames[0].world_T_grid.y)),
    }
    write_forecasts(path, arrays)

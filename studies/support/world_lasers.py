"""How the laser of a world is carried, and the world with the poses that its scans tell."""

from __future__ import annotations

from pathlib import Path

from gridtrack.recordings import open_recording

from studies.support.comparison import gridtrack
from studies.support.unseen_places import NONE

STANDS, DRIVES, ODOMETRY = "stands", "drives", "drives, odometry"
"""The laser stands; it drives and its poses are exact; it drives with the poses of the wheels."""


def laser_of(world: Path) -> str:
    """STANDS, DRIVES or ODOMETRY: forecasts of the last are scored by other poses than the trackers get."""
    recording = open_recording(world)
    if next(recording.scans()).reference_T_sensor is not None:
        return ODOMETRY
    (sensor,) = recording.overview().sensors.values()
    return DRIVES if sensor.moves else STANDS


def refined_world(world: Path, folder: Path) -> Path:
    """The world with refined poses, in `folder`; nothing is done where it exists."""
    path = folder / f"{world.stem}.mcap"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        gridtrack("recording", "import", world, "--out", path, "--ego-motion", "refined")
    return path


def drift_text(path: Path) -> str:
    """How far a wall moves in a second by the poses of a recording, metres, as `recording info` finds it."""
    (sensor,) = open_recording(path).overview().sensors.values()
    return NONE if sensor.pose_drift_m is None else f"{sensor.pose_drift_m:.3f}"

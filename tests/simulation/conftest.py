"""A cache of renderings, and files of tracks with other metadata."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from gridtrack.recordings import RecordingInfo
from gridtrack.simulation.laser import Laser
from gridtrack.simulation.tracks import Tracks, TracksInfo
from gridtrack.simulation.tracks_file import METADATA_KEY, write_recording

CLASSES = ("pedestrian", "cyclist", "car", "bus", "static")
RoadUser = tuple[int, int, np.ndarray, tuple[float, float]]
"""Track, class, a pose (N, 3) in every frame, and size."""


def tracks_of(*users: RoadUser, lasers: dict[str, Laser], **info: Any) -> Tracks:
    """Tracks of road users at 8 Hz, or with other fields of the `info`."""
    track, label, pose, size = zip(*users, strict=True)
    frames, rate_hz = len(pose[0]), info.get("rate_hz", 8.0)
    recording = {"site": "yard", "classes": CLASSES, "grid": "100x0.2", "rate_hz": rate_hz} | info.pop("recording", {})
    about = {"frames": frames, "rate_hz": rate_hz, "noise_seed": 3, "static_class": "static"} | info
    frame = np.repeat(np.arange(frames), len(users))
    poses, sizes = np.stack(pose, axis=1).reshape(-1, 3), np.tile(size, (frames, 1))
    made = TracksInfo(recording=RecordingInfo(**recording), lasers=lasers, **about)
    return Tracks(made, frame, np.tile(track, frames), np.tile(label, frames), poses, sizes).rounded()


@pytest.fixture
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The user's cache in the folder of the test."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def altered(tmp_path: Path) -> Callable[..., Path]:
    """Writes tracks with changed metadata: `change` gets the values, and returns others."""

    def write(tracks: Tracks, change: Callable[[dict[str, Any]], object]) -> Path:
        path = tmp_path / "odd.tracks"
        write_recording(path, tracks)
        table = pq.read_table(path)
        values = change(json.loads(table.schema.metadata[METADATA_KEY]))
        pq.write_table(table.replace_schema_metadata({METADATA_KEY: json.dumps(values)}), path)
        return path

    return write

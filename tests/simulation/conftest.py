"""A cache of renderings, and files of tracks with other metadata."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from gridtrack.simulation.tracks import Tracks
from gridtrack.simulation.tracks_file import METADATA_KEY, write_recording


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

"""Settings of a small run."""

from __future__ import annotations

import pytest

from gridtrack.evaluation.comparison.settings import CompareSettings


@pytest.fixture
def settings(record, tmp_path, monkeypatch):
    """`settings(*trackers, **more)` for the small recording, with nothing learned but what a test puts there."""
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "home"))
    path = record()

    def settings(*trackers, **more):
        defaults = {"recordings": (str(path),), "out": tmp_path / "run", "horizon_s": 1.0, "every_s": 0.5}
        return CompareSettings(trackers=trackers, **(defaults | more))

    return settings

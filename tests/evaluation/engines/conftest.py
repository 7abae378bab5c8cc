"""Tests of the engines: a host that looks at its tasks often, so that a test does not wait for it."""

from __future__ import annotations

import pytest

from gridtrack.evaluation.engines import remote


@pytest.fixture(autouse=True)
def looks_often(monkeypatch: pytest.MonkeyPatch) -> None:
    """The engine polls its tasks twenty times a second."""
    monkeypatch.setattr(remote, "POLL_S", 0.05)

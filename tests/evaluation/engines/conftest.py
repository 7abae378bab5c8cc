"""Tests of the engines: a host that polls often, stand-ins for Slurm's commands, and the same run without an engine."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from gridtrack.evaluation.engines import remote
from gridtrack.evaluation.runs.plan import resolve
from gridtrack.evaluation.runs.runner import run
from tests.evaluation.conftest import RecordedProgress

from scenes.agreement import assert_agree, counted
from scenes.programs_here import programs_here


@pytest.fixture(autouse=True)
def looks_often(monkeypatch: pytest.MonkeyPatch) -> None:
    """The engine polls its tasks twenty times a second."""
    monkeypatch.setattr(remote, "POLL_S", 0.05)


@pytest.fixture
def commands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """`commands(name=script)` puts shell scripts in front of the other programs."""

    def commands(**scripts: str) -> None:
        for name, does in scripts.items():
            (tmp_path / name).write_text(f"#!/bin/sh\n{does}\n", "utf-8")
            (tmp_path / name).chmod(0o755)
        monkeypatch.setenv("PATH", str(tmp_path), prepend=":")

    return commands


@pytest.fixture
def assert_agrees_with_local(settings: Callable[..., object], progress: RecordedProgress, tmp_path: Path):
    """`assert_agrees_with_local(*trackers)`: a run of them on this machine has the counts of the run."""

    def assert_agrees_with_local(*trackers: str) -> None:
        with programs_here():
            run(resolve(settings(*trackers, out=tmp_path / "local")), (), progress)
        assert_agree(counted(tmp_path / "run"), counted(tmp_path / "local"))

    return assert_agrees_with_local

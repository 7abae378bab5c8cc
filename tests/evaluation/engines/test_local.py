"""The engine of this machine: its scratch folder."""

from __future__ import annotations

from gridtrack.evaluation.engines.engine import LocalEngine
from gridtrack.evaluation.runs.plan import resolve
from gridtrack.evaluation.runs.runner import run


def test_the_scratch_folder_of_a_killed_run_is_removed(settings, progress, tmp_path):
    left = tmp_path / "run" / ".engine" / "of-a-killed-run" / "kalman.toml"
    left.parent.mkdir(parents=True)
    left.write_text("weights")
    with LocalEngine(1, tmp_path / "run", progress) as engine:
        assert not left.exists()
        assert engine.scratch.is_relative_to(tmp_path / "run")
        assert list(engine.scratch.iterdir()) == []
    assert not (tmp_path / "run" / ".engine").exists()
    run(resolve(settings("persistence")), (), progress)
    assert not (tmp_path / "run" / ".engine").exists()

"""Every benchmark and study imports, explains itself and parses its arguments; the quick ones run."""

from __future__ import annotations

import importlib
import pkgutil
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

import benchmarks
import studies

ROOT = Path(__file__).parents[2]
PEERS = {"benchmarks.stone_soup": "stonesoup"}
COMMANDS = [
    module.name
    for package in (benchmarks, studies)
    for module in pkgutil.iter_modules(package.__path__, f"{package.__name__}.")
    if not module.ispkg and module.name not in ("benchmarks.__main__", "benchmarks.timing")
]
QUICK = {
    "benchmarks.dogma": ["--particles", "1000"],
    "benchmarks.estimators": ["--frames", "5", "--hours", "0.001"],
    "benchmarks.hour": ["persistence", "--minutes", "1"],
    "benchmarks.moving_sensor": ["persistence", "--frames", "3", "--rounds", "1"],
    "studies.drawn_scans": ["data/junction/test-101.tracks", "--draws", "1"],
    "studies.estimator_errors": ["--runs", "2"],
    "studies.stage_errors": ["--stretches", "0s-5s"],
}


def run(name: str, arguments: Sequence[str], monkeypatch: pytest.MonkeyPatch) -> int:
    """The exit code of `python -m NAME ARGUMENTS`, run in this process."""
    monkeypatch.setattr(sys, "argv", [name, *arguments])
    monkeypatch.chdir(ROOT)
    try:
        importlib.import_module(name).main()
    except SystemExit as ended:
        return int(ended.code or 0)
    return 0


@pytest.mark.parametrize("name", COMMANDS)
def test_a_module_names_its_command_and_parses_its_arguments(name, monkeypatch, capsys):
    if name in PEERS:
        pytest.importorskip(PEERS[name])
    documentation = importlib.import_module(name).__doc__ or ""
    assert f"`python -m {name}" in " ".join(documentation.split())
    assert run(name, ["--help"], monkeypatch) == 0
    assert documentation.partition("\n")[0].split()[0] in capsys.readouterr().out


def test_a_drawing_is_not_written_under_the_name_of_another_format(monkeypatch, capsys, tmp_path):
    arguments = ["data/leg_tracker/leg_tracker.mcap", "--frames", "1", "--out"]
    assert run("studies.worlds_look", [*arguments, str(tmp_path / "look.png")], monkeypatch) == 2
    assert "look.png: the drawing is written as SVG: end its name in .svg" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
    assert run("studies.worlds_look", [*arguments, str(tmp_path / "look.svg")], monkeypatch) == 0
    assert (tmp_path / "look.svg").read_text().startswith("<svg")


@pytest.mark.parametrize("name", QUICK)
def test_a_quick_setting_runs(name, monkeypatch, capsys):
    assert run(name, QUICK[name], monkeypatch) == 0
    assert capsys.readouterr().out

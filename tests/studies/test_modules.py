"""Every study and benchmark explains itself and parses its arguments; on a tiny setting it runs."""

import importlib
import resource
from pathlib import Path

import pytest

from scenes.command_line import gridtrack
from scenes.programs_here import programs_here
from studies.support.shipped import JUNCTION

ROOT = Path(__file__).parents[2]
COMMANDS = sorted(
    ".".join(path.relative_to(ROOT).with_suffix("").parts)
    for package in ("benchmarks", "studies")
    for path in (ROOT / package).rglob("*.py")
    if path.stem != "__main__" and '__name__ == "__main__"' in path.read_text("utf-8")
)


def timed_here(words):
    """In place of a process: a command of gridtrack that runs in this one, trackers included."""
    with programs_here():
        gridtrack(*words)
    return 1.0, resource.getrusage(resource.RUSAGE_SELF)


QUICK = {
    "studies.install_size": "--out TMP/install_size.json",
    "benchmarks.dogma": "--particles 1000",
    "benchmarks.hour": "persistence --minutes 1 --out TMP/robustness.json",
    "benchmarks.inference": "--rounds 1 --out TMP/recurrent.json",
    "benchmarks.model_free": "--frames 10 --out TMP/model-free.json",
    "benchmarks.parts": "--runs 1",
    "benchmarks.peers": "--out TMP/peers.json",
    "benchmarks.scale": "--engine local --recordings 1 --out TMP/scale.json",
    "benchmarks.scoring": "--runs 1",
    "benchmarks.stone_soup": "--people 3 --frames 24 --seeds 1 --out TMP/model-free.json",
    "studies.cards": "--out TMP/model-cards.json",
    "studies.contact_truth": "--recordings 1 --stretch 0s-8s --tracker kalman --out TMP/contact.json",
    "studies.defined_pages": "--check",
    "studies.coverage": "--draws 10 --out TMP/statistics.json",
    "studies.failing_trials": "--fault hangs --fault hogs --trials 2 --results TMP/robustness.json",
    "studies.figures": "--check",
    "studies.gate_power": "--comparisons 1 --out TMP/regression.json",
    "studies.motion_rule": "--recordings 1 --out TMP/motion.json",
    "studies.size": "",
    "studies.static_memory": "static-map --out TMP",
    "studies.two_sensors": "persistence --minutes 1 --out TMP/two_sensors.json",
    "studies.velocity_errors": "kalman --recordings 1 --out TMP/dogma.json",
}
"""The arguments of each: the same code on seconds instead of minutes. TMP is a folder of the test."""
SMALLER = {
    "benchmarks.dogma": {"FRAMES": 30},
    "benchmarks.inference": {"SIZE": 48},
    "benchmarks.model_free": {"MOVERS": (3,), "WARM_UP": 5},
    "benchmarks.peers": {
        **{"SIZE": 16, "BATCH": 1, "RUNS": 1, "ROWS": (("conv-lstm", {"channels": 2}),)},
        **{"TRAINED": ("conv-lstm",), "MEASURED": 1},
    },
    "benchmarks.scale": {"SECONDS": 14, "_timed": timed_here},
    "benchmarks.scoring": {"STEPS": 5},
    "studies.coverage": {
        **{"MEMORIES": {"2 s": {2.0: 1.0}}, "LENGTHS_S": (600,), "SPREADS": (0.0,), "LEVELS": (0.0,)},
        **{"CONTACT_UNITS": (20,), "CONTACTS": (5.0,), "BATCHES": 1},
    },
    "studies.gate_power": {"REGIONS": {"dynamic": (4_000.0, 0.5)}, "BANDS": {"middle": 0.0}},
    "studies.motion_rule": {"PLACES": {"worlds": ("data/worlds/test", "indoors-corridor-1003.tracks")}},
    "studies.size": {"KINDS": ("common/*.py", "reports/*.js", "docs/glossary.md")},
    "studies.two_sensors": {"VALIDATION_FRAMES": 64, "STRATA": ("dynamic", "visible", "occluded", "occluded dynamic")},
    "studies.velocity_errors": {"RECORDINGS": [f"{JUNCTION / 'test-101.tracks'}@0s-12s"]},
}
"""Constants of a module that are smaller here."""
A_RUN = "needs the folder of a comparison"
DRAWN = "test_comparisons.py runs it on drawn comparisons"
LONG = {
    "benchmarks.harness": "goes through the whole demo recording three times",
    "benchmarks.recurrent": "trains on whole batches",
    "benchmarks.side_by_side": "needs libraries that nothing else here needs",
    "studies.kept_summary": "test_results.py runs it",
    "studies.kill_points": "compares three times for one kill: half a minute",
    "studies.moving": DRAWN,
    "studies.real_results": DRAWN,
    "studies.report_screenshots": A_RUN,
    "studies.same_sums": A_RUN,
    "studies.variants": DRAWN,
    "studies.worlds_results": DRAWN,
}
"""Why the others do not run here."""


def main_of(name):
    """The main function of a module."""
    main = importlib.import_module(name).main
    return main


@pytest.fixture(autouse=True)
def in_the_repository(monkeypatch):
    monkeypatch.chdir(ROOT)


def test_every_module_runs_or_says_why_not():
    assert sorted([*QUICK, *LONG]) == COMMANDS


@pytest.mark.parametrize("name", COMMANDS)
def test_a_module_names_its_command_and_parses_its_arguments(name, capsys):
    main = main_of(name)
    documentation = importlib.import_module(name).__doc__ or ""
    assert f"`python -m {name}" in " ".join(documentation.split())
    with pytest.raises(SystemExit) as ended:
        main(["--help"])
    assert ended.value.code == 0
    assert documentation.partition("\n")[0].split()[0] in capsys.readouterr().out


@pytest.mark.parametrize("name", QUICK)
def test_a_quick_setting_runs(name, tmp_path, monkeypatch, capsys):
    words = [word.replace("TMP", str(tmp_path)) for word in QUICK[name].split()]
    main = main_of(name)
    for constant, value in SMALLER.get(name, {}).items():
        monkeypatch.setattr(f"{name}.{constant}", value)
    main(words)
    assert capsys.readouterr().out
    assert [word for word in words if word.startswith(str(tmp_path)) and not Path(word).exists()] == []


def test_an_unknown_world_is_refused():
    with pytest.raises(SystemExit, match=r"--world indoors-room-1: no such world; there are indoors-corridor-1003, "):
        main_of("studies.worlds_results")(["--world", "indoors-room-1"])

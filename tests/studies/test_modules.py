"""Every benchmark and study imports, explains itself and parses its arguments; on a tiny setting, it runs."""

from __future__ import annotations

import importlib
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PEERS = {"benchmarks.stone_soup": "stonesoup"}
COMMANDS = sorted(
    ".".join(path.relative_to(ROOT).with_suffix("").parts)
    for package in ("benchmarks", "studies")
    for path in (ROOT / package).rglob("*.py")
    if path.stem != "__main__" and '__name__ == "__main__"' in path.read_text("utf-8")
)
QUICK = {
    "benchmarks.dogma": "--particles 1000",
    "benchmarks.ego_motion": "data/drives/car-202.tracks --scans 60 --out TMP/cost.json",
    "benchmarks.estimators": "--frames 5 --hours 0.001",
    "benchmarks.hour": "persistence --minutes 1",
    "benchmarks.import_time": "",
    "benchmarks.inference": "--rounds 1 --out TMP/recurrent.json",
    "benchmarks.model_free": "--frames 45 --out TMP/model-free.json",
    "benchmarks.moving_sensor": "persistence --frames 3 --rounds 1",
    "benchmarks.raycast": "",
    "benchmarks.scale": "--engine local --recordings 1 --out TMP/scale.json",
    "benchmarks.scoring": "--runs 1",
    "benchmarks.statistics": "",
    "benchmarks.stone_soup": "--people 3 --frames 24 --seeds 1 --out TMP/model-free.json",
    "studies.card_scores": "--out TMP/card-scores.json",
    "studies.class_losses": "--recordings 1 --stretch 0s-15s --out TMP",
    "studies.contract_page": "--check",
    "studies.drawn_scans": "data/junction/test-101.tracks --draws 1",
    "studies.ego_motion": "maps data/drives/car-202.tracks --scans 60 --out TMP/ego_motion.json",
    "studies.estimator_errors": "--runs 2",
    "studies.failing_trials": "--fault hangs --fault hogs --trials 2 --results TMP/robustness.json",
    "studies.figures": "--check",
    "studies.gate_power": "--comparisons 1 --out TMP/regression.json",
    "studies.histogram_bins": "--trackers persistence --out TMP/statistics.json",
    "studies.intervals": "--repetitions 5 --blocks-only --out TMP/statistics.json",
    "studies.known_present": "--world indoors-corridor-1003 --results TMP/known_present.json",
    "studies.label_curve": "--picture TMP/label-budget.svg --results TMP/one-shot.json",
    "studies.model_cards": "--out TMP/model-cards.json",
    "studies.sensor_conflicts": "--minutes 1 --out TMP/two_sensors.json",
    "studies.spatial_coverage": "--repetitions 1 --out TMP/statistics.json",
    "studies.stage_costs": "--stretch 0s-8s --out TMP/model-free.json",
    "studies.stage_errors": "--stretches 0s-5s",
    "studies.static_memory": "static-map --out TMP",
    "studies.training_intervals": "--draws 2 --out TMP/statistics.json",
    "studies.two_sensors": "persistence --minutes 1 --out TMP/two_sensors.json",
    "studies.unlike_sizes": "--draws 20 --out TMP/statistics.json",
    "studies.velocity_errors": "kalman --recordings 1 --out TMP/dogma.json",
    "studies.worlds_look": "data/leg_tracker/leg_tracker.mcap --frames 1 --out TMP/look.svg",
    "studies.worlds_results": "--world indoors-hall-1002 --world outdoors-street-1006 --tracker persistence --every 15s"
    " --out TMP/run --results TMP/worlds.json",
}
"""What is run of each: the same code on seconds in place of minutes. TMP is a folder of the test."""

A_RUN = "needs the folder of a comparison"
LONG = {
    "benchmarks.follow": "follows a recording in real time, with a sample every ten seconds",
    "benchmarks.harness": "goes through the whole demo recording three times",
    "benchmarks.junction": "needs SUMO",
    "benchmarks.recurrent": "trains on whole batches",
    "benchmarks.report_size": A_RUN,
    "studies.ablations": "trains networks",
    "studies.compare_counts": A_RUN,
    "studies.kept_summary": A_RUN,
    "studies.kill_points": "compares three times for one kill: half a minute",
    "studies.label_budget": "trains classifiers",
    "studies.leg_folds": "trains a tracker on each fold",
    "studies.map_and_returns": "compares on all recordings of the junction",
    "studies.moving": "needs drives that SUMO simulates",
    "studies.moving_pictures": "needs the comparisons of studies.moving",
    "studies.odometry_errors": "needs a log that does not ship",
    "studies.pr_auc_coverage": "draws four thousand recordings for each true score",
    "studies.real_drives": "needs recordings that do not ship",
    "studies.real_results": "needs recordings that do not ship",
    "studies.regression_gate": "compares on twenty recordings, four times",
    "studies.report_screenshots": A_RUN,
    "studies.site_minutes": "trains networks",
    "studies.site_start": "trains networks",
    "studies.support.drive_training": "needs SUMO",
    "studies.threshold_smoothing": A_RUN,
    "studies.worst_forecasts": A_RUN,
}
"""Why the others are not run."""


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


@pytest.mark.parametrize("name", ["studies.known_present", "studies.worlds_results"])
def test_a_world_that_is_not_there_is_refused(name):
    command = [sys.executable, "-m", name, "--world", "indoors-room-1"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr.startswith("--world indoors-room-1: no such world; there are indoors-corridor-1003, ")


def test_every_module_runs_or_is_said_to_take_long():
    assert sorted([*QUICK, *LONG]) == COMMANDS


@pytest.mark.parametrize("name", QUICK)
def test_a_quick_setting_runs(name, tmp_path):
    """In a process of its own: one waits for all children of its process, another moves its temporary folder."""
    if name in PEERS:
        pytest.importorskip(PEERS[name])
    words = [word.replace("TMP", str(tmp_path)) for word in QUICK[name].split()]
    command = [sys.executable, "-m", name, *words]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{' '.join(command)}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
    assert done.stdout or any(tmp_path.iterdir())
    assert [word for word in words if word.startswith(str(tmp_path)) and not Path(word).exists()] == []

"""The readers of weights, of the files of a run, and of configuration files."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np

from fuzz.containers import damage_parquet, damaged_mcap, damaged_safetensors
from fuzz.damage import Choices, damaged_bytes, damaged_json, damaged_text, damaged_value, dumped, one_of
from fuzz.reader import CLASSES, GRID, Reader, on_file
from gridtrack.common.forecast_file import open_forecasts, write_forecasts
from gridtrack.common.forecast_reader import ForecastReader
from gridtrack.common.geometry import SE2
from gridtrack.evaluation.referee.samples import read_samples
from gridtrack.evaluation.regression.baseline import digest_of, read_baseline
from gridtrack.evaluation.regression.history import new_entry, read_history, write_entry
from gridtrack.evaluation.regression.measuring import measure_run
from gridtrack.evaluation.runs.recipe import read_recipe
from gridtrack.evaluation.runs.run_record import (
    RecordingSummary,
    RunConfiguration,
    RunRecord,
    TrialIdentity,
    read_run_record,
)
from gridtrack.evaluation.runs.summary import RunSummary, TrackerSummary, TrialSummary
from gridtrack.evaluation.runs.sums import TrialSums
from gridtrack.evaluation.runs.trial_record import read_trial_record
from gridtrack.reports.run import read_runs
from gridtrack.trackers.contract import StreamSpec
from gridtrack.trackers.selection import read_trackers_toml
from gridtrack.trackers.training.card import CardThresholds, TrainingData
from gridtrack.trackers.training.weights import load_weights, save_weights

from scenes.drawn_samples import write_samples
from scenes.frames import card_of
from scenes.synthetic_run import description, identity, write_trial

STEPS = 2


def weights(folder: Path) -> None:
    train = (TrainingData(recording="a", sha256="0" * 64),)
    thresholds = CardThresholds(step_s=0.125, values={"visible": (0.5, 0.4)})
    card = card_of("kalman", GRID, 0.125, train=train, thresholds=thresholds, settings={"gate_m": 1.5})
    save_weights(folder / "a.toml", card, {"rate": np.zeros(GRID.shape, np.float32), "counts": np.arange(4)})


def damage_weights(choices: Choices, folder: Path) -> None:
    if choices.below(2):
        on_file("a.toml", damaged_text)(choices, folder)
        return
    path, card = folder / "a.safetensors", folder / "a.toml"
    known, content = hashlib.sha256(path.read_bytes()), damaged_safetensors(choices, path.read_bytes())
    path.write_bytes(content)
    card.write_text(card.read_text().replace(known.hexdigest(), hashlib.sha256(content).hexdigest()))


def read_weights(folder: Path) -> str:
    found = load_weights(StreamSpec(GRID, 0.125, "here", CLASSES, folder / "a.toml"), "kalman")
    assert found.card.thresholds is None or found.card.thresholds.at("visible", np.array([0.0, 1.0])).size == 2
    return f"{len(found.arrays)} arrays"


def run_folder(folder: Path) -> None:
    described = description(frames=2, steps=STEPS).model_copy(update={"rate_hz": 8.0})
    RunRecord(
        command=("gridtrack", "compare", "a.mcap"),
        configuration=RunConfiguration(
            recordings={"a": identity(described)}, trials={"kalman@a": TrialIdentity(tracker="kalman", options={})}
        ),
        versions={"gridtrack": "0.2.0"},
        status="complete",
    ).write(folder)
    write_trial(folder, "kalman", "a", 0.7, seed=1, frames=2, steps=STEPS)
    trial = TrialSummary(outcome="ok", frames_scored=2, frames_expected=2)
    summary = RunSummary(
        recordings={"a": RecordingSummary(**dict(described))},
        trackers={"kalman": TrackerSummary(tracker="kalman", recordings={"a": trial})},
    )
    summary.write(folder)


def damage_run(choices: Choices, folder: Path) -> None:
    path = one_of(choices, sorted(path for path in folder.rglob("*") if path.suffix in (".json", ".parquet")))
    if path.suffix == ".json":
        path.write_bytes(damaged_json(choices, path.read_bytes()))
    else:
        damage_parquet(choices, path)


def read_run(folder: Path) -> str:
    (run,) = read_runs([folder])
    read_run_record(folder)
    trial = folder / "kalman@a"
    record = read_trial_record(trial)
    sums = TrialSums(trial)
    for score in sums.scores:
        layout = sums.layouts[score]
        sums.by_frame(score, range(sums.steps + 1), layout.strata, layout.parts)
    measure_run(folder)
    return f"{len(run.summary.trackers)} trackers, {record and record.outcome}"


def baseline(folder: Path) -> None:
    shutil.copyfile(Path(__file__).parents[1] / "baselines" / "own_trackers.json", folder / "baseline.json")


def damaged_baseline(choices: Choices, content: bytes) -> bytes:
    if not choices.below(4):
        return damaged_json(choices, content)
    found = json.loads(content)
    found["runs"] = damaged_value(choices, found["runs"])
    return dumped(found | {"digest": digest_of(found["runs"])})


def history(folder: Path) -> None:
    write_entry(folder / "history", new_entry([], folder / "none.json", ["nothing was measured"]))


def damaged_entry(choices: Choices, content: bytes) -> bytes:
    found = json.loads(content)
    del found["digest"]
    found = damaged_value(choices, found)
    return dumped(found | {"digest": digest_of(found)} if isinstance(found, dict) else found)


def forecasts(folder: Path) -> None:
    """As a zip of arrays, and as its arrays in a folder."""
    arrays = {
        "occupancy": np.full((3, 2, *GRID.shape), 0.5, np.float16),
        "stamp_ns": np.arange(3) * 10**8,
        "lead_s": np.array([0.0, 0.1]),
        "cell_m": np.array(GRID.cell_m),
        "origin_xy": np.array(GRID.origin),
        "note": np.array("objects"),
    }
    write_forecasts(folder / "a.npz", arrays)
    (folder / "a").mkdir()
    for name, array in arrays.items():
        np.save(folder / "a" / f"{name}.npy", array)


def damage_forecasts(choices: Choices, folder: Path) -> None:
    on_file("a.npz" if choices.below(2) else "a/*.npy", damaged_bytes)(choices, folder)


def read_forecasts(folder: Path) -> str:
    found = [_read_forecasts(folder / "a"), _read_forecasts(folder / "a.npz")]
    return f"{found} forecasts"


def _read_forecasts(path: Path) -> int:
    file = open_forecasts(path)
    ForecastReader(file, GRID, 0.1).at(int(file.stamp_ns[0]), SE2(), STEPS)
    return len(file)


def text_file(name: str, text: str) -> Callable[[Path], object]:
    return lambda folder: (folder / name).write_text(text)


TRACKERS_TOML = '[mine]\ncommand = "./mine --fast"\n\n[other]\npython = "env/bin/python"\ntracker = "kalman"\n'
RECIPE = 'tracker = "kalman"\nrecordings = ["a.mcap@0s-5s"]\nseed = 3\nrate_hz = 8.0\n[options]\ngate_m = 1.5\n'

READERS: dict[str, Reader] = {
    "weights": Reader(weights, damage_weights, read_weights),
    "run": Reader(run_folder, damage_run, read_run),
    "forecasts": Reader(forecasts, damage_forecasts, read_forecasts),
    "samples": Reader(
        lambda folder: write_samples(folder / "forecasts.mcap"),
        on_file("forecasts.mcap", damaged_mcap),
        lambda f: f"{sum(1 for _ in read_samples(f / 'forecasts.mcap'))} samples",
    ),
    "baseline": Reader(
        baseline, on_file("baseline.json", damaged_baseline), lambda f: str(read_baseline(f / "baseline.json"))[:40]
    ),
    "history": Reader(
        history, on_file("history/*.json", damaged_entry), lambda f: f"{len(read_history(f / 'history'))} entries"
    ),
    "trackers.toml": Reader(
        text_file("trackers.toml", TRACKERS_TOML),
        on_file("trackers.toml", damaged_text),
        lambda f: f"{len(read_trackers_toml(f / 'trackers.toml'))} trackers",
    ),
    "recipe": Reader(
        text_file("recipe.toml", RECIPE),
        on_file("recipe.toml", damaged_text),
        lambda f: read_recipe(f / "recipe.toml").command[:40],
    ),
}

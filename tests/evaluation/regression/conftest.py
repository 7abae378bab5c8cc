"""Folders of runs with chosen counts, as `compare` writes them, and the command line in this process."""

from __future__ import annotations

import json
import sys
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gridtrack.evaluation.results.passes import Latency, Quantiles
from gridtrack.evaluation.results.trial_record import TrialRecord
from gridtrack.evaluation.scoring.counting import Tally
from gridtrack.evaluation.scoring.score_store import ScoreWriter
from gridtrack.evaluation.scoring.thresholds import half

STEPS, PERIOD_S, FRAMES = 16, 0.125, 8
OCCUPIED = {"visible": 300, "dynamic": 60, "static": 200}
STRATA = tuple(OCCUPIED)
FREE = 2000


@dataclass
class Made:
    """A tracker's scores: recall by stratum, less `loss` at the steps `at` of the dynamic stratum."""

    recall: float = 0.6
    loss: float = 0.0
    at: slice = field(default_factory=lambda: slice(1, None))
    seed: int = 0
    noise: float = 0.0
    """Spread of the recall from recording to recording, of this training only."""
    only: str = ""
    """The recording that the loss is confined to; all where empty."""
    outcome: str = "ok"
    scored: int = FRAMES
    ms: float | None = None
    options: dict[str, Any] = field(default_factory=dict)


def tally_of(made: Made, recording: str, frame: int, rng: np.random.Generator, offset: float) -> Tally:
    """Counts of one scored frame: the same cells whatever the tracker, its hits drawn by `rng`."""
    cells = np.random.default_rng([zlib.crc32(recording.encode()), frame])
    recall = np.full((STEPS + 1, len(STRATA)), made.recall + offset)
    if made.only in {"", recording}:
        recall[made.at, STRATA.index("dynamic")] -= made.loss
    occupied = np.tile([cells.poisson(n) for n in OCCUPIED.values()], (STEPS + 1, 1))
    hits = rng.binomial(occupied, np.clip(recall, 0, 1))
    false_alarms = rng.binomial(occupied, 0.4)
    tally = Tally.empty(STEPS, STRATA)
    tally.positives[..., 40], tally.positives[..., 5] = hits, occupied - hits
    tally.cells[..., 40] = hits + false_alarms
    tally.cells[..., 5] = occupied - hits + FREE - false_alarms
    tally.log_loss[:] = FREE * 0.1
    return tally


def write_trial(run: Path, label: str, recording: str, made: Made) -> None:
    folder = run / f"{label}@{recording}"
    folder.mkdir(parents=True)
    rng = np.random.default_rng([made.seed, zlib.crc32(recording.encode())])
    offset = made.noise * rng.standard_normal()
    with ScoreWriter(folder, STEPS, half(STEPS, STRATA)) as scores:
        for frame in range(made.scored):
            tally = tally_of(made, recording, frame, rng, offset)
            scores.add(
                10**15 + frame * 10**9, f"{zlib.crc32(recording.encode()):x}-{frame}", tally, 10**15 + frame * 10**9
            )
    times = Quantiles(p50=made.ms, p95=made.ms, p99=made.ms) if made.ms else None
    TrialRecord(
        schema=2, label=label, recording=recording, outcome=made.outcome, frames_scored=made.scored,
        frames_expected=FRAMES, steps=STEPS, thresholds=half(STEPS, STRATA).used(),
        latency_ms=Latency(update=times, predict=times, predict_step=times) if times else None,
    ).write(folder)  # fmt: skip


def split_of(recording: str) -> dict[str, Any]:
    return {
        "sha256": f"hash of {recording}", "stretch": f"{recording}.mcap", "stretch_s": [0.0, 60.0], "grid": "100x0.2",
        "rate_hz": 8.0, "horizons_s": [n * PERIOD_S for n in range(STEPS + 1)], "warm_up_frames": 20,
        "forecast_every_frames": 8, "validation_s": [60.0, 90.0], "validation_sha256": "hash of another",
    }  # fmt: skip


WriteRun = Callable[..., Path]


@pytest.fixture
def write_run(tmp_path: Path) -> WriteRun:
    """`write_run(name, {label: {field of Made: value}}, recordings)` leaves a run's folder."""

    def write_run(name: str, given: Mapping[str, Mapping[str, Any]], recordings: int = 20) -> Path:
        run = tmp_path / name
        trackers = {label: Made(**fields) for label, fields in given.items()}
        names = [f"junction-{number:02}" for number in range(recordings)]
        for label, made in trackers.items():
            for recording in names:
                write_trial(run, label, recording, made)
        trials = {
            f"{label}@{recording}": {"tracker": label, "options": made.options, "points": "centres"}
            for label, made in trackers.items()
            for recording in names
        }
        configuration = {"recordings": {name: split_of(name) for name in names}, "trials": trials}
        provenance = {"schema": 2, "command": ["gridtrack", "compare"], "versions": {"python": "3"}}
        run.mkdir(exist_ok=True)
        (run / "run.json").write_text(json.dumps({**provenance, "configuration": configuration, "status": "complete"}))
        return run

    return write_run


@pytest.fixture
def edit() -> Callable[[Path, Callable[[Any], Any]], None]:
    """`edit(file, change)` reads JSON, lets `change` alter it, and writes it back."""

    def edit(path: Path, change: Callable[[Any], Any]) -> None:
        content = json.loads(path.read_text())
        change(content)
        path.write_text(json.dumps(content))

    return edit


@dataclass
class Done:
    code: int
    out: str
    err: str


@pytest.fixture
def regress(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., Done]:
    """`gridtrack regress ARGUMENTS...`: its exit code and what it prints."""
    from gridtrack.cli import main

    def regress(*arguments: object) -> Done:
        monkeypatch.setattr(sys, "argv", ["gridtrack", "regress", *map(str, arguments)])
        capsys.readouterr()
        code: Any = 0
        try:
            main()
        except SystemExit as end:
            code = end.code or 0
        return Done(code, *capsys.readouterr())

    return regress

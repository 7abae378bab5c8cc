"""Folders of runs with chosen counts, as `compare` writes them, and the command line in this process."""

from __future__ import annotations

import json
import shutil
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gridtrack.evaluation.regression.baseline import baseline_of as made_of
from gridtrack.evaluation.regression.baseline import write_baseline
from gridtrack.evaluation.regression.measuring import measure_run
from gridtrack.evaluation.runs.passes import AtStrength, CallTimes, Latency, Robustness
from gridtrack.evaluation.runs.run_record import RUN_SCHEMA
from gridtrack.evaluation.runs.scorekeeper import Counter
from gridtrack.evaluation.runs.sums import SumsWriter
from gridtrack.evaluation.runs.trial_record import TRIAL_SCHEMA, ThresholdsUsed, TrialRecord
from gridtrack.evaluation.scores.cells import HALF, Tally
from gridtrack.evaluation.scores.class_log_loss import CLASS_LOG_LOSS
from gridtrack.evaluation.scores.definition import TrialFacts
from gridtrack.evaluation.scores.f1 import F1
from gridtrack.evaluation.scores.log_loss import LOG_LOSS
from gridtrack.evaluation.scores.neighbourhoods import NeighbourhoodSums
from gridtrack.evaluation.scores.thresholds import half
from gridtrack.recordings.degradation import Degradation
from tests.conftest import Done

from scenes.synthetic_run import counted_forecast

STEPS, PERIOD_S, FRAMES = 16, 0.125, 8
OCCUPIED = {"visible": 300, "dynamic": 60, "static": 200}
STRATA = tuple(OCCUPIED)
FREE = 2000
HIGH, LOW = HALF + 10, 5
"""Bins of probabilities above and below every threshold in use."""
NO_NEIGHBOURHOODS = NeighbourhoodSums(*np.zeros((2, 1, 1, 1)), np.zeros((1, 1)), ())


@dataclass
class Made:
    """A tracker's scores: recall by stratum, less `loss` at the steps `at` of the dynamic stratum."""

    recall: float = 0.6
    loss: float = 0.0
    at: slice = field(default_factory=lambda: slice(1, None))
    seed: int = 0
    noise: float = 0.0
    """Spread of the recall from recording to recording, of this training only."""
    only: tuple[str, ...] = ()
    """The recordings with the loss; all if empty."""
    occupied: bool = True
    """Whether any cell is."""
    nats: float = 0.1
    """Log loss of a free cell."""
    class_nats: float | None = None
    """Log loss of the classes of a scan; None for a tracker without classes."""
    blurred: tuple[str, ...] = ()
    """The recordings in which the log losses are five times as large."""
    run_seed: int = 0
    tracker: str = ""
    """The tracker of the label; by default the label itself."""
    points: str = "centres"
    argv: tuple[str, ...] = ()
    recoveries: int = 0
    degradations: tuple[float, ...] = ()
    """Scored values of `beam-dropout`."""
    outcome: str = "ok"
    scored: int = FRAMES
    ms: float | None = None
    options: dict[str, Any] = field(default_factory=dict)


def tally_of(made: Made, recording: str, frame: int, rng: np.random.Generator, offset: float) -> Tally:
    """Counts of one scored frame: equal cells for all trackers, and hits drawn by `rng`."""
    cells = np.random.default_rng([zlib.crc32(recording.encode()), frame])
    recall = np.full((STEPS + 1, len(STRATA)), made.recall + offset)
    if not made.only or recording in made.only:
        recall[made.at, STRATA.index("dynamic")] -= made.loss
    occupied = np.tile([cells.poisson(n if made.occupied else 0) for n in OCCUPIED.values()], (STEPS + 1, 1))
    hits = rng.binomial(occupied, np.clip(recall, 0, 1))
    false_alarms = rng.binomial(occupied, 0.4)
    tally = Tally.empty(STEPS, STRATA)
    tally.positives[..., HIGH], tally.positives[..., LOW] = hits, occupied - hits
    tally.cells[..., HIGH] = hits + false_alarms
    tally.cells[..., LOW] = occupied - hits + FREE - false_alarms
    tally.log_loss[:] = FREE * made.nats * (5.0 if recording in made.blurred else 1.0)
    return tally


def class_sums(recording: str, made: Made, parts: tuple[str, ...]) -> np.ndarray:
    """Ten cells of one class in a scan at every step (S, 1, P)."""
    nats = (made.class_nats or 0.0) * (5.0 if recording in made.blurred else 1.0)
    sums = np.zeros((STEPS + 1, 1, len(parts)))
    sums[..., :4] = 10 * nats, nats, 1.0, 10.0
    return sums


def robustness_of(made: Made) -> Robustness | None:
    if not made.degradations:
        return None
    scores = {"f1": {"visible": (0.5,) * (STEPS + 1)}}
    points = [
        AtStrength(strength=float(n), value=value, delivered="", scores=scores)
        for n, value in enumerate(made.degradations)
    ]
    return Robustness(
        degradation=Degradation(beam_dropout=made.degradations[-1]), kinds={"beam-dropout": tuple(points)}
    )


def write_trial(run: Path, label: str, recording: str, made: Made, start_s: int = 0) -> None:
    folder = run / f"{label}@{recording}"
    folder.mkdir(parents=True)
    rng = np.random.default_rng([made.seed, zlib.crc32(recording.encode())])
    offset = made.noise * rng.standard_normal()
    classes = () if made.class_nats is None else ("car",)
    facts = TrialFacts(0.2, STEPS, STRATA, half(STEPS, STRATA), classes, classes)
    cells = Counter((F1, LOG_LOSS), facts)
    layouts = Counter((F1, LOG_LOSS, CLASS_LOG_LOSS), facts).layouts
    with SumsWriter(folder, layouts, STEPS) as writer:
        for frame in range(made.scored):
            stamp_ns, digest = 10**15 + (start_s + frame) * 10**9, f"{zlib.crc32(recording.encode()):x}-{frame}"
            tally = tally_of(made, recording, frame, rng, offset)
            counts = cells.count(counted_forecast(stamp_ns, stamp_ns, tally, NO_NEIGHBOURHOODS))
            if classes:
                counts["class_log_loss"] = class_sums(recording, made, layouts["class_log_loss"].parts)
            for score, sums in counts.items():
                writer.add(stamp_ns, digest, score, sums)
    times = CallTimes(p50=made.ms, p95=made.ms, p99=made.ms) if made.ms else None
    TrialRecord(
        schema=TRIAL_SCHEMA, label=label, recording=recording, outcome=made.outcome, frames_scored=made.scored,
        frames_expected=FRAMES, steps=STEPS, thresholds=ThresholdsUsed.of(half(STEPS, STRATA)),
        recoveries=made.recoveries, robustness=robustness_of(made),
        role="floor" if label == "persistence" else "tracker",
        latency_ms=Latency(update=times, predict=times, predict_step=times) if times else None,
    ).write(folder)  # fmt: skip


def split_of(recording: str, source: str) -> dict[str, Any]:
    return {
        "sha256": f"hash of {recording}", "source_sha256": source,
        "stretch": f"{recording}.mcap", "stretch_s": [0.0, 60.0], "grid": "100x0.2",
        "rate_hz": 8.0, "horizons_s": [n * PERIOD_S for n in range(STEPS + 1)], "warm_up_frames": 20,
        "forecast_every_frames": 8, "validation_s": [60.0, 90.0], "validation_sha256": "hash of another",
    }  # fmt: skip


WriteRun = Callable[..., Path]
Written = Callable[[str, Callable[[Path], object]], Path]


@pytest.fixture(scope="session")
def written(tmp_path_factory: pytest.TempPathFactory) -> Written:
    """`written(key, write)`: a folder that `write` fills once a session for each `key`."""
    folders: dict[str, Path] = {}

    def written(key: str, write: Callable[[Path], object]) -> Path:
        if key not in folders:
            folder = tmp_path_factory.mktemp("written")
            write(folder)
            folders[key] = folder
        return folders[key]

    return written


@pytest.fixture
def run_of(written: Written) -> WriteRun:
    """`run_of(trackers, recordings)`: a run of `write_run`, which tests must not change."""
    return lambda *given, **how: written(repr((given, how)), lambda folder: fill_run(folder, *given, **how))


@pytest.fixture
def write_run(tmp_path: Path, run_of: WriteRun) -> WriteRun:
    """`write_run(name, {label: {field of Made: value}}, recordings)` leaves a run's folder.

    With a `source` the recordings are its stretches, each `apart_s` after the one before it.
    """
    return lambda name, *given, **how: Path(shutil.copytree(run_of(*given, **how), tmp_path / name))


@pytest.fixture
def baseline_of(tmp_path: Path, run_of: WriteRun, written: Written) -> Callable[..., Path]:
    """`baseline_of({label: {field of Made: value}}, recordings)`: the file of a baseline."""

    def baseline_of(*given: Any, **how: Any) -> Path:
        measured = written(
            repr(("baseline", given, how)),
            lambda folder: write_baseline(folder / "baseline.json", made_of([measure_run(run_of(*given, **how))])),
        )
        return Path(shutil.copy(measured / "baseline.json", tmp_path))

    return baseline_of


def fill_run(
    run: Path, given: Mapping[str, Mapping[str, Any]], recordings: int = 20, source: str = "", apart_s: int = 60
) -> None:
    """Write the trials and the record of a run."""
    trackers = {label: Made(**fields) for label, fields in given.items()}
    names = [f"junction-{number:02}" for number in range(recordings)]
    for label, made in trackers.items():
        for number, recording in enumerate(names):
            write_trial(run, label, recording, made, number * apart_s)
    trials = {
        f"{label}@{recording}": {
            "tracker": made.tracker or label,
            "options": made.options,
            "points": made.points,
            "argv": made.argv,
            "seed": made.run_seed,
        }
        for label, made in trackers.items()
        for recording in names
    }
    configuration = {"recordings": {name: split_of(name, source) for name in names}, "trials": trials}
    provenance = {"schema": RUN_SCHEMA, "command": ["gridtrack", "compare"], "versions": {"python": "3"}}
    (run / "run.json").write_text(json.dumps({**provenance, "configuration": configuration, "status": "complete"}))


@pytest.fixture
def regress(gridtrack: Callable[..., Done]) -> Callable[..., Done]:
    """`gridtrack regress ARGUMENTS...` in this process."""
    return lambda *arguments: gridtrack("regress", *arguments)

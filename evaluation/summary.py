"""summary.json: what a run found, machine-readable, made from the files that its trials left."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation import metrics
from gridtrack.evaluation.counting import BINS, HALF, Tally
from gridtrack.evaluation.outcome import Outcome
from gridtrack.evaluation.scores import read_deliveries, read_tally
from gridtrack.evaluation.strata import STRATA

SCHEMA = 1
SUMMARY = "summary.json"
NO_INTERVAL = "too short for an interval"


@dataclass(frozen=True, slots=True)
class Ended:
    """A trial that has ended: its outcome, and its folder with what it scored."""

    outcome: Outcome
    folder: Path
    tracker: str
    options: Mapping[str, Any]


def summarise(
    recordings: Mapping[str, Mapping[str, Any]], trials: Iterable[Ended], notices: Sequence[str], interrupted: bool
) -> dict[str, Any]:
    """The summary as plain data; `recordings` holds what is said of each one beside its scores (docs/run-folder.md)."""
    trackers: dict[str, Any] = {}
    trials = list(trials)
    for trial in trials:
        outcome = trial.outcome
        entry = trackers.setdefault(
            outcome.label, {"tracker": trial.tracker, "options": dict(trial.options), "recordings": {}}
        )
        entry["recordings"][outcome.recording] = _trial_summary(trial)
    described, differing = {}, []
    for name, description in recordings.items():
        odd = odd_deliveries([trial for trial in trials if trial.outcome.recording == name])
        described[name] = {**description, "parity": not odd}
        differing += [
            f"{label} on {name}: was delivered other frames than the rest; its scores are not comparable" for label in odd
        ]
    return {
        "schema": SCHEMA,
        "interrupted": interrupted,
        "notices": [*notices, *differing],
        "recordings": described,
        "trackers": trackers,
        "differences": [],
    }


def write_summary(path: Path, summary: Mapping[str, Any]) -> None:
    """Leave `summary` at `path`, replaced whole."""
    partial = path.with_name(path.name + ".partial")
    partial.write_text(json.dumps(summary, indent=1, allow_nan=False) + "\n")
    partial.replace(path)


def odd_deliveries(trials: Sequence[Ended]) -> list[str]:
    """Labels of the trials of one recording that were delivered other frames than most, where they have scores."""
    deliveries = {t.outcome.label: read_deliveries(t.folder) for t in trials if t.outcome.frames_scored}
    usual: dict[int, Counter[str]] = {}
    for delivered in deliveries.values():
        for stamp, digest in delivered.items():
            usual.setdefault(stamp, Counter())[digest] += 1
    return [
        label
        for label, delivered in deliveries.items()
        if any(digest != usual[stamp].most_common(1)[0][0] for stamp, digest in delivered.items())
    ]


def _trial_summary(trial: Ended) -> dict[str, Any]:
    outcome = trial.outcome
    latency = outcome.latency_ms
    return {
        "outcome": outcome.outcome,
        "reason": outcome.reason,
        "frames_scored": outcome.frames_scored,
        "frames_expected": outcome.frames_expected,
        "threshold_chosen_on": outcome.thresholds.chosen_on,
        "strata": _strata(outcome, read_tally(trial.folder, outcome.steps)) if outcome.frames_scored else {},
        "semantics": None,
        "latency_ms": latency.model_dump(include={"update", "predict", "predict_step"}) if latency else None,
        "deadline": None,
        "times": outcome.times.model_dump(),
        "peak_rss_mb": outcome.peak_rss_mb,
    }


def _strata(outcome: Outcome, tally: Tally) -> dict[str, dict[str, Any]]:
    """Every score per stratum and step. Intervals are left out: they want more units than one recording has."""
    thresholds = np.array(outcome.thresholds.values)
    at_threshold = tally.confusion(np.rint(thresholds * BINS).astype(np.int64))
    at_half = tally.confusion(np.full(len(thresholds), HALF))
    curves = {
        "f1": metrics.f1_score(at_threshold),
        "precision": metrics.precision(at_threshold),
        "recall": metrics.recall(at_threshold),
        "pr_auc": metrics.average_precision(tally),
        "brier": metrics.brier_score(tally),
        "nll": metrics.log_loss(tally),
        "ece": metrics.calibration_error(tally),
        "threshold": np.repeat(thresholds[:, None], len(STRATA), axis=1),
        "f1_at_half": metrics.f1_score(at_half),
    }
    strata: dict[str, dict[str, Any]] = {}
    for k, name in enumerate(STRATA):
        strata[name] = {key: _curve(values[:, k]) for key, values in curves.items()}
        strata[name] |= {"f1_low": None, "f1_high": None, "interval": NO_INTERVAL}
    return strata


def _curve(values: NDArray[np.float64]) -> list[float | None]:
    """One value per step; null where it is undefined."""
    return [None if math.isnan(value) else round(value, 6) for value in values.tolist()]

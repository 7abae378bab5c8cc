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
from gridtrack.evaluation.counting import EDGES
from gridtrack.evaluation.record import TrialRecord
from gridtrack.evaluation.robustness import robustness_summary, shown_others
from gridtrack.evaluation.scores import read_deliveries, read_tally
from gridtrack.evaluation.thresholds import half

SCHEMA = 1
SUMMARY = "summary.json"
NO_INTERVAL = "too short for an interval"


@dataclass(frozen=True, slots=True)
class Ended:
    """A trial that has ended: its record, and its folder with what it scored."""

    record: TrialRecord
    folder: Path
    tracker: str
    options: Mapping[str, Any]
    points: str


def summarise(
    recordings: Mapping[str, Mapping[str, Any]], trials: Iterable[Ended], notices: Sequence[str], interrupted: bool
) -> dict[str, Any]:
    """The summary as plain data; `recordings` holds what is said of each one beside its scores (docs/run-folder.md)."""
    trackers: dict[str, Any] = {}
    trials = list(trials)
    for trial in trials:
        record = trial.record
        entry = trackers.setdefault(
            record.label,
            {"tracker": trial.tracker, "options": dict(trial.options), "points": trial.points, "recordings": {}},
        )
        entry["recordings"][record.recording] = _trial_summary(trial)
    described, differing = {}, []
    for name, description in recordings.items():
        of_recording = [trial for trial in trials if trial.record.recording == name]
        odd = odd_deliveries(of_recording)
        odd_degraded = shown_others((trial.points, trial.record) for trial in of_recording)
        described[name] = {**description, "parity": not odd}
        differing += [
            f"{label} on {name} was shown other degraded frames than the rest: its robustness is not comparable"
            for label in odd_degraded
        ]
        differing += [
            f"{label} on {name} was delivered other frames than the rest: its scores are not comparable"
            for label in odd
        ]
    return {
        "schema": SCHEMA,
        "interrupted": interrupted,
        "notices": [*notices, *differing],
        "recordings": described,
        "trackers": trackers,
        "differences": [],
    }


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Leave `content` at `path`, replaced whole."""
    partial = path.with_name(path.name + ".partial")
    partial.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n")
    partial.replace(path)


def odd_deliveries(trials: Sequence[Ended]) -> list[str]:
    """Labels of the trials of one recording that were delivered other frames than most at a stamp they share.

    Trials that asked for raw returns are compared among themselves: their frames differ by design.
    """
    usual: dict[tuple[str, int], Counter[str]] = {}
    scored = [trial for trial in trials if trial.record.frames_scored]
    deliveries = [(trial, read_deliveries(trial.folder)) for trial in scored]
    for trial, delivered in deliveries:
        for stamp, digest in delivered.items():
            usual.setdefault((trial.points, stamp), Counter())[digest] += 1
    return [
        trial.record.label
        for trial, delivered in deliveries
        if any(digest != usual[trial.points, stamp].most_common(1)[0][0] for stamp, digest in delivered.items())
    ]


def _trial_summary(trial: Ended) -> dict[str, Any]:
    record = trial.record
    latency = record.latency_ms
    strata = _strata(record, trial.folder) if record.frames_scored else {}
    return {
        "outcome": record.outcome,
        "reason": record.reason,
        "frames_scored": record.frames_scored,
        "frames_expected": record.frames_expected,
        "threshold_chosen_on": record.thresholds.chosen_on,
        "weights_sha256": record.weights_sha256,
        "strata": strata,
        "semantics": None,
        "latency_ms": latency.model_dump() if latency else None,
        "deadline": record.deadline.model_dump(mode="json") if record.deadline else None,
        "robustness": robustness_summary(record.robustness, strata) if record.robustness else None,
        "times": record.times.model_dump(),
        "peak_rss_mb": record.peak_rss_mb,
    }


def _strata(record: TrialRecord, folder: Path) -> dict[str, dict[str, Any]]:
    """Every score per stratum and step. Intervals are left out: they want more units than one recording has."""
    tally = read_tally(folder, record.steps, tuple(record.thresholds.values))
    thresholds = np.array([record.thresholds.values[name] for name in tally.strata]).T
    bins = np.abs(thresholds[..., None] - EDGES).argmin(axis=-1)
    visible = bins[:, [tally.strata.index("visible")]]
    at_threshold = tally.confusion(bins)
    curves = {
        "f1": metrics.f1_score(at_threshold),
        "precision": metrics.precision(at_threshold),
        "recall": metrics.recall(at_threshold),
        "pr_auc": metrics.average_precision(tally),
        "brier": metrics.brier_score(tally),
        "nll": metrics.log_loss(tally),
        "ece": metrics.calibration_error(tally),
        "threshold": thresholds,
        "f1_at_visible": metrics.f1_score(tally.confusion(np.broadcast_to(visible, bins.shape))),
        "f1_at_half": metrics.f1_score(tally.confusion(half(record.steps, tally.strata).bins)),
    }
    strata: dict[str, dict[str, Any]] = {}
    for k, name in enumerate(tally.strata):
        strata[name] = {key: _curve(values[:, k]) for key, values in curves.items()}
        strata[name] |= {"f1_low": None, "f1_high": None, "interval": NO_INTERVAL}
    return strata


def _curve(values: NDArray[np.float64]) -> list[float | None]:
    """One value per step; null where it is undefined."""
    return [None if math.isnan(value) else round(value, 6) for value in values.tolist()]

"""summary.json: what a run found, machine-readable, made from the files that its trials left."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from gridtrack.evaluation.scoring.class_scores import unknown_classes
from gridtrack.evaluation.scoring.robustness import mismatched_degradations, robustness_summary
from gridtrack.evaluation.scoring.scores import read_deliveries
from gridtrack.evaluation.statistics.ceiling import add_ceiling
from gridtrack.evaluation.statistics.class_inference import ClassInference
from gridtrack.evaluation.statistics.curves import curves_of
from gridtrack.evaluation.statistics.inference import Ended, Inference

SCHEMA = 1
SUMMARY = "summary.json"


def summarise(
    recordings: Mapping[str, Mapping[str, Any]],
    trials: Iterable[Ended],
    notices: Sequence[str],
    interrupted: bool,
    reference: str | None = None,
) -> dict[str, Any]:
    """The summary as plain data; `recordings` holds what is said of each one beside its scores (docs/run-folder.md).

    `reference` is the label of the row that the others are set against; None: the usual one.
    """
    trials = list(trials)
    inference = Inference(recordings, trials, reference)
    pooled = inference.pooled()
    trackers = _rows(trials, inference, pooled)
    classes = ClassInference(recordings, trials, inference)
    classes.add_scores(trackers)
    add_ceiling(trackers)
    odd = {name: odd_deliveries(_on(name, trials)) for name in recordings}
    found = _odd_things(recordings, trials, odd)
    if pooled is None and len(recordings) > 1:
        found.append("the recordings differ in rate, horizon or grid: no scores are pooled over them")
    return {
        "schema": SCHEMA,
        "interrupted": interrupted,
        "notices": [*notices, *found],
        "recordings": {name: {**described, "parity": not odd[name]} for name, described in recordings.items()},
        "trackers": trackers,
        "reference": inference.reference,
        "differences": inference.differences(),
        "class_differences": classes.differences(),
    }


def _rows(trials: Sequence[Ended], inference: Inference, pooled: Mapping[str, Any] | None) -> dict[str, Any]:
    """Of each label what ran, its scores on each recording, and those `pooled` over them."""
    rows: dict[str, Any] = {}
    for trial in trials:
        row = {"tracker": trial.tracker, "options": dict(trial.options), "points": trial.points, "recordings": {}}
        label, recording = trial.record.label, trial.record.recording
        rows.setdefault(label, row)["recordings"][recording] = _trial_summary(trial, inference)
    for label, row in rows.items():
        row["pooled"] = pooled[label] if pooled else None
    return rows


def _odd_things(
    recordings: Mapping[str, Mapping[str, Any]], trials: Sequence[Ended], odd: Mapping[str, Sequence[str]]
) -> list[str]:
    """What a reader must know before comparing; `odd` are the labels that were delivered other frames, by recording."""
    found: list[str] = []
    for name, description in recordings.items():
        of_recording = _on(name, trials)
        found += filter(None, (unknown_classes(trial.record, description) for trial in of_recording))
        found += [
            f"{label} on {name} was shown other degraded frames than the rest: its robustness is not comparable"
            for label in mismatched_degradations((trial.points, trial.record) for trial in of_recording)
        ]
        found += [
            f"{label} on {name} was delivered other frames than the rest: its scores are not comparable"
            for label in odd[name]
        ]
    found += [
        f"{trial.record.label} on {trial.record.recording} went on {trial.record.recoveries} times after a failure"
        " inside it, by its own count"
        for trial in trials
        if trial.record.recoveries
    ]
    return found


def _on(recording: str, trials: Sequence[Ended]) -> list[Ended]:
    return [trial for trial in trials if trial.record.recording == recording]


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


def _trial_summary(trial: Ended, inference: Inference) -> dict[str, Any]:
    record = trial.record
    latency = record.latency_ms
    strata: dict[str, dict[str, Any]] = {}
    if record.frames_scored:
        curves = curves_of([(record, inference.tally_of(trial))], trial.strata)
        intervals = inference.intervals_of(trial)
        strata = {name: {**curves[name], **intervals[name]} for name in trial.strata}
    return {
        "outcome": record.outcome,
        "reason": record.reason,
        "frames_scored": record.frames_scored,
        "frames_expected": record.frames_expected,
        "threshold_chosen_on": record.thresholds.chosen_on,
        "weights_sha256": record.weights_sha256,
        "recoveries": record.recoveries,
        "strata": strata,
        "latency_ms": latency.model_dump() if latency else None,
        "deadline": record.deadline.model_dump(mode="json") if record.deadline else None,
        "robustness": robustness_summary(record.robustness, strata) if record.robustness else None,
        "times": record.times.model_dump(),
        "peak_rss_mb": record.peak_rss_mb,
    }

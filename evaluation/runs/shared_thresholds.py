"""Thresholds that trials with the same tracker and validation stretch share: chosen once in a run."""

from __future__ import annotations

import hashlib
import json
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from gridtrack.common.files import read_bounded, write_text
from gridtrack.evaluation.referee.splits import ORACLE, EvaluationSplit
from gridtrack.evaluation.runs.plan import Trial
from gridtrack.evaluation.runs.result_files import RunError
from gridtrack.evaluation.runs.trial_record import MAX_OUTCOME_BYTES, ThresholdsUsed
from gridtrack.evaluation.scores.thresholds import Thresholds, bins_of


class SharedThresholds:
    """The thresholds chosen so far in a run. Thread-safe: one thread chooses while the others wait.

    In `folder` other processes of the run find the thresholds given to `learn`.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._guard = threading.Lock()
        self._choosing: dict[str, threading.Lock] = {}
        self._chosen: dict[str, Thresholds] = {}

    def known(self, key: str) -> bool:
        """Whether the thresholds of `key` have been chosen."""
        return key in self._chosen or self._path(key).is_file()

    def of(self, key: str, choose: Callable[[], Thresholds]) -> Thresholds:
        """The thresholds of `key`, by `choose()` if they have not been chosen yet. Raises errors of `choose`."""
        with self._guard:
            choosing = self._choosing.setdefault(key, threading.Lock())
        with choosing:
            if key not in self._chosen:
                self._chosen[key] = self._read(key) or choose()
            return self._chosen[key]

    def learn(self, key: str, used: ThresholdsUsed) -> None:
        """Keep the thresholds that another process has chosen, if none are known. Raises OSError."""
        if not self.known(key):
            write_text(self._path(key), used.model_dump_json())

    def _read(self, key: str) -> Thresholds | None:
        try:
            text = read_bounded(self._path(key), MAX_OUTCOME_BYTES, RunError)
        except FileNotFoundError:
            return None
        return ThresholdsUsed.model_validate_json(text).thresholds()

    def _path(self, key: str) -> Path:
        return self._folder / f"{hashlib.sha256(key.encode()).hexdigest()}.thresholds.json"


def thresholds_of_card(trial: Trial) -> Thresholds | None:
    """The thresholds on the card of the trial's weights, at its own steps; None without weights, or without any."""
    known = trial.weights.card.thresholds if trial.weights else None
    if trial.weights is None or known is None:
        return None
    split = trial.split
    horizons_s = np.arange(split.steps + 1, dtype=np.float64) * split.test.period_s
    values = np.stack([known.at(name, horizons_s) for name in split.strata], axis=1)
    return Thresholds(bins_of(values), f"the card {trial.weights.name}", split.strata)


def trial_key(trial: Trial) -> str:
    """Everything that the thresholds of a trial depend on: the tracker with its settings, and the validation frames."""
    weights = trial.weights.sha256 if trial.weights else ""
    return json.dumps([trial.identity().model_dump(), weights, *_validation_frames(trial.split)])


def oracle_key(split: EvaluationSplit) -> str:
    """Everything that the thresholds of the oracle depend on."""
    return json.dumps([ORACLE, *_validation_frames(split)])


def _validation_frames(split: EvaluationSplit) -> list[Any]:
    """The frames on which thresholds are chosen, and the counts there; the returns in them apart."""
    validation = split.validation
    stretch = validation and {
        "sha256": validation.sha256,
        "stretch_s": list(validation.stretch_s),
        "period_ns": validation.period_ns,
        "grid": str(validation.grid),
        "every": split.validation_schedule.every,
    }
    return [stretch, split.steps, split.strata, split.test.site, split.test.period_ns]

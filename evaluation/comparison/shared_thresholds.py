"""Thresholds that trials with the same tracker and validation stretch share: chosen once in a run."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable

from gridtrack.evaluation.comparison.plan import Trial
from gridtrack.evaluation.scoring.thresholds import Thresholds


class SharedThresholds:
    """The thresholds chosen so far in a run. Thread-safe: one thread chooses while the others wait."""

    def __init__(self) -> None:
        self._guard = threading.Lock()
        self._choosing: dict[str, threading.Lock] = {}
        self._chosen: dict[str, Thresholds] = {}

    def known(self, trial: Trial) -> bool:
        """Whether the thresholds of `trial` have been chosen."""
        return _key(trial) in self._chosen

    def of(self, trial: Trial, choose: Callable[[], Thresholds]) -> Thresholds:
        """The thresholds of `trial`, by `choose()` where they have not been chosen yet. Raises what `choose` raises."""
        key = _key(trial)
        with self._guard:
            choosing = self._choosing.setdefault(key, threading.Lock())
        with choosing:
            if key not in self._chosen:
                self._chosen[key] = choose()
            return self._chosen[key]


def _key(trial: Trial) -> str:
    """Everything that the thresholds depend on: the tracker with its settings, and the validation frames."""
    split, validation = trial.split, trial.validation
    stretch = (
        {
            "sha256": validation.sha256,
            "stretch_s": list(validation.stretch_s),
            "period_ns": validation.period_ns,
            "grid": str(validation.grid),
            "every": split.validation_schedule.every,
        }
        if validation
        else None
    )
    weights = trial.weights.sha256 if trial.weights else ""
    return json.dumps(
        [trial.identity().model_dump(), weights, stretch, split.steps, split.strata, trial.split.test.site]
    )

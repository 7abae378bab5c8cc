"""Thresholds chosen once for all trials that would choose the same: many recordings may share a validation stretch."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable

from gridtrack.evaluation.comparison.plan import Trial
from gridtrack.evaluation.scoring.thresholds import Thresholds


class SharedThresholds:
    """What a run has chosen so far; called from several threads, of which one chooses while the others wait."""

    def __init__(self) -> None:
        self._guard = threading.Lock()
        self._turns: dict[str, threading.Lock] = {}
        self._chosen: dict[str, Thresholds] = {}

    def known(self, trial: Trial) -> bool:
        """Whether a trial like this has chosen already."""
        return _what_decides(trial) in self._chosen

    def of(self, trial: Trial, choose: Callable[[], Thresholds]) -> Thresholds:
        """Those of `trial`, by `choose` where no trial like it has chosen yet; what that raises is raised."""
        key = _what_decides(trial)
        with self._guard:
            turn = self._turns.setdefault(key, threading.Lock())
        with turn:
            if key not in self._chosen:
                self._chosen[key] = choose()
            return self._chosen[key]


def _what_decides(trial: Trial) -> str:
    """Everything that the thresholds depend on: the tracker as it is run, and the frames that they are chosen on."""
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
    return json.dumps([trial.identity(), weights, stretch, split.steps, split.strata, trial.split.test.site])

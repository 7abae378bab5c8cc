"""The prior pass: what a tracker expects of a place before it sees it, beside what the recording shows there."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from gridtrack.common.grid import GridFrame
from gridtrack.evaluation.results.columns import PRIOR_TABLE
from gridtrack.evaluation.results.trial_record import TrialRecord
from gridtrack.evaluation.runs.plan import Trial
from gridtrack.evaluation.scoring.prior_store import write_prior

PRIOR_LOG = "prior.log"


def trials_with_priors(trials: Iterable[Trial], records: Mapping[str, TrialRecord]) -> list[Trial]:
    """Those of the complete `trials` whose prior is to be measured: of each row the first at each place.

    A tracker without weights expects nothing of a place, and one with general weights the same everywhere. The window
    of a sensor that moves is no place.
    """
    first: dict[tuple[str, str, str], Trial] = {}
    for trial in trials:
        if trial.weights and not trial.weights.card.general and trial.test.first_move_s is None:
            first.setdefault((trial.label, trial.test.site, str(trial.test.grid)), trial)
    return [trial for trial in first.values() if PRIOR_TABLE.file not in records[trial.name].files]


class PriorRun:
    """The prior of one trial, from a process of its own: one that has seen the stream could remember it."""

    def __init__(self, trial: Trial, folder: Path) -> None:
        """The log of the process and the table go to `folder`."""
        self._trial, self._folder = trial, folder
        self._process = trial.tracker_process(folder / PRIOR_LOG)

    def run(self, on_frame: Callable[[], None]) -> None:
        """Write the table; `on_frame` is called before each frame and may raise to end it. Raises TrialEnded."""
        visible, occupied = (np.zeros(self._trial.test.grid.shape, np.int32) for _ in range(2))
        nothing: GridFrame | None = None
        for frame in self._trial.test:
            on_frame()
            visible += frame.visible
            occupied += frame.occupied
            nothing = nothing or without_returns(frame)
        assert nothing is not None, "a complete trial has frames"
        with self._process as process:
            process.reset(self._trial.seed)
            process.update(nothing)
            probability = process.predict(1).occupancy[1]
        write_prior(self._folder, visible, occupied, probability)

    def interrupt(self) -> None:
        """End the pass from another thread, also during a call."""
        self._process.kill()


def without_returns(frame: GridFrame) -> GridFrame:
    """A frame of the same sensors in which no cell is visible."""
    nothing = np.zeros_like(frame.visible)
    return replace(
        frame, visible=nothing, occupied=nothing, points=frame.points[:0], point_origin=frame.point_origin[:0]
    )

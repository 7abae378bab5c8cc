"""Speed of two versions of a tracker, timed in turns: each frame goes to one and then to the other, on one machine.

Load on the machine slows both, so the ratio of their times for one frame hardly depends on it. The memory layout of a
process changes its speed: each round starts two new processes, and the interval is over rounds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.special import stdtrit

from gridtrack.common.errors import ConfigurationError, did_you_mean
from gridtrack.evaluation.hosting.outcome import TrialEnded
from gridtrack.evaluation.hosting.tracker_process import TrackerProcess
from gridtrack.evaluation.referee.referee import WARM_UP
from gridtrack.evaluation.regression.measurement import Unmeasured
from gridtrack.evaluation.regression.rerun import plan_again, why_edited
from gridtrack.evaluation.regression.speed import CALLS, CallKind, TurnsRow
from gridtrack.evaluation.runs.plan import Trial
from gridtrack.evaluation.runs.trial_record import read_trial_record
from gridtrack.evaluation.scores.definition import Floats
from gridtrack.evaluation.statistics.jackknife import LEVEL
from gridtrack.trackers.selection import Launch

TURN_ROUNDS, ROUND_FRAMES = 8, 40
"""Rounds with new processes, and frames timed in each after the warm-up; every second one is forecast from."""
SHORTEST_MS = 1e-3
PairedTimes = dict[CallKind, list[tuple[float, float]]]
"""Times by call, ms: of the run's tracker, and of the base."""


def timed_in_turns(
    folder: Path, bases: Mapping[str, Launch], margin: float, trackers_toml: Path | None
) -> tuple[TurnsRow, ...]:
    """The trackers of the run in `folder` by label, each timed in turns with its base on the run's first recording.

    Options, weights and seed come from the run, programs from `trackers_toml`. Raises ConfigurationError for an unknown
    label, Unmeasured if a process fails or the tracker changed since the run.
    """
    with TemporaryDirectory(prefix="gridtrack-turns-") as scratch:
        plan = plan_again(folder, Path(scratch), trackers_toml)
        first = {trial.label: trial for trial in reversed(plan.trials)}
        rows: list[TurnsRow] = []
        for label, base in bases.items():
            if label not in first:
                raise ConfigurationError(f"the run has no tracker '{label}'; {did_you_mean(label, first)}")
            rows += _rows_of(first[label], base, folder, Path(scratch), margin)
    return tuple(rows)


def _rows_of(trial: Trial, base: Launch, folder: Path, scratch: Path, margin: float) -> list[TurnsRow]:
    """A row for each call of one tracker."""
    pair = (trial, replace(trial, launch=base))
    try:
        rounds = [_round(pair, number, folder, scratch) for number in range(TURN_ROUNDS)]
    except TrialEnded as ended:
        raise Unmeasured([f"{trial.label}: timed in turns with {base.name}: {ended}"]) from None
    rows = []
    for call in CALLS:
        ratio, low, high = speed_ratio_interval([_log_ratio(times[call]) for times in rounds])
        rows.append(TurnsRow(trial.label, call, base.name, ratio, low, high, len(rounds), margin))
    return rows


def _round(pair: tuple[Trial, Trial], number: int, folder: Path, scratch: Path) -> PairedTimes:
    """The times of two new processes. Their order changes at every second frame, and so at each forecast.

    Raises TrialEnded, Unmeasured.
    """
    times: PairedTimes = {call: [] for call in CALLS}
    with ExitStack() as running:
        logs = [scratch / f"{side}-{number}.log" for side in ("run", "base")]
        both = [running.enter_context(trial.tracker_process(log)) for trial, log in zip(pair, logs, strict=True)]
        _require_same_code(both[0], pair[0], folder)
        for process in both:
            process.reset(pair[0].seed)
        for index, frame in enumerate(islice(pair[0].test, WARM_UP + ROUND_FRAMES)):
            order = (0, 1) if (number + index // 2) % 2 else (1, 0)
            spent = {"update": [0.0, 0.0], "predict": [0.0, 0.0]}
            for side in order:
                both[side].update(frame)
                spent["update"][side] = both[side].last_ms
                if index % 2 == 0:
                    both[side].predict(pair[0].split.steps)
                    spent["predict"][side] = both[side].last_ms
            if index >= WARM_UP:
                times["update"].append((spent["update"][0], spent["update"][1]))
                if index % 2 == 0:
                    times["predict"].append((spent["predict"][0], spent["predict"][1]))
    return times


def _require_same_code(process: TrackerProcess, trial: Trial, folder: Path) -> None:
    """Raise Unmeasured if the tracker was edited since the run."""
    then = read_trial_record(folder / trial.name)
    if why := why_edited(trial.label, process.description.code_sha256, then.code_sha256 if then else ""):
        raise Unmeasured([why])


def _log_ratio(times: Sequence[tuple[float, float]]) -> float:
    """The median over frames of the logarithm of the ratio of the two times."""
    if not times:
        raise Unmeasured(["timed in turns: the recording is too short to time a tracker on"])
    pairs = np.maximum(np.array(times), SHORTEST_MS)
    return float(np.median(np.log(pairs[:, 0] / pairs[:, 1])))


def speed_ratio_interval(log_ratios: Sequence[float]) -> tuple[float, float, float]:
    """The geometric mean of ratios, and the ends of its interval by Student's t over the rounds."""
    values: Floats = np.array(log_ratios)
    mean = float(values.mean())
    half = float(stdtrit(len(values) - 1, 0.5 + LEVEL / 2)) * float(values.std(ddof=1)) / math.sqrt(len(values))
    return math.exp(mean), math.exp(mean - half), math.exp(mean + half)

"""Trials of many recordings as the referee leaves them, without running anything: counts drawn at random."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gridtrack.evaluation.scoring.counting import PROBABILITY_BINS, Tally
from gridtrack.evaluation.scoring.record import ThresholdsUsed, TrialRecord
from gridtrack.evaluation.scoring.scores import ScoreWriter
from gridtrack.evaluation.scoring.strata import STRATA
from gridtrack.evaluation.scoring.thresholds import half
from gridtrack.evaluation.statistics.inference import Ended

STEPS, PERIOD_S = 20, 0.125


def description(frames: int = 40, cycle_s: float | None = None) -> dict[str, object]:
    """A recording as the summary describes it."""
    horizons = [round(step * PERIOD_S, 6) for step in range(STEPS + 1)]
    return {"horizons_s": horizons, "grid": "100x0.2", "frames": frames, "cycle_s": cycle_s}


def tally(rng: np.random.Generator, skill: float, strata: tuple[str, ...] = STRATA) -> Tally:
    """Counts of one frame: `skill` is the share of occupied cells called so, at every step and in every stratum."""
    counted = Tally.empty(STEPS, strata)
    shape = counted.squared_error.shape
    occupied = rng.poisson(30.0, shape)
    found, false = rng.binomial(occupied, skill), rng.poisson(8.0, shape)
    top, bottom = PROBABILITY_BINS - 5, 5
    counted.positives[..., top], counted.positives[..., bottom] = found, occupied - found
    counted.cells[..., top], counted.cells[..., bottom] = found + false, occupied - found + 2000
    counted.p_sum += 0.5 * counted.cells
    counted.squared_error += 0.2 * occupied
    counted.log_loss += 0.4 * occupied
    return counted


def write_trial(
    run: Path,
    label: str,
    recording: str,
    skill: float,
    *,
    seed: int,
    frames: int = 40,
    scored: int | None = None,
    tracker: str = "",
    strata: tuple[str, ...] = STRATA,
    delivered: str = "",
) -> Ended:
    """A trial's folder and record; `seed` draws the frames' counts, `scored` of `frames` where it ended early."""
    folder = run / f"{label}@{recording}"
    folder.mkdir(parents=True)
    rng = np.random.default_rng(seed)
    done = frames if scored is None else scored
    thresholds = half(STEPS, strata)
    with ScoreWriter(folder, STEPS, thresholds) as scores:
        for frame in range(done):
            scores.add(
                (frame + 10) * 1_000_000_000, (delivered + f"{frame:x}").rjust(32, "0"), tally(rng, skill, strata)
            )
    record = TrialRecord(
        schema=1,
        label=label,
        recording=recording,
        outcome="ok" if done == frames else "crashed",
        frames_scored=done,
        frames_expected=frames,
        steps=STEPS,
        thresholds=ThresholdsUsed.of(thresholds),
    )
    record.write(folder)
    return Ended(record, folder, tracker or label, {}, "centres")

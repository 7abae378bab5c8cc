"""Trials of many recordings as the referee leaves them, without running anything: counts drawn at random."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from gridtrack.evaluation.referee.strata import STRATA
from gridtrack.evaluation.results.columns import BEAM_ERROR_BINS, PROBABILITY_BINS, SCALES
from gridtrack.evaluation.runs.run_record import RecordingDescription, RecordingIdentity, RunConfiguration, RunRecord
from gridtrack.evaluation.runs.trial_record import TrialRecord
from gridtrack.evaluation.scoring.beam_errors import BEAM_STRATA, BeamErrors
from gridtrack.evaluation.scoring.counting import Tally, for_calibration
from gridtrack.evaluation.scoring.neighbourhoods import NeighbourhoodSums, neighbourhood_strata
from gridtrack.evaluation.scoring.score_store import ScoreWriter
from gridtrack.evaluation.scoring.spatial_store import SpatialWriter
from gridtrack.evaluation.scoring.thresholds import half
from gridtrack.evaluation.statistics.finished_trial import FinishedTrial

STEPS, PERIOD_S = 20, 0.125
DESCRIBED = {
    "persistence": {"role": "floor", "reference_for": ("occupancy",)},
    "static-map": {"role": "floor"},
    "blank": {"role": "floor"},
    "one-shot": {"reference_for": ("classes",)},
}
"""What these trackers describe themselves as, by their names."""


def description(
    frames: int = 40,
    cycle_s: float | None = None,
    grid: str = "100x0.2",
    classes: tuple[str, ...] = (),
    source_sha256: str = "",
    period_s: float = PERIOD_S,
    steps: int = STEPS,
) -> RecordingDescription:
    """A recording as the summary describes it."""
    return RecordingDescription(
        horizons_s=tuple(round(step * period_s, 6) for step in range(steps + 1)),
        grid=grid,
        frames=frames,
        cycle_s=cycle_s,
        classes=classes,
        source_sha256=source_sha256,
    )


def identity(description: RecordingDescription, sha256: str = "0" * 64) -> RecordingIdentity:
    """A recording as the record of a run identifies it, without a validation stretch."""
    unvalidated = {"validation_s": None, "validation_sha256": ""}
    return RecordingIdentity(**dict(description), stretch_s=(0.0, None), sha256=sha256, **unvalidated)


def write_run_record(folder: Path, recordings: Mapping[str, RecordingDescription]) -> None:
    """The record of a complete run on `recordings`."""
    identities = {name: identity(described) for name, described in recordings.items()}
    RunRecord(
        command=("gridtrack", "compare", "crossing.mcap"),
        configuration=RunConfiguration(recordings=identities, trials={}),
        versions={"gridtrack": "0.1.0"},
        status="complete",
    ).write(folder)


def tally(rng: np.random.Generator, skill: float, strata: tuple[str, ...] = STRATA, steps: int = STEPS) -> Tally:
    """Counts of one frame: `skill` is the share of occupied cells called so, at every step and in every stratum."""
    counted = Tally.empty(steps, strata)
    shape = counted.squared_error.shape
    occupied = rng.poisson(30.0, shape)
    found, false = rng.binomial(occupied, skill), rng.poisson(8.0, shape)
    top, bottom = PROBABILITY_BINS - 5, 5
    counted.positives[..., top], counted.positives[..., bottom] = found, occupied - found
    counted.cells[..., top], counted.cells[..., bottom] = found + false, occupied - found + 2000
    counted.p_sum += 0.5 * for_calibration(counted.cells)
    counted.squared_error += 0.2 * occupied
    counted.log_loss += 0.4 * occupied
    return counted


def spatial_sums(
    rng: np.random.Generator, skill: float, strata: tuple[str, ...] = STRATA, steps: int = STEPS
) -> tuple[NeighbourhoodSums, BeamErrors]:
    """Sums of one frame over neighbourhoods and along beams: the better, the more skill and the larger the scale."""
    own = neighbourhood_strata(strata)
    squares = rng.gamma(20.0, 1.0, (steps + 1, len(own), len(SCALES)))
    agreement = squares * skill ** (1 / np.array(SCALES)) * rng.uniform(0.9, 1.0, squares.shape)
    sums = NeighbourhoodSums(agreement, squares, squares[..., 0], own)
    shape = steps + 1, len(BEAM_STRATA)
    counts = np.zeros((*shape, BEAM_ERROR_BINS), np.int64)
    counts[..., 40:60] = rng.poisson(5.0, (*shape, 20))
    counts[..., 70] = rng.poisson(80.0 * (1.0 - skill), shape)
    return sums, BeamErrors(*(rng.gamma(10.0, 2.0 - skill, (2, *shape))), counts)


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
    start_s: int = 10,
    every_s: int = 1,
    steps: int = STEPS,
) -> FinishedTrial:
    """A trial's folder and record; `seed` draws the counts of its frames, one every `every_s` from `start_s` on.

    Of them `scored` are scored where it ended early.
    """
    folder = run / f"{label}@{recording}"
    folder.mkdir(parents=True)
    rng = np.random.default_rng(seed)
    done = frames if scored is None else scored
    thresholds = half(steps, strata)
    drawn = np.random.default_rng([seed, 1])
    with ScoreWriter(folder, steps, thresholds) as scores, SpatialWriter(folder, steps, strata) as spatial:
        for frame in range(done):
            stamp_ns, digest = (frame * every_s + start_s) * 1_000_000_000, (delivered + f"{frame:x}").rjust(32, "0")
            scores.add(stamp_ns, digest, tally(rng, skill, strata, steps), stamp_ns + round(steps * PERIOD_S * 1e9))
            spatial.add(stamp_ns, *spatial_sums(drawn, skill, strata, steps))
    record = TrialRecord(
        schema=2,
        label=label,
        recording=recording,
        outcome="ok" if done == frames else "crashed",
        frames_scored=done,
        frames_expected=frames,
        steps=steps,
        thresholds=thresholds.used(),
        **DESCRIBED.get(tracker or label, {}),
    )
    record.write(folder)
    return FinishedTrial(record, folder, tracker or label, {}, "centres")

"""Trials of many recordings as the referee leaves them, without running anything: counts drawn at random."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gridtrack.evaluation.referee.strata import STRATA
from gridtrack.evaluation.runs.finished import FinishedTrial
from gridtrack.evaluation.runs.run_record import RecordingDescription, RecordingIdentity, RunConfiguration, RunRecord
from gridtrack.evaluation.runs.scorekeeper import Counter
from gridtrack.evaluation.runs.sums import Layout, SumsWriter, TrialSums
from gridtrack.evaluation.runs.trial_record import ThresholdsUsed, TrialRecord
from gridtrack.evaluation.scores.beam_error import BEAM_ERROR, BINS
from gridtrack.evaluation.scores.cells import PROBABILITY_BINS, Tally, cells_of, for_calibration
from gridtrack.evaluation.scores.class_log_loss import CLASS_LOG_LOSS
from gridtrack.evaluation.scores.definition import ScoreDefinition, TrialFacts
from gridtrack.evaluation.scores.neighbourhoods import (
    SCALES,
    NeighbourhoodSums,
    neighbourhood_strata,
    neighbourhoods_of,
)
from gridtrack.evaluation.scores.registry import built_in
from gridtrack.evaluation.scores.thresholds import half

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


def neighbourhoods(
    rng: np.random.Generator, skill: float, strata: tuple[str, ...] = STRATA, steps: int = STEPS
) -> NeighbourhoodSums:
    """Sums of one frame over neighbourhoods: the better, the more skill and the larger the scale."""
    own = neighbourhood_strata(strata)
    squares = rng.gamma(20.0, 1.0, (steps + 1, len(own), len(SCALES)))
    agreement = squares * skill ** (1 / np.array(SCALES)) * rng.uniform(0.9, 1.0, squares.shape)
    return NeighbourhoodSums(agreement, squares, squares[..., 0], own)


def beam_sums(rng: np.random.Generator, skill: float, facts: TrialFacts) -> Any:
    """Sums (S, K, P) of beam errors of one frame."""
    shape = facts.steps + 1, len(BEAM_ERROR.strata(facts))
    found = np.zeros((*shape, 2 + BINS))
    found[..., :2] = rng.gamma(10.0, 2.0 - skill, (*shape, 2))
    found[..., 42:62] = rng.poisson(5.0, (*shape, 20))
    found[..., 72] = rng.poisson(80.0 * (1.0 - skill), shape)
    return found


class _Drawn:
    """A forecast of which the counts are drawn: it has what scores of cells and neighbourhoods ask for."""

    def __init__(self, stamp_ns: int, observed_ns: int, counts: Mapping[Any, Any]) -> None:
        self.stamp_ns, self._counts = stamp_ns, counts
        self.frames = (type("Frame", (), {"stamp_ns": observed_ns}),)

    def once(self, count: Any) -> Any:
        return self._counts[count]


COUNTED = ("f1", "pr_auc", "log_loss", "brier", "calibration", "fss", "soft_iou")
"""The scores that count a drawn forecast as any other; those of beams are drawn."""


def counted_scores() -> list[ScoreDefinition]:
    """The scores of a synthetic run."""
    return [score for score in built_in() if score.name in COUNTED]


def write_sums(folder: Path, facts: TrialFacts, skill: float, seed: int, frames: Sequence[tuple[int, str]]) -> None:
    """The sums of a trial, drawn with `seed`, of a forecast at each of `frames`, a stamp and a hash."""
    rng, drawn = np.random.default_rng(seed), np.random.default_rng([seed, 1])
    counter, beams = Counter(counted_scores(), facts), Counter([BEAM_ERROR], facts)
    with SumsWriter(folder, counter.layouts | beams.layouts, facts.steps) as sums:
        for stamp_ns, digest in frames:
            counts = {
                cells_of: tally(rng, skill, facts.strata, facts.steps),
                neighbourhoods_of: neighbourhoods(drawn, skill, facts.strata, facts.steps),
            }
            forecast: Any = _Drawn(stamp_ns, stamp_ns + round(facts.steps * PERIOD_S * 1e9), counts)
            for score, found in counter.count(forecast).items():
                sums.add(stamp_ns, digest, score, found)
            sums.add(stamp_ns, digest, BEAM_ERROR.name, beam_sums(drawn, skill, facts))


def write_confusion(
    folder: Path, classes: Sequence[str], counts: Mapping[int, Sequence[Sequence[int]]], steps: int = STEPS
) -> None:
    """Add to the sums of a trial those of one forecast with these confusion matrices of visible cells, by step."""
    facts = TrialFacts(0.2, steps, ("visible",), half(steps, ("visible",)), tuple(classes), tuple(classes))
    layout = Layout(CLASS_LOG_LOSS.strata(facts), CLASS_LOG_LOSS.parts(facts))
    found = np.zeros((steps + 1, 1, len(layout.parts)))
    for step, matrix in counts.items():
        found[step, 0, -np.size(matrix) :] = np.ravel(matrix)
    kept = TrialSums(folder)
    counted = {
        name: kept.by_frame(name, range(steps + 1), own.strata, own.parts).values for name, own in kept.layouts.items()
    }
    frames = list(zip(kept.frames.stamps_ns.tolist(), kept.frames.delivered.tolist(), strict=True))
    with SumsWriter(folder, kept.layouts | {CLASS_LOG_LOSS.name: layout}, steps) as sums:
        for i, (stamp_ns, digest) in enumerate(frames):
            for name, own in counted.items():
                sums.add(stamp_ns, digest, name, own[i])
        sums.add(*frames[0], CLASS_LOG_LOSS.name, found)


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
    done = frames if scored is None else scored
    thresholds = half(steps, strata)
    facts = TrialFacts(cell_m=0.2, steps=steps, strata=strata, thresholds=thresholds)
    stamps = ((frame * every_s + start_s) * 1_000_000_000 for frame in range(done))
    hashes = ((delivered + f"{frame:x}").rjust(32, "0") for frame in range(done))
    write_sums(folder, facts, skill, seed, list(zip(stamps, hashes, strict=True)))
    record = TrialRecord(
        schema=2,
        label=label,
        recording=recording,
        outcome="ok" if done == frames else "crashed",
        frames_scored=done,
        frames_expected=frames,
        steps=steps,
        thresholds=ThresholdsUsed.of(thresholds),
        **DESCRIBED.get(tracker or label, {}),
    )
    record.write(folder)
    return FinishedTrial(record, folder, tracker or label, {}, "centres")

"""Trials of many recordings as the referee leaves them, without running anything: counts drawn at random."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from gridtrack.evaluation.referee.referee import ScoredForecast
from gridtrack.evaluation.referee.strata import STRATA
from gridtrack.evaluation.referee.targets import Target
from gridtrack.evaluation.runs.finished import FinishedTrial
from gridtrack.evaluation.runs.run_record import RecordingDescription, RecordingIdentity, RunConfiguration, RunRecord
from gridtrack.evaluation.runs.scorekeeper import Counter
from gridtrack.evaluation.runs.summarise import summarise
from gridtrack.evaluation.runs.sums import Layout, SumsWriter, TrialSums
from gridtrack.evaluation.runs.trial_record import TRIAL_SCHEMA, ThresholdsUsed, TrialRecord
from gridtrack.evaluation.scores.beam_error import BEAM_ERROR, BINS
from gridtrack.evaluation.scores.brier import BRIER
from gridtrack.evaluation.scores.calibration import CALIBRATION
from gridtrack.evaluation.scores.cells import PROBABILITY_BINS, Tally, cells_of, for_calibration
from gridtrack.evaluation.scores.class_log_loss import CLASS_LOG_LOSS
from gridtrack.evaluation.scores.contact_foresight import CONTACT_FORESIGHT
from gridtrack.evaluation.scores.definition import ScoreDefinition, Sums, TrialFacts
from gridtrack.evaluation.scores.f1 import F1
from gridtrack.evaluation.scores.fss import FSS
from gridtrack.evaluation.scores.log_loss import LOG_LOSS
from gridtrack.evaluation.scores.neighbourhoods import (
    SCALES,
    NeighbourhoodSums,
    neighbourhood_strata,
    neighbourhoods_of,
)
from gridtrack.evaluation.scores.pr_auc import PR_AUC
from gridtrack.evaluation.scores.soft_iou import SOFT_IOU
from gridtrack.evaluation.scores.thresholds import half
from gridtrack.trackers.contract import Forecast

from scenes.scored_cells import frame, region_maps

STEPS, PERIOD_S = 20, 0.125
RECORDINGS = [f"seed-{i:02}" for i in range(20)]
DESCRIBED = {
    "persistence": {"role": "floor", "reference_for": ("occupancy",)},
    "static-map": {"role": "floor"},
    "blank": {"role": "floor"},
    "one-shot": {"reference_for": ("classes",)},
}
"""The descriptions of these trackers, by their names."""
SCORES = (F1, PR_AUC, LOG_LOSS, BRIER, CALIBRATION, FSS, SOFT_IOU, BEAM_ERROR)
"""The scores of a trial: beam errors and contacts, where they are asked for, are drawn, the others counted."""


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


def write_results(
    folder: Path, recordings: Mapping[str, RecordingDescription], trials: Sequence[FinishedTrial]
) -> Path:
    """Write the summary and the record of a complete run of these trials; returns its folder."""
    summarise(recordings, trials, [], False).write(folder)
    write_run_record(folder, recordings)
    return folder


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


def neighbourhood_sums(
    rng: np.random.Generator, skill: float, strata: tuple[str, ...] = STRATA, steps: int = STEPS
) -> NeighbourhoodSums:
    """Sums of one frame over neighbourhoods: the better, the more skill and the larger the scale."""
    own = neighbourhood_strata(strata)
    squares = rng.gamma(20.0, 1.0, (steps + 1, len(own), len(SCALES)))
    agreement = squares * skill ** (1 / np.array(SCALES)) * rng.uniform(0.9, 1.0, squares.shape)
    return NeighbourhoodSums(agreement, squares, squares[..., 0], own)


def beam_sums(rng: np.random.Generator, skill: float, steps: int = STEPS) -> np.ndarray:
    """Sums of one frame along beams (S, K, P): the more skill, the fewer large errors."""
    sums = np.zeros((steps + 1, 1, 2 + BINS))
    sums[..., :2] = rng.gamma(10.0, 2.0 - skill, sums[..., :2].shape)
    sums[..., 42:62] = rng.poisson(5.0, sums[..., 42:62].shape)
    sums[..., 72] = rng.poisson(80.0 * (1.0 - skill), sums.shape[:-1])
    return sums


def contact_sums(rng: np.random.Generator, skill: float, layout: Layout) -> np.ndarray:
    """Sums of one frame over virtual robots (S, K, P): `skill` is the share of contacts with a higher risk than any
    clear path."""
    sums = Sums(np.zeros((len(layout.steps), len(layout.strata), len(layout.parts))), layout.parts)
    contacts, clears = sums.block("contacts"), sums.block("clears")
    met = rng.poisson(20.0, contacts.shape[:-1])
    contacts[..., -5] = rng.binomial(met, skill)
    contacts[..., 5], clears[..., 5] = met - contacts[..., -5], 200.0
    return sums.values


def counted_forecast(stamp_ns: int, last_ns: int, tally: Tally, neighbourhoods: NeighbourhoodSums) -> ScoredForecast:
    """A forecast made at `stamp_ns`, with a last frame at `last_ns`, with counted cells."""
    targets = tuple(Target.of_frame(frame([[1]], [[0]], stamp)) for stamp in (stamp_ns, last_ns))
    maps, ages = region_maps([[2]]), np.zeros((1, 1), np.uint8)
    made = ScoredForecast(Forecast(np.zeros((2, 1, 1), np.float32)), targets, maps, ages)
    made._counted.update({cells_of: tally, neighbourhoods_of: neighbourhoods})
    return made


def write_confusion(
    folder: Path, classes: Sequence[str], counts: Mapping[int, Sequence[Sequence[int]]], steps: int = STEPS
) -> None:
    """Add to the sums of a trial the sums of one forecast with these confusion matrices of visible cells, by step."""
    layout = class_layout(classes, steps)
    found = np.zeros((1, steps + 1, 1, len(layout.parts)))
    for step, matrix in counts.items():
        found[0, step, 0, -np.size(matrix) :] = np.ravel(matrix)
    add_class_sums(folder, layout, found, steps)


def class_layout(classes: Sequence[str], steps: int = STEPS) -> Layout:
    """The layout of the sums of classes of visible cells."""
    facts = TrialFacts(0.2, steps, ("visible",), half(steps, ("visible",)), tuple(classes), tuple(classes))
    return Layout(CLASS_LOG_LOSS.strata(facts), CLASS_LOG_LOSS.parts(facts), CLASS_LOG_LOSS.steps(facts))


def add_class_sums(folder: Path, layout: Layout, found: np.ndarray, steps: int = STEPS) -> None:
    """Add sums of classes (N, S, 1, P), of the first N forecasts, to the sums of a trial."""
    kept = TrialSums(folder)
    counted = {name: kept.by_frame(name, own.steps, own.strata, own.parts).values for name, own in kept.layouts.items()}
    frames = list(zip(kept.frames.stamps_ns.tolist(), kept.frames.delivered.tolist(), strict=True))
    with SumsWriter(folder, kept.layouts | {CLASS_LOG_LOSS.name: layout}, steps) as sums:
        for i, (stamp_ns, digest) in enumerate(frames):
            for name, own in (counted | {CLASS_LOG_LOSS.name: found}).items():
                if i < len(own):
                    sums.add(stamp_ns, digest, name, own[i])


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
    period_s: float = PERIOD_S,
    scores: Sequence[ScoreDefinition] = SCORES,
) -> FinishedTrial:
    """A trial's folder and record; `seed` draws the counts of its frames, one every `every_s` from `start_s` on.

    Of them `scored` are scored where it ended early. `scores` are those that it has.
    """
    folder = run / f"{label}@{recording}"
    folder.mkdir(parents=True)
    rng, drawn = np.random.default_rng(seed), np.random.default_rng([seed, 1])
    done = frames if scored is None else scored
    thresholds = half(steps, strata)
    facts = TrialFacts(0.2, steps, strata, thresholds, period_s=period_s)
    cells = Counter([score for score in scores if score not in (BEAM_ERROR, CONTACT_FORESIGHT)], facts)
    layouts = Counter(scores, facts).layouts
    with SumsWriter(folder, layouts, steps) as writer:
        for number in range(done):
            stamp_ns = (number * every_s + start_s) * 1_000_000_000
            digest, last_ns = (delivered + f"{number:x}").rjust(32, "0"), stamp_ns + round(steps * period_s * 1e9)
            counts = tally(rng, skill, strata, steps), neighbourhood_sums(drawn, skill, strata, steps)
            sums = cells.count(counted_forecast(stamp_ns, last_ns, *counts))
            beams = {BEAM_ERROR.name: beam_sums(drawn, skill, steps)} if BEAM_ERROR in scores else {}
            of_contacts = layouts.get(CONTACT_FORESIGHT.name)
            contacts = {CONTACT_FORESIGHT.name: contact_sums(drawn, skill, of_contacts)} if of_contacts else {}
            for score, own in (sums | beams | contacts).items():
                writer.add(stamp_ns, digest, score, own)
    record = TrialRecord(
        schema=TRIAL_SCHEMA,
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


def summary_of(trials, recordings=RECORDINGS, reference=None, **described):
    """The summary of trials on recordings that are all described alike."""
    return summarise({n: description(**described) for n in recordings}, trials, [], False, reference)


def write_rows(folder, skills, recordings=RECORDINGS, frames=8, apart_s=0, every_s=1, scores=SCORES, **broken):
    """Every label at its skill; seeds differ by recording and not by label, so frames are paired."""
    return [
        write_trial(
            folder,
            label,
            name,
            skill,
            seed=i,
            frames=frames,
            scored=broken.get(label) if i == 0 else None,
            start_s=10 + i * apart_s,
            every_s=every_s,
            scores=scores,
        )
        for i, name in enumerate(recordings)
        for label, skill in skills.items()
    ]


def write_unlike(folder, periods_s, label="persistence", skill=0.6, seconds=2.5, scores=SCORES):
    """One recording of each period, described, and a trial on it."""
    steps = [round(seconds / period_s) for period_s in periods_s]
    names = [f"at-{period_s * 1000:.0f}-ms" for period_s in periods_s]
    trials = [
        write_trial(folder, label, name, skill, seed=i, frames=3, steps=n, scores=scores)
        for i, (name, n) in enumerate(zip(names, steps, strict=True))
    ]
    described = {
        name: description(period_s=period_s, steps=n) for name, period_s, n in zip(names, periods_s, steps, strict=True)
    }
    return described, trials

"""The player of one recording: kept forecasts of every tracker, as many moments as its share of the page allows."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gridtrack.evaluation.referee.samples import SAMPLES, Sample, SamplesError, read_samples
from gridtrack.evaluation.results.columns import SCORES_TABLE
from gridtrack.evaluation.runs.run_record import RecordingIdentity
from gridtrack.reports.moment_choice import ChosenMoment, FrameScore, frame_scores, moments_in_order
from gridtrack.reports.moment_packing import TrackerPlanes, pack_moment
from gridtrack.reports.run import ReportError
from gridtrack.reports.scripts import json_in_page
from gridtrack.reports.still import Still, still_of
from gridtrack.reports.table import MAIN_STRATUM, HeadlineTable, TableRow

OBJECTS_SHOWN = 60
"""Of each forecast, at most."""


@dataclass(frozen=True)
class Player:
    """What the page shows of one recording's kept forecasts: `data` for the script, and a picture without it."""

    data: dict[str, Any]
    still: Still


def player_of(
    table: HeadlineTable, folders: Mapping[str, Path], described: RecordingIdentity, budget: int
) -> tuple[Player | None, tuple[str, ...]]:
    """The player of one recording, whose moments have `budget` bytes, and notices of samples that cannot be read.

    `folders`: the folder of each trial by label. Moments are judged by the scores of cells in motion at the decisive
    step; their times are seconds since the start of the recording. The player is None where no trial kept samples.
    Raises ReportError.
    """
    samples, notices = _kept_samples(table.rows, folders)
    trackers = sorted((row for row in table.rows if samples.get(row.label)), key=lambda row: row.group == "ceiling")
    if not trackers:
        return None, notices
    complete = [row for row in trackers if row.group != "unranked"] or trackers
    reference = samples[complete[0].label]
    first = next(iter(reference.values()))
    _refuse_others(samples, first)
    steps = _steps_of(described, first)
    if not steps:
        return None, notices
    decisive = min(range(len(steps)), key=lambda h: abs(steps[h] - table.decisive.step))
    scores = {row.label: frame_scores(folders[row.label] / SCORES_TABLE.file, steps) for row in trackers}
    order = _order(complete, samples, {label: by_step[steps[decisive]] for label, by_step in scores.items()})
    if not order:
        return None, notices
    time_of = _clock(described, min(reference))
    thresholds = {row.label: _thresholds(row, steps) for row in trackers}
    moments = _within_budget(order, trackers, samples, scores, steps, thresholds, time_of, budget)
    data = {
        "recording": table.recording,
        "size": first.grid.size,
        "cell_m": first.grid.cell_m,
        "origin": list(first.grid.origin),
        "horizons_s": [described.horizons_s[step] for step in steps],
        "decisive": decisive,
        "stratum": MAIN_STRATUM if first.in_motion is not None else "",
        "hidden_known": bool(((first.state == 2) | (first.state == 3)).any()),
        "trackers": [row.label for row in trackers],
        "names": [row.name for row in trackers],
        "kept": len(reference),
        "moments": moments,
    }
    still_at = next((one.stamp_ns for one in order if one.reason == "telling"), order[0].stamp_ns)
    kept_then = {label: kept.get(still_at) for label, kept in samples.items()}
    still = still_of(trackers, kept_then, decisive, time_of(still_at), described.horizons_s[steps[decisive]])
    return Player(data, still), notices


def _clock(described: RecordingIdentity, first_ns: int) -> Callable[[int], float]:
    """The time of a stamp, seconds since the start of the recording; `first_ns`: of the first scored forecast, which is
    made after the warm-up of the stretch and always kept."""
    first_s = described.stretch_s[0] + described.warm_up_frames * described.period_s
    return lambda stamp_ns: first_s + (stamp_ns - first_ns) / 1e9


def _steps_of(described: RecordingIdentity, sample: Sample) -> list[int]:
    """The steps of a sample's horizons, rounded as when they were written: by the rate, as periods have six digits."""
    rate_hz = described.rate_hz or 1 / described.period_s
    last = len(described.horizons_s) - 1
    return [round(min(max(h * rate_hz, 0.0), last)) for h in sample.horizons_s]


def _order(
    rows: Sequence[TableRow],
    samples: Mapping[str, Mapping[int, Sample]],
    scores: Mapping[str, Mapping[int, FrameScore]],
) -> tuple[ChosenMoment, ...]:
    """The kept moments of `rows`, the ones to show first; judged by the trackers that are no floor and no ceiling."""
    kept = {row.label: {s: f for s, f in scores[row.label].items() if s in samples[row.label]} for row in rows}
    judged = [row.label for row in rows if row.group not in ("floor", "ceiling")]
    return moments_in_order(kept, judged or list(kept))


def _kept_samples(
    rows: Sequence[TableRow], folders: Mapping[str, Path]
) -> tuple[dict[str, dict[int, Sample]], tuple[str, ...]]:
    """The samples of each trial by label and stamp; of a damaged file, those before the damage, and a notice."""
    samples: dict[str, dict[int, Sample]] = {}
    notices = []
    for row in rows:
        path = folders[row.label] / SAMPLES
        if not path.exists():
            continue
        own = samples[row.label] = {}
        try:
            own.update((sample.stamp_ns, sample) for sample in read_samples(path))
        except SamplesError as error:
            notices.append(f"{error}: {row.label} has pictures only of the frames before the damage")
    return samples, tuple(notices)


def _refuse_others(samples: Mapping[str, Mapping[int, Sample]], first: Sample) -> None:
    """Raise ReportError for samples of another grid or other horizons than those of `first`."""
    for label, kept in samples.items():
        if any(s.grid != first.grid or s.horizons_s != first.horizons_s for s in kept.values()):
            raise ReportError(
                f"{label}: its samples are of another grid or other horizons than those of the other trackers: run it"
                " again"
            )


def _thresholds(row: TableRow, steps: Sequence[int]) -> list[float]:
    """The threshold of cells in motion at each step; 0.5 where the trial has none."""
    scores = row.trial.strata.get(MAIN_STRATUM)
    found = [None if scores is None else scores.at("threshold", step) for step in steps]
    return [0.5 if value is None else value for value in found]


def _within_budget(
    order: Sequence[ChosenMoment],
    trackers: Sequence[TableRow],
    samples: Mapping[str, Mapping[int, Sample]],
    scores: Mapping[str, Mapping[int, Mapping[int, FrameScore]]],
    steps: Sequence[int],
    thresholds: Mapping[str, Sequence[float]],
    time_of: Callable[[int], float],
    budget: int,
) -> list[dict[str, Any]]:
    """The first moments of `order` that fit into `budget` bytes, at least one, in the order of time."""
    left = budget
    chosen: list[dict[str, Any]] = []
    for moment in order:
        found = {row.label: samples[row.label].get(moment.stamp_ns) for row in trackers}
        seen = next(sample for sample in found.values() if sample is not None)
        planes = [None if s is None else TrackerPlanes.of(s.forecast, thresholds[label]) for label, s in found.items()]
        counts = [[scores[row.label][step].get(moment.stamp_ns) for row in trackers] for step in steps]
        packed = {
            "t": round(time_of(moment.stamp_ns), 3),
            "sensors": [[round(float(x), 2), round(float(y), 2)] for x, y in seen.origins],
            "missing": [label for label, sample in found.items() if sample is None],
            "counts": [[one and [one.tp, one.fp, one.fn] for one in at] for at in counts],
            "objects": [_objects(sample) for sample in found.values()],
            "cells": pack_moment(seen, planes),
        }
        left -= len(json_in_page(packed))
        if left < 0 and chosen:
            break
        chosen.append(packed)
    return sorted(chosen, key=lambda one: one["t"])


def _objects(sample: Sample | None) -> list[list[float]]:
    """Track, x, y, heading, length, width, vx, vy of each object."""
    objects = () if sample is None else sample.objects[:OBJECTS_SHOWN]
    return [[one.track, *(round(value, 2) for value in (*one.box, *one.velocity))] for one in objects]

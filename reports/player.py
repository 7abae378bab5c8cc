"""The player of one recording: kept forecasts of every tracker, in as many moments as fit on the page, and one moment
as still pictures for pages without scripts."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gridtrack.common.grid import GridSpec, Mask, nearest_step
from gridtrack.evaluation.referee.samples import SAMPLES, Sample, SamplesError, read_samples
from gridtrack.evaluation.runs.run_record import RUN_FILE, RecordingIdentity
from gridtrack.evaluation.scores.contact_foresight import ROBOTS_AHEAD_S
from gridtrack.reports.moments import (
    FEW_CELLS,
    ChosenMoment,
    FrameScore,
    forecast_planes,
    frame_scores,
    moments_in_order,
    pack_moment,
)
from gridtrack.reports.pictures import frame_png, probability_png
from gridtrack.reports.robots import alarm_risk_of, robots_of_moment
from gridtrack.reports.run import ReportedRun, ReportError
from gridtrack.reports.scripts import json_in_page
from gridtrack.reports.table import MAIN_STRATUM, HeadlineTable, TableRow

OBJECTS_SHOWN = 60
"""Limit for each forecast."""


@dataclass(frozen=True)
class Picture:
    """One grid as a PNG data address, and its description in words; `png` is empty if there is no picture."""

    png: str
    words: str


@dataclass(frozen=True)
class Still:
    """The input, the observed frame at one horizon, and each tracker's forecast of it.

    `sensors`: their positions in the input, cells from its upper left corner. In the observed frame they may differ.
    """

    grid: GridSpec
    when: str
    horizon: str
    input: Picture
    sensors: tuple[tuple[float, float], ...]
    observed: Picture
    forecasts: tuple[tuple[TableRow, Picture], ...]


@dataclass(frozen=True)
class Player:
    """The kept forecasts of one recording on the page: `data` for the script, and a picture for pages without it."""

    data: dict[str, Any]
    still: Still


def players_of(
    runs: Sequence[ReportedRun], tables: Sequence[HeadlineTable], budget: int
) -> tuple[tuple[Player, ...], tuple[str, ...]]:
    """The player of each recording with kept forecasts, and notices of unreadable files.

    The recordings share `budget` bytes for their moments, but have at least one moment each. The page of several runs
    has no players. Raises ReportError.
    """
    if len(runs) > 1:
        return (), ()
    (run,) = runs
    players: list[Player] = []
    notices: list[str] = []
    single = [table for table in tables if not table.pooled]
    alarm_risks = _alarm_risks(run, single)
    for table in single:
        folders = {row.label: run.trial_folder(row.label, table.recording) for row in table.rows}
        player, unreadable = player_of(table, folders, _identity(run, table), budget // len(single), alarm_risks)
        players += [player] if player else []
        notices += unreadable
    return tuple(players), tuple(notices)


def _identity(run: ReportedRun, table: HeadlineTable) -> RecordingIdentity:
    """The recording of a table. Raises ReportError."""
    described = run.record.configuration.recordings.get(table.recording)
    if described is None:
        raise ReportError(f"{run.path / RUN_FILE}: does not describe {table.recording}; compare again")
    return described


def _alarm_risks(run: ReportedRun, tables: Sequence[HeadlineTable]) -> dict[str, float | None]:
    """The least risk of an alarm of each row, over the recordings of all tables. Raises ReportError."""
    trials: dict[str, list[tuple[Path, int]]] = defaultdict(list)
    for table in tables:
        step = nearest_step(ROBOTS_AHEAD_S, _identity(run, table).period_s)
        for row in table.rows:
            folder = run.trial_folder(row.label, table.recording)
            trials[row.label] += [(folder, step)] if (folder / SAMPLES).exists() else []
    return {label: alarm_risk_of(own) for label, own in trials.items()}


def player_of(
    table: HeadlineTable,
    folders: Mapping[str, Path],
    described: RecordingIdentity,
    budget: int,
    alarm_risks: Mapping[str, float | None],
) -> tuple[Player | None, tuple[str, ...]]:
    """The player of one recording with moments of `budget` bytes, and notices of unreadable samples.

    `folders`: the folder of each trial by label; `alarm_risks` by label. The scores of cells in motion at the decisive
    step order the moments; times are seconds since the start of the recording. The player is None if no trial kept
    samples. Raises ReportError.
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
    scores = {row.label: frame_scores(folders[row.label], steps) for row in trackers}
    order = _order(complete, samples, {label: by_step[steps[decisive]] for label, by_step in scores.items()})
    if not order:
        return None, notices
    time_of = _clock(described, min(reference))
    thresholds = {row.label: _thresholds(row, steps) for row in trackers}
    moments = _within_budget(order, trackers, samples, scores, steps, thresholds, alarm_risks, time_of, budget)
    robots_ahead = nearest_step(ROBOTS_AHEAD_S, described.period_s)
    data = {
        "recording": table.recording,
        "size": first.grid.size,
        "cell_m": first.grid.cell_m,
        "origin": list(first.grid.origin),
        "horizons_s": [described.horizons_s[step] for step in steps],
        "decisive": decisive,
        "robots_at": steps.index(robots_ahead) if robots_ahead in steps else None,
        "stratum": MAIN_STRATUM if first.in_motion is not None else "",
        "hidden_known": bool(((first.state == 2) | (first.state == 3)).any()),
        "trackers": [row.label for row in trackers],
        "names": [row.name for row in trackers],
        "kept": len(reference),
        "moments": moments,
    }
    still_at = next((one.stamp_ns for one in order if one.reason == "different"), order[0].stamp_ns)
    kept_then = {label: kept.get(still_at) for label, kept in samples.items()}
    still = still_of(trackers, kept_then, decisive, time_of(still_at), described.horizons_s[steps[decisive]])
    return Player(data, still), notices


def opening_of(players: Sequence[Player], table: HeadlineTable) -> dict[str, Any] | None:
    """The moment of the first screen: where the best two trackers differ most, or the only one and a floor.

    Of all recordings; None without a moment of both.
    """
    labels = [row.label for group in ("ranked", "floor") for row in table.rows_in(group)][:2]
    found = {
        _difference(data, moment, labels): {"recording": data["recording"], "moment": at, "trackers": labels}
        for data in (
            player.data for player in players if len(labels) == 2 and set(labels) <= set(player.data["trackers"])
        )
        for at, moment in enumerate(data["moments"])
    }
    return found[max(found)] if found else None


def _difference(data: Mapping[str, Any], moment: Mapping[str, Any], labels: Sequence[str]) -> tuple[float, ...]:
    """How much two rows differ in a moment, as a key: in contacts foreseen, then in F1 at the decisive step, where less
    than FEW_CELLS occupied cells come last."""
    one, other = (data["trackers"].index(label) for label in labels)
    paths, alarms = (moment["robots"][name] for name in ("paths", "alarms")) if moment["robots"] else ((), ())
    foreseen = [
        sum(alarm == "1" and bool(path[5]) for path, alarm in zip(paths, alarms[at], strict=True))
        for at in (one, other)
        if alarms and alarms[at] is not None
    ]
    scores = [FrameScore(*counts) for at in (one, other) if (counts := moment["counts"][data["decisive"]][at])]
    contacts = abs(foreseen[0] - foreseen[1]) if len(foreseen) == 2 else 0
    if len(scores) < 2:
        return contacts, 0.0, 0.0, 0
    return contacts, scores[0].occupied >= FEW_CELLS, abs(scores[0].f1 - scores[1].f1), scores[0].occupied


def _clock(described: RecordingIdentity, first_ns: int) -> Callable[[int], float]:
    """The time of a stamp, seconds since the start of the recording.

    `first_ns`: the stamp of the first scored forecast, which follows the warm-up of the stretch and is always kept.
    """
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
    """The kept moments of `rows` in the order of their importance for trackers other than floors and ceilings."""
    kept = {row.label: {s: f for s, f in scores[row.label].items() if s in samples[row.label]} for row in rows}
    judged = [row.label for row in rows if row.group not in ("floor", "ceiling")]
    return moments_in_order(kept, judged or list(kept))


def _kept_samples(
    rows: Sequence[TableRow], folders: Mapping[str, Path]
) -> tuple[dict[str, dict[int, Sample]], tuple[str, ...]]:
    """The samples of each trial by label and stamp; a damaged file has its samples before the damage, and a notice."""
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
    """Raise ReportError for samples of another grid or other horizons than `first`."""
    for label, kept in samples.items():
        if any(s.grid != first.grid or s.horizons_s != first.horizons_s for s in kept.values()):
            raise ReportError(
                f"{label}: its samples have another grid or other horizons than the other trackers': run it again"
            )


def _thresholds(row: TableRow, steps: Sequence[int]) -> list[float]:
    """The threshold of cells in motion at each step; 0.5 if the trial has none."""
    curve = row.trial.thresholds.get(MAIN_STRATUM)
    found = [None if curve is None else curve[step] for step in steps]
    return [0.5 if value is None else value for value in found]


def _within_budget(
    order: Sequence[ChosenMoment],
    trackers: Sequence[TableRow],
    samples: Mapping[str, Mapping[int, Sample]],
    scores: Mapping[str, Mapping[int, Mapping[int, FrameScore]]],
    steps: Sequence[int],
    thresholds: Mapping[str, Sequence[float]],
    alarm_risks: Mapping[str, float | None],
    time_of: Callable[[int], float],
    budget: int,
) -> list[dict[str, Any]]:
    """The first moments of `order` that fit into `budget` bytes, at least one, in the order of time."""
    left = budget
    chosen: list[dict[str, Any]] = []
    for moment in order:
        found = {row.label: samples[row.label].get(moment.stamp_ns) for row in trackers}
        seen = next(sample for sample in found.values() if sample is not None)
        planes = [None if s is None else forecast_planes(s.forecast, thresholds[label]) for label, s in found.items()]
        counts = [[scores[row.label][step].get(moment.stamp_ns) for row in trackers] for step in steps]
        packed = {
            "t": round(time_of(moment.stamp_ns), 3),
            "sensors": [[round(float(x), 2), round(float(y), 2)] for x, y in seen.origins],
            "missing": [label for label, sample in found.items() if sample is None],
            "counts": [[one and [one.tp, one.fp, one.fn] for one in at] for at in counts],
            "objects": [_objects(sample) for sample in found.values()],
            "robots": robots_of_moment(found, alarm_risks),
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


def still_of(
    trackers: Sequence[TableRow], samples: Mapping[str, Sample | None], h: int, now_s: float, horizon_s: float
) -> Still:
    """The pictures of one moment at horizon `h`, `horizon_s` ahead; `samples` has at least one sample, by label."""
    seen = next(sample for sample in samples.values() if sample is not None)
    now, horizon = f"{now_s:.1f} s", f"{horizon_s:.3g} s"
    visible, occupied = seen.observed_visible[h], seen.observed_occupied[h]
    return Still(
        seen.grid,
        now,
        horizon,
        _frame_picture(f"Input at {now}", seen.visible, seen.occupied),
        _sensors(seen),
        _frame_picture(f"Observed {horizon} after {now}", visible, occupied),
        tuple((row, _forecast_picture(row.name, samples.get(row.label), h, now, horizon)) for row in trackers),
    )


def _frame_picture(title: str, visible: Mask, occupied: Mask) -> Picture:
    words = f"{title}: {visible.sum()} cells visible, {occupied.sum()} of them occupied"
    return Picture(frame_png(visible, occupied), words)


def _forecast_picture(name: str, sample: Sample | None, h: int, now: str, horizon: str) -> Picture:
    if sample is None:
        return Picture("", f"{name} has no forecast at {now}")
    expected = float(sample.forecast[h].sum())
    words = f"{name}: forecast for {horizon} after {now}, {expected:.0f} cells expected to be occupied"
    return Picture(probability_png(sample.forecast[h]), words)


def _sensors(sample: Sample) -> tuple[tuple[float, float], ...]:
    """Positions of the sensors inside the picture: cells, x from the left and y from the top."""
    cells = (sample.origins - np.array(sample.grid.origin, np.float32)) / np.float32(sample.grid.cell_m)
    size = sample.grid.size
    return tuple((round(x, 1), round(size - y, 1)) for x, y in cells.tolist() if 0 <= x <= size and 0 <= y <= size)

"""Two lasers on opposite corners of the junction beside one: hidden cells, F1 on the same cells, and conflicts.

`python -m studies.two_sensors [TRACKER...] [--out docs/results/moving/two_sensors.json]` (half an hour on a free core):
the traffic of the twenty test minutes, seen as by `gridtrack simulate junction --sensor corners`. The one laser is the
one on the north-western corner, with the same scans; the weights that ship were learned with it.

The visible cells depend on the lasers, so three sets of cells are scored. By truth: all cells, occupied if a true
outline crosses them, the same for both. Cells of the one laser: visible cells by its scans, hidden ones by the
outlines; the second laser is then an advantage of the input only. Own cells: two lasers on the cells that they see.
Thresholds are chosen on a signal cycle of the validation recording, for each input and set of cells.

A cell is in conflict if a beam of one laser ends in it and a beam of the other passes it. Three rules to settle it are
compared with the true outlines: occupied wins (the rule of the grid stream), the nearer sensor wins, and free wins.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from gridtrack.common.grid import GridSpec, Mask
from gridtrack.common.raycast import cast_scan
from gridtrack.common.scan import Scan
from gridtrack.evaluation.referee.kinds import regions_of
from gridtrack.evaluation.referee.referee import Schedule, moments
from gridtrack.evaluation.referee.strata import STRATA_WITH_TRUTH, RegionMaps
from gridtrack.evaluation.referee.targets import Target, target_of
from gridtrack.evaluation.scores.cells import Tally, count_cells
from gridtrack.evaluation.scores.definition import Ratio
from gridtrack.evaluation.scores.thresholds import best_thresholds
from gridtrack.evaluation.statistics import jackknife
from gridtrack.evaluation.statistics.jackknife import Replicates, interval, ratio_replicates
from gridtrack.recordings import ReadOptions, Recording, open_recording
from gridtrack.recordings.observation import Observation
from gridtrack.recordings.recording import Topics
from gridtrack.recordings.stream import GridStream
from gridtrack.recordings.truth import OUTLINE, truth_grid
from gridtrack.simulation.junction import TWO_CORNERS, seen
from gridtrack.simulation.tracks_file import read_tracks
from gridtrack.trackers.contract import Tracker

from studies.support.results_file import (
    ResultSection,
    ResultTable,
    measured_table,
    score_text,
    study_parser,
    write_section,
)
from studies.support.shipped import JUNCTION, STEPS, junction_tests, shipped_tracker

TRACKERS = ("persistence", "kalman", "factor-graph", "dogma", "dilated-convgru", "deep-tracking-rnn")
HORIZONS = {"0.5 s": 4, "1 s": 8, "2.5 s": STEPS}
EVERY = 16
"""Frames from one forecast to the next."""
VALIDATION_FRAMES = 768
"""A signal cycle of 96 s."""
STRATA = ("dynamic", "in-motion", "visible", "occluded", "occluded dynamic")
OF_ONE, BY_TRUTH, TWO_ON_CELLS_OF_ONE, TWO_BY_TRUTH, TWO_ON_OWN_CELLS = range(5)
"""Sides: forecasts from one laser and from two lasers, each on a set of scored cells."""
RULES = ("occupied wins", "the nearer sensor wins", "free wins")
COMMAND = "python -m studies.two_sensors"


class Cells(NamedTuple):
    """A set of scored cells: the target of each frame, and the regions of the window, which does not move."""

    target: Callable[[int], Target]
    region_maps: RegionMaps


class Views(NamedTuple):
    """The same time seen by one laser and by two, and the sets of cells: of one, by truth, of two."""

    streams: tuple[GridStream, GridStream]
    cells: tuple[Cells, Cells, Cells]


class HeldRecording(Recording):
    """Scans in memory as a recording, so that nothing is read or decoded. Metadata and hash are from `origin`."""

    def __init__(self, held: Sequence[Scan], origin: Recording) -> None:
        super().__init__(origin.path, ReadOptions())
        self.held, self.info = held, origin.info

    def read(self, topics: Topics) -> Iterator[Scan]:
        """The scans."""
        topics.add("scan", "held", is_scan=True)
        return iter(self.held)


def views_of(tracks: Path, frames: int) -> Views:
    """The first `frames` of the traffic in a file of tracks, seen by one laser and by two."""
    origin, traffic = open_recording(tracks), read_tracks(tracks)
    first = next(iter(TWO_CORNERS.lasers))
    scans = list(islice(seen(traffic, TWO_CORNERS, COMMAND).scans(), frames * len(TWO_CORNERS.lasers)))
    of_first = [scan for scan in scans if scan.sensor == first]
    one, two = (GridStream(HeldRecording(held, origin)) for held in (of_first, scans))
    seen_by_one, seen_by_two = visible_cells(one), visible_cells(two)
    return Views((one, two), (seen_by_one, true_cells(one, seen_by_one.region_maps), seen_by_two))


def visible_cells(stream: GridStream) -> Cells:
    """The targets of the referee: visible cells by the scans, hidden ones by the true outlines."""
    found = list(moments(stream, regions_of(stream, STRATA_WITH_TRUTH)))
    return Cells(lambda index: found[index].target, found[0].region_maps)


def true_cells(stream: GridStream, region_maps: RegionMaps) -> Cells:
    """Targets in which every cell is hidden, so that all are scored by the true outlines."""
    observed = list(stream.observations())

    def target(index: int) -> Target:
        hidden = replace(observed[index].frame, visible=np.zeros(stream.grid.shape, np.bool_))
        return target_of(replace(observed[index], frame=hidden), stream.grid, stream.classes, no_motion)

    no_motion = np.zeros(stream.grid.shape, np.uint8)
    return Cells(target, region_maps)


def counted(tracker: Tracker, stream: GridStream, scored: Sequence[Cells]) -> list[Tally]:
    """Counts of the forecasts from the frames of `stream`, at HORIZONS, on each of the `scored` cells."""
    tracker.reset(0)
    schedule, ahead = Schedule(len(stream), STEPS, EVERY), list(HORIZONS.values())
    tallies = [Tally.empty(len(HORIZONS) - 1, STRATA_WITH_TRUTH) for _ in scored]
    for index, frame in enumerate(stream):
        tracker.update(frame)
        if schedule.due(index):
            occupancy = tracker.predict(STEPS).occupancy[ahead]
            for tally, cells in zip(tallies, scored, strict=True):
                targets = [cells.target(index + step) for step in ahead]
                tally.add(count_cells(occupancy, targets, cells.region_maps))
    return [tally.of(STRATA) for tally in tallies]


def of_sides(name: str, views: Views) -> list[Tally]:
    """Counts of a tracker for each side."""
    (one, two), (of_one, by_truth, of_two) = views
    return [
        *counted(shipped_tracker(name, one), one, [of_one, by_truth]),
        *counted(shipped_tracker(name, two), two, [of_one, by_truth, of_two]),
    ]


def measured(
    trackers: Sequence[str], minutes: Sequence[Path]
) -> tuple[dict[str, NDArray[np.float64]], NDArray[np.int64]]:
    """TP, FP, FN and TN (side, minute, horizon, stratum, 4) of each tracker; cells (side, minute, horizon, stratum, 2).

    The cells are all scored ones and the occupied ones.
    """
    views = views_of(JUNCTION / "validation.tracks", VALIDATION_FRAMES)
    thresholds = {name: [best_thresholds(t, "validation").bins for t in of_sides(name, views)] for name in trackers}
    print("validation.tracks", flush=True)
    counts: dict[str, list[list[NDArray[np.float64]]]] = {name: [] for name in trackers}
    cells: list[list[NDArray[np.int64]]] = []
    for minute in minutes:
        views = views_of(minute, len(GridStream(open_recording(minute))))
        for name in trackers:
            tallies = of_sides(name, views)
            counts[name].append([tally.confusion(bins) for tally, bins in zip(tallies, thresholds[name], strict=True)])
        cells.append([np.stack([tally.cells.sum(-1), tally.positives.sum(-1)], axis=-1) for tally in tallies])
        print(minute.name, flush=True)
    return {name: np.array(values).swapaxes(0, 1) for name, values in counts.items()}, np.array(cells).swapaxes(0, 1)


def f1_of(counts: NDArray[np.float64]) -> Replicates:
    """F1 of TP, FP, FN and TN (minute, 4), a minute as a unit."""
    tp, fp, fn, _ = np.moveaxis(counts.astype(np.float64), -1, 0)
    return ratio_replicates(Ratio(2.0 * tp, 2.0 * tp + fp + fn, counted=True))


def difference(own: Replicates, reference: Replicates) -> str:
    """A difference with its interval."""
    found = jackknife.difference(own, reference)
    return score_text(*map(float, (found.value, found.low, found.high)), signed=True)


def score_table(counts: Mapping[str, NDArray[np.float64]], stratum: str, sides: tuple[int, int]) -> ResultTable:
    """F1 of every tracker in a stratum on two sides, and their paired difference, by horizon."""
    k, rows = STRATA.index(stratum), []
    for name, of_tracker in counts.items():
        row = [name]
        for step in range(len(HORIZONS)):
            one, two = (f1_of(of_tracker[side][:, step, k]) for side in sides)
            row += [*(score_text(float(each.value)) for each in (one, two)), difference(two, one)]
        rows.append(row)
    columns = ["tracker", *(f"{side}, {at}" for at in HORIZONS for side in ("one", "two", "difference"))]
    return measured_table(columns, rows)


def hidden_table(cells: NDArray[np.int64]) -> ResultTable:
    """The hidden share of all cells and of the occupied dynamic cells, with one laser and with two."""
    rows = []
    for words, hidden, visible, kind in (
        ("cells of the window", "occluded", "visible", 0),
        ("occupied dynamic cells", "occluded dynamic", "dynamic", 1),
    ):
        sides, row = [], [words]
        for side in (OF_ONE, TWO_ON_OWN_CELLS):
            of_side = cells[side][:, 0, :, kind].astype(np.float64)
            part, rest = (of_side[:, STRATA.index(name)] for name in (hidden, visible))
            sides.append(ratio_replicates(Ratio(part, part + rest)))
            found = interval(sides[-1], "log")
            row.append(score_text(*map(float, (found.value, found.low, found.high))))
        rows.append([*row, difference(sides[1], sides[0])])
    return measured_table(("hidden share of the", "one laser", "two lasers", "difference"), rows)


def section_of(counts: Mapping[str, NDArray[np.float64]], cells: NDArray[np.int64]) -> ResultSection:
    """Hidden cells, and F1 on each set of cells."""
    tables = {"hidden": hidden_table(cells)}
    for title, stratum, one, two in (
        ("by truth, dynamic", "occluded dynamic", BY_TRUTH, TWO_BY_TRUTH),
        ("by truth, all", "occluded", BY_TRUTH, TWO_BY_TRUTH),
        *((f"cells of one, {name}", name, OF_ONE, TWO_ON_CELLS_OF_ONE) for name in STRATA),
        *((f"own cells, {name}", name, OF_ONE, TWO_ON_OWN_CELLS) for name in STRATA),
    ):
        tables[title] = score_table(counts, stratum, (one, two))
    return ResultSection(command=COMMAND, tables=tables)


def views_of_sensors(observation: Observation, grid: GridSpec) -> NDArray[np.float64]:
    """For each sensor (S, 3, M, M): visible cells, occupied cells, and its distance from the cells, metres."""
    centres = grid.cell_centres(np.ones(grid.shape, np.bool_)).reshape(*grid.shape, 2)
    found = []
    for scan, pose in zip(observation.scans, observation.grid_T_sensor, strict=True):
        visible, occupied = np.zeros((2, *grid.shape), np.bool_)
        cast_scan(scan, grid, pose, visible, occupied)
        found.append([visible, occupied, np.hypot(centres[..., 0] - pose.x, centres[..., 1] - pose.y)])
    return np.array(found, np.float64)


def settled(views: NDArray[np.float64]) -> tuple[Mask, Mask, list[Mask]]:
    """Visible cells (M, M), cells in conflict, and occupied cells by each of RULES."""
    visible, occupied, distance_m = views[:, 0] > 0, views[:, 1] > 0, views[:, 2]
    passes = visible & ~occupied
    ended_at_m = np.where(occupied, distance_m, np.inf).min(axis=0)
    passed_at_m = np.where(passes, distance_m, np.inf).min(axis=0)
    union: Mask = np.logical_or.reduce(occupied, axis=0)
    conflict: Mask = union & np.logical_or.reduce(passes, axis=0)
    seen_at_all: Mask = np.logical_or.reduce(visible, axis=0)
    return seen_at_all, conflict, [union, union & (ended_at_m < passed_at_m), union & ~conflict]


def by_two_lasers(minutes: Sequence[Path]) -> Iterator[GridStream]:
    """The traffic of these minutes, seen by two lasers."""
    for tracks in minutes:
        scans = list(seen(read_tracks(tracks), TWO_CORNERS, COMMAND).scans())
        yield GridStream(HeldRecording(scans, open_recording(tracks)))


def conflict_section(streams: Iterable[GridStream]) -> ResultSection:
    """The occupied cells of each rule against the true outlines, and the share of cells in conflict."""
    counts, conflicts = np.zeros((len(RULES), 3), np.int64), np.zeros(3, np.int64)
    for stream in streams:
        for observation in stream.observations():
            if observation.scene is None:
                continue
            outlines = truth_grid(observation.scene, stream.grid, observation.reference_T_grid).cover == OUTLINE
            visible, conflict, by_rule = settled(views_of_sensors(observation, stream.grid))
            conflicts += [by_rule[0].sum(), conflict.sum(), (conflict & outlines).sum()]
            for rule, called in enumerate(by_rule):
                true = outlines & visible
                counts[rule] += [(called & true).sum(), (called & ~true).sum(), (true & ~called).sum()]
    occupied, disputed, surfaces = conflicts.tolist()
    rows = []
    for name, (hits, alarms, missed) in zip(RULES, counts.tolist(), strict=True):
        scores = hits / (hits + alarms), hits / (hits + missed), 2 * hits / (2 * hits + alarms + missed)
        rows.append([name, *(f"{score:.3f}" for score in scores)])
    values = {
        "in a conflict, % of the occupied cells": f"{100 * disputed / occupied:.1f}",
        "with an outline, %": f"{100 * surfaces / max(disputed, 1):.0f}",
    }
    table = measured_table(("a cell in a conflict", "precision", "recall", "F1"), rows)
    return ResultSection(command=COMMAND, tables={"rules": table}, values=values)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__, "docs/results/moving/two_sensors.json")
    parser.add_argument("trackers", nargs="*", default=TRACKERS, help=f"default: {' '.join(TRACKERS)}")
    parser.add_argument("--minutes", type=int, help="number of test minutes; default: all twenty")
    given = parser.parse_args(arguments)
    torch.set_num_threads(1)
    minutes = junction_tests()[: given.minutes]
    sections = {
        "conflicts": conflict_section(by_two_lasers(minutes)),
        "two lasers": section_of(*measured(given.trackers, minutes)),
    }
    for name, section in sections.items():
        print(section.text(), end="\n\n")
        write_section(given.out, name, section)


if __name__ == "__main__":
    main()

"""Two lasers on opposite corners of the junction beside one of them: hidden cells, and F1 on the same cells.

`python -m studies.two_sensors [TRACKER...] [--out docs/results/moving/two_sensors.json]` (half an hour on a free core).
The traffic of the twenty test minutes, seen as by `gridtrack simulate junction --sensor corners`. The one laser is that
on the north-western corner, with the same scans; the weights that ship were learned with it.

Which cells are visible depends on the lasers, so three sets of cells are scored. By truth: all cells, occupied where a
true outline crosses them, the same for both. Those of the one laser: visible cells by its scans, hidden ones by the
outlines; the second laser is then an advantage of the input only. And two lasers on the cells that they see themselves.
Thresholds are chosen on a signal cycle of the validation recording, for each input and set of cells.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from gridtrack.evaluation.referee.kinds import regions_of
from gridtrack.evaluation.referee.motion import ObservedMotion
from gridtrack.evaluation.referee.referee import Schedule, moments
from gridtrack.evaluation.referee.strata import STRATA_WITH_TRUTH, RegionMaps
from gridtrack.evaluation.referee.targets import Target, target_of
from gridtrack.evaluation.scores.cells import Tally, count_cells
from gridtrack.evaluation.scores.thresholds import best_thresholds
from gridtrack.evaluation.statistics.jackknife import PairedDifferences, pooled, ratio_differences, ratio_interval
from gridtrack.recordings import open_recording
from gridtrack.recordings.stream import GridStream
from gridtrack.reports import differences
from gridtrack.simulation.junction import TWO_CORNERS, seen
from gridtrack.simulation.tracks_file import read_tracks
from gridtrack.trackers.contract import Tracker

from studies.support.held_recording import HeldRecording
from studies.support.results_file import ResultSection, ResultTable, measured_table, write_section
from studies.support.shipped import JUNCTION, STEPS, junction_tests, shipped_tracker

TRACKERS = ("persistence", "kalman", "factor-graph", "dogma", "dilated-convgru", "deep-tracking-rnn")
HORIZONS = {"0.5 s": 4, "1 s": 8, "2.5 s": STEPS}
EVERY = 16
"""Frames from one forecast to the next."""
VALIDATION_FRAMES = 768
"""A signal cycle of 96 s."""
STRATA = ("dynamic", "in-motion", "visible", "occluded", "occluded dynamic")
OF_ONE, BY_TRUTH, TWO_ON_CELLS_OF_ONE, TWO_BY_TRUTH, TWO_ON_OWN_CELLS = range(5)
"""Sides: what one laser and two lasers forecast, each on cells that are scored."""
COMMAND = "python -m studies.two_sensors"


class Cells(NamedTuple):
    """Cells and states to score: the target of each frame, and the regions of the window, which stays."""

    target: Callable[[int], Target]
    region_maps: RegionMaps


class Views(NamedTuple):
    """The same time as seen by one laser and by two, and the cells to score: of one, by truth, of two."""

    streams: tuple[GridStream, GridStream]
    cells: tuple[Cells, Cells, Cells]


def views_of(tracks: Path, frames: int) -> Views:
    """The first `frames` of the traffic in a file of tracks, as seen by one laser and by two."""
    origin, traffic = open_recording(tracks), read_tracks(tracks)
    first = next(iter(TWO_CORNERS.lasers))
    scans = list(islice(seen(traffic, TWO_CORNERS, COMMAND).scans(), frames * len(TWO_CORNERS.lasers)))
    of_first = [scan for scan in scans if scan.sensor == first]
    one, two = (GridStream(HeldRecording(held, origin)) for held in (of_first, scans))
    seen_by_one, seen_by_two = visible_cells(one), visible_cells(two)
    return Views((one, two), (seen_by_one, true_cells(one, seen_by_one.region_maps), seen_by_two))


def visible_cells(stream: GridStream) -> Cells:
    """The targets of the referee: visible cells by the scans, hidden ones by the true outlines."""
    found = list(moments(stream, regions_of(stream, STRATA_WITH_TRUTH), ObservedMotion(stream)))
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
    """Counts of a tracker for each of the sides."""
    (one, two), (of_one, by_truth, of_two) = views
    return [
        *counted(shipped_tracker(name, one), one, [of_one, by_truth]),
        *counted(shipped_tracker(name, two), two, [of_one, by_truth, of_two]),
    ]


def measured(
    trackers: Sequence[str], minutes: Sequence[Path]
) -> tuple[dict[str, NDArray[np.float64]], NDArray[np.int64]]:
    """Counts (side, minute, horizon, stratum, C) of each tracker, and cells (side, minute, horizon, stratum, 2): all
    that are scored, and the occupied ones."""
    views = views_of(JUNCTION / "validation.tracks", VALIDATION_FRAMES)
    thresholds = {name: [best_thresholds(t, "validation").bins for t in of_sides(name, views)] for name in trackers}
    print("validation.tracks", flush=True)
    counts: dict[str, list[list[NDArray[np.float64]]]] = {name: [] for name in trackers}
    cells: list[list[NDArray[np.int64]]] = []
    for minute in minutes:
        views = views_of(minute, len(GridStream(open_recording(minute))))
        for name in trackers:
            tallies = of_sides(name, views)
            counts[name].append([counts_of(*each) for each in zip(tallies, thresholds[name], strict=True)])
        cells.append([np.stack([tally.cells.sum(-1), tally.positives.sum(-1)], axis=-1) for tally in tallies])
        print(minute.name, flush=True)
    return {name: np.array(values).swapaxes(0, 1) for name, values in counts.items()}, np.array(cells).swapaxes(0, 1)


def counts_of(tally: Tally, bins: NDArray[np.int64]) -> NDArray[np.float64]:
    """The counts (horizon, stratum, C) of the statistics, at thresholds (horizon, stratum)."""
    sums = np.stack([tally.squared_error, tally.log_loss], axis=-1)
    return np.concatenate([tally.confusion(bins), sums], axis=-1)


def short(value: float, *, signed: bool = False) -> str:
    return f"{value:{'+' if signed else ''}.3f}"


def with_interval(value: float, low: float, high: float, *, signed: bool = False) -> str:
    """`0.534 [0.501, 0.567]`; without the interval where there are too few minutes for one."""
    text = partial(short, signed=signed)
    return text(value) if np.isnan(low) else f"{text(value)} [{text(low)}, {text(high)}]"


def difference(found: PairedDifferences) -> str:
    return with_interval(float(found.value), float(found.low), float(found.high), signed=True)


def score_table(counts: Mapping[str, NDArray[np.float64]], stratum: str, sides: tuple[int, int]) -> ResultTable:
    """F1 of every tracker in a stratum, of two sides and their paired difference, by horizon."""
    k, rows = STRATA.index(stratum), []
    for name, of_tracker in counts.items():
        row = [name]
        for step in range(len(HORIZONS)):
            one, two = (of_tracker[side][:, step, k] for side in sides)
            row += [short(float(pooled(each, "f1"))) for each in (one, two)]
            row.append(difference(differences(two, one, "f1")))
        rows.append(row)
    columns = ["tracker", *(f"{side}, {at}" for at in HORIZONS for side in ("one", "two", "difference"))]
    return measured_table(columns, rows)


def hidden_table(cells: NDArray[np.int64]) -> ResultTable:
    """The share of hidden cells, and of the occupied dynamic cells, of one laser and of two."""
    rows = []
    for words, hidden, visible, kind in (
        ("cells of the window", "occluded", "visible", 0),
        ("occupied dynamic cells", "occluded dynamic", "dynamic", 1),
    ):
        sides, row = [], [words]
        for side in (OF_ONE, TWO_ON_OWN_CELLS):
            of_side = cells[side][:, 0, :, kind].astype(np.float64)
            part, rest = (of_side[:, STRATA.index(name)] for name in (hidden, visible))
            sides.append((part, part + rest))
            value = part.sum() / (part + rest).sum()
            row.append(with_interval(value, *map(float, ratio_interval(part, part + rest))))
        rows.append([*row, difference(ratio_differences(sides[1], sides[0]))])
    return measured_table(("hidden share of the", "one laser", "two lasers", "difference"), rows)


def section_of(counts: Mapping[str, NDArray[np.float64]], cells: NDArray[np.int64]) -> ResultSection:
    """The tables of the page."""
    tables = {"hidden": hidden_table(cells)}
    for title, stratum, one, two in (
        ("by truth, dynamic", "occluded dynamic", BY_TRUTH, TWO_BY_TRUTH),
        ("by truth, all", "occluded", BY_TRUTH, TWO_BY_TRUTH),
        *((f"cells of one, {name}", name, OF_ONE, TWO_ON_CELLS_OF_ONE) for name in STRATA),
        *((f"own cells, {name}", name, OF_ONE, TWO_ON_OWN_CELLS) for name in STRATA),
    ):
        tables[title] = score_table(counts, stratum, (one, two))
    return ResultSection(command=COMMAND, tables=tables)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("trackers", nargs="*", default=TRACKERS, help=f"default: {' '.join(TRACKERS)}")
    parser.add_argument("--minutes", type=int, help="the first so many of the twenty")
    parser.add_argument("--out", type=Path, help="results file that keeps the tables")
    given = parser.parse_args()
    torch.set_num_threads(1)
    section = section_of(*measured(given.trackers, junction_tests()[: given.minutes]))
    for name, table in section.tables.items():
        print(f"\n{name}\n{table.markdown()}")
    if given.out is not None:
        write_section(given.out, "two lasers", section)


if __name__ == "__main__":
    main()

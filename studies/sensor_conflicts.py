"""How a cell is settled in which a beam of one sensor ends and one of another sensor passes, against the true outlines.

`python -m studies.sensor_conflicts [RECORDING...] [--out docs/results/moving/two_sensors.json]` (three minutes) reads
recordings with truth and several sensors; default: the test minutes of the junction as two lasers on opposite corners
see them. Of the cells in such a conflict it counts those that have a true outline; and of each rule the precision,
recall and F1 of the occupied cells among the visible ones. Three rules: occupied wins (that of the grid stream), the
nearer sensor wins, and free wins.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import GridSpec, Mask
from gridtrack.common.raycast import cast_scan
from gridtrack.recordings import open_recording
from gridtrack.recordings.observation import Observation
from gridtrack.recordings.stream import GridStream, open_stream
from gridtrack.recordings.truth import OUTLINE, truth_grid
from gridtrack.simulation.junction import TWO_CORNERS, seen
from gridtrack.simulation.tracks_file import read_tracks

from studies.support.held_recording import HeldRecording
from studies.support.results_file import ResultSection, measured_table, write_section
from studies.support.shipped import junction_tests

COMMAND = "python -m studies.sensor_conflicts"
RULES = ("occupied wins", "the nearer sensor wins", "free wins")


def views(observation: Observation, grid: GridSpec) -> NDArray[np.float64]:
    """Of each sensor (S, 3, M, M): visible, occupied, and its distance to the cells, metres."""
    centres = grid.cell_centres(np.ones(grid.shape, np.bool_)).reshape(*grid.shape, 2)
    found = []
    for scan, pose in zip(observation.scans, observation.grid_T_sensor, strict=True):
        visible, occupied = np.zeros((2, *grid.shape), np.bool_)
        cast_scan(scan, grid, pose, visible, occupied)
        found.append([visible, occupied, np.hypot(centres[..., 0] - pose.x, centres[..., 1] - pose.y)])
    return np.array(found, np.float64)


def settled(seen: NDArray[np.float64]) -> tuple[Mask, Mask, list[Mask]]:
    """Cells (M, M) that any sensor sees, those in a conflict, and the occupied ones by each rule."""
    visible, occupied, distance_m = seen[:, 0] > 0, seen[:, 1] > 0, seen[:, 2]
    passes = visible & ~occupied
    ended_at_m = np.where(occupied, distance_m, np.inf).min(axis=0)
    passed_at_m = np.where(passes, distance_m, np.inf).min(axis=0)
    union: Mask = np.logical_or.reduce(occupied, axis=0)
    conflict: Mask = union & np.logical_or.reduce(passes, axis=0)
    seen_at_all: Mask = np.logical_or.reduce(visible, axis=0)
    return seen_at_all, conflict, [union, union & (ended_at_m < passed_at_m), union & ~conflict]


def two_corners(minutes: int | None) -> Iterator[GridStream]:
    """The first so many test minutes of the junction, None: all of them, as two lasers see them."""
    for tracks in junction_tests()[:minutes]:
        scans = list(seen(read_tracks(tracks), TWO_CORNERS, COMMAND).scans())
        yield GridStream(HeldRecording(scans, open_recording(tracks)))


def section_of(streams: Iterable[GridStream]) -> ResultSection:
    """The counts of all frames with a true scene, by rule."""
    counts, conflicts = np.zeros((len(RULES), 3), np.int64), np.zeros(3, np.int64)
    for stream in streams:
        for observation in stream.observations():
            if observation.scene is None:
                continue
            outlines = truth_grid(observation.scene, stream.grid, observation.reference_T_grid).cover == OUTLINE
            visible, conflict, by_rule = settled(views(observation, stream.grid))
            conflicts += [by_rule[0].sum(), conflict.sum(), (conflict & outlines).sum()]
            for rule, called in enumerate(by_rule):
                true = outlines & visible
                counts[rule] += [(called & true).sum(), (called & ~true).sum(), (true & ~called).sum()]
        print(stream.name, flush=True)
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("recordings", nargs="*", help="with truth and several sensors")
    parser.add_argument("--minutes", type=int, help="without RECORDING the first so many of the twenty")
    parser.add_argument("--out", type=Path, help="results file that keeps the table")
    given = parser.parse_args()
    section = section_of(map(open_stream, given.recordings) if given.recordings else two_corners(given.minutes))
    print(section.tables["rules"].markdown(), *(f"{name}: {value}" for name, value in section.values.items()), sep="\n")
    if given.out is not None:
        write_section(given.out, "conflicts", section)


if __name__ == "__main__":
    main()

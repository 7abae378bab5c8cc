"""How a cell is settled in which a beam of one sensor ends and one of another sensor passes, against the true outlines.

`python -m studies.sensor_conflicts RECORDING...` reads recordings with truth and several sensors (`gridtrack simulate
junction --sensor corners`) and prints, of the cells in such a conflict, how many have a true outline; and of each rule
the precision, recall and F1 of the occupied cells among the visible ones. Three rules: occupied wins (that of the grid
stream), the nearer sensor wins, and free wins.
"""

from __future__ import annotations

import argparse

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import GridSpec, Mask
from gridtrack.common.raycast import cast_scan
from gridtrack.recordings.observation import Observation
from gridtrack.recordings.stream import open_stream
from gridtrack.recordings.truth import OUTLINE, truth_grid

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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("recordings", nargs="+", help="with truth and several sensors")
    counts, conflicts = np.zeros((len(RULES), 3), np.int64), np.zeros(3, np.int64)
    for recording in parser.parse_args().recordings:
        stream = open_stream(recording)
        for observation in stream.observations():
            if observation.scene is None:
                continue
            outlines = truth_grid(observation.scene, stream.grid, observation.reference_T_grid).cover == OUTLINE
            visible, conflict, by_rule = settled(views(observation, stream.grid))
            conflicts += [by_rule[0].sum(), conflict.sum(), (conflict & outlines).sum()]
            for rule, called in enumerate(by_rule):
                true = outlines & visible
                counts[rule] += [(called & true).sum(), (called & ~true).sum(), (true & ~called).sum()]
    occupied, disputed, surfaces = conflicts.tolist()
    print(
        f"{disputed} of {occupied} occupied cells are in a conflict; {surfaces / max(disputed, 1):.3f} have an outline"
    )
    for name, (hits, alarms, missed) in zip(RULES, counts.tolist(), strict=True):
        precision, recall, f1 = hits / (hits + alarms), hits / (hits + missed), 2 * hits / (2 * hits + alarms + missed)
        print(f"{name:22}: precision {precision:.3f}, recall {recall:.3f}, F1 {f1:.3f}")


if __name__ == "__main__":
    main()

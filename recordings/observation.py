"""An observation: a grid frame with the scans and labels from which it was made."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.errors import RecordingError
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec, Points, Shift, rolled
from gridtrack.common.raycast import cast_scan, end_cells
from gridtrack.common.scan import Scan
from gridtrack.common.scene import UNLABELLED, Person, Scene


@dataclass(frozen=True, slots=True)
class Observation:
    """A frame and the `scans` from which it was made, with labels and truth, for the referee only.

    `grid_T_sensor` are the poses of the sensors in the frame's grid, one for each scan; `time_s` is the time since the
    first scan of the recording. `reference_T_world` transforms from the world frame of the trackers' poses to the
    reference world frame, in which truth is given and forecasts are scored.
    """

    frame: GridFrame
    scans: tuple[Scan, ...] = ()
    grid_T_sensor: tuple[SE2, ...] = ()
    time_s: float = 0.0
    reference_T_world: SE2 = field(default_factory=SE2)

    @property
    def scene(self) -> Scene | None:
        """The true scene, if the recording has it."""
        return next((scan.scene for scan in self.scans if scan.scene is not None), None)

    @property
    def people(self) -> tuple[Person, ...] | None:
        """The annotated people, in the reference world frame; None where nothing is annotated."""
        return next((scan.people for scan in self.scans if scan.people is not None), None)

    @property
    def reference_T_grid(self) -> SE2:
        """The pose of the frame's window in the reference world frame."""
        return self.reference_T_world @ self.frame.world_T_grid

    def seen_in(self, reference_T_grid: SE2, grid: GridSpec) -> Observation:
        """The same scans in the window at `reference_T_grid`, each cast from its reference pose.

        Its frame has no points. Without scans it is made from the cells of the frame; cells outside of the frame's own
        window are then not visible.
        """
        if reference_T_grid == self.reference_T_grid:
            return self
        if not self.scans:
            return self._resampled_in(reference_T_grid, grid)
        grid_T_reference = reference_T_grid.inverse()
        poses = tuple(grid_T_reference @ reference_pose(scan) for scan in self.scans)
        visible, occupied = np.zeros((2, *grid.shape), np.bool_)
        for scan, pose in zip(self.scans, poses, strict=True):
            cast_scan(scan, grid, pose, visible, occupied)
        frame = _without_points(self.frame.stamp_ns, visible, occupied, reference_T_grid, _positions(poses))
        return Observation(frame, self.scans, poses, self.time_s)

    def _resampled_in(self, window: SE2, grid: GridSpec) -> Observation:
        frame, own = self.frame, self.reference_T_grid
        visible, occupied = cells_in_window(np.stack([frame.visible, frame.occupied]), own, window, grid)
        origins = (window.inverse() @ own).apply(frame.origins).astype(np.float32)
        return Observation(_without_points(frame.stamp_ns, visible, occupied, window, origins), time_s=self.time_s)


def reference_pose(scan: Scan) -> SE2:
    """`reference_T_sensor` of a scan: its recorded pose if it has no reference pose."""
    return scan.world_T_sensor if scan.reference_T_sensor is None else scan.reference_T_sensor


def frame_of(
    stamp_ns: int,
    scans: Mapping[str, Scan],
    grid_T_sensor: Mapping[str, SE2],
    world_T_grid: SE2,
    grid: GridSpec,
    points: Points,
) -> GridFrame:
    """The frame of the `scans` by sensor; `grid_T_sensor` has the poses of all sensors, even without a scan."""
    visible, occupied = np.zeros((2, *grid.shape), np.bool_)
    owner = np.zeros(grid.shape, np.uint8)
    returns: list[NDArray[np.float32]] = []
    return_origin: list[NDArray[np.uint8]] = []
    for s, sensor in enumerate(grid_T_sensor):
        if sensor not in scans:
            continue
        before = occupied.copy()
        returns.append(cast_scan(scans[sensor], grid, grid_T_sensor[sensor], visible, occupied))
        return_origin.append(np.full(len(returns[-1]), s, np.uint8))
        owner[occupied & ~before] = s
    origins = _positions(grid_T_sensor.values())
    if points == "raw" and returns:
        return GridFrame(
            stamp_ns, visible, occupied, world_T_grid, origins, np.concatenate(returns), np.concatenate(return_origin)
        )
    return GridFrame(stamp_ns, visible, occupied, world_T_grid, origins, grid.cell_centres(occupied), owner[occupied])


def _positions(poses: Iterable[SE2]) -> NDArray[np.float32]:
    """x and y (S, 2) float32 of poses."""
    return np.array([(pose.x, pose.y) for pose in poses], np.float32).reshape(-1, 2)


def _without_points(
    stamp_ns: int, visible: NDArray[np.bool_], occupied: NDArray[np.bool_], pose: SE2, origins: NDArray[np.float32]
) -> GridFrame:
    none = np.zeros((0, 2), np.float32), np.zeros(0, np.uint8)
    return GridFrame(stamp_ns, visible, occupied, pose, origins, *none)


_WHOLE = 1e-6
"""A smaller part of a cell, or heading in radians, moves no centre of a cell into another cell."""


def cells_in_window(marked: NDArray[np.bool_], own: SE2, window: SE2, grid: GridSpec) -> NDArray[np.bool_]:
    """The marked cells (K, M, M) of a window at `own`, as cells of another `window`; False outside of the first one.

    Each cell gets the mark of the cell that contains its centre. This is exactly a shift if the windows are whole cells
    apart and have the same heading.
    """
    moved = own.inverse() @ window
    rows, columns = moved.y / grid.cell_m, moved.x / grid.cell_m
    if max(abs(moved.theta), abs(rows - round(rows)), abs(columns - round(columns))) < _WHOLE:
        return rolled(marked, Shift(round(rows), round(columns)), False)
    centres = moved.apply(grid.cell_centres(np.ones(grid.shape, np.bool_)))
    cells, inside = grid.cells_of(centres)
    found = np.zeros((len(marked), grid.size**2), np.bool_)
    found[:, inside] = marked[:, cells[inside, 0], cells[inside, 1]]
    return found.reshape(-1, *grid.shape)


def labelled_returns(
    scans: Sequence[Scan], grid_T_sensor: Sequence[SE2], grid: GridSpec
) -> tuple[NDArray[np.int64], NDArray[np.uint8]]:
    """Cells (N,), row * M + column, with labelled returns, and the most frequent label (N,) of each.

    Of equally frequent labels the lowest one counts; cells with mostly UNLABELLED returns are left out.
    """
    votes = [
        end_cells(scan, grid, pose) * (UNLABELLED + 1) + scan.labels
        for scan, pose in zip(scans, grid_T_sensor, strict=True)
        if scan.labels is not None and scan.labels.min(initial=UNLABELLED) < UNLABELLED
    ]
    if not votes:
        return np.zeros(0, np.int64), np.zeros(0, np.uint8)
    pairs, count = np.unique(np.concatenate(votes), return_counts=True)
    pairs, count = pairs[pairs >= 0], count[pairs >= 0]
    cells, labels = np.divmod(pairs, UNLABELLED + 1)
    order = np.lexsort((labels, -count, cells))
    winners = order[np.flatnonzero(np.diff(cells[order], prepend=-1))]
    winners = winners[labels[winners] != UNLABELLED]
    return cells[winners], labels[winners].astype(np.uint8)


def check_labels(labels: NDArray[np.uint8], classes: Sequence[str], time_s: float) -> None:
    """Raise RecordingError for a label, `time_s` after the first scan, that is not an index into `classes`."""
    if labels.size and labels.max() >= len(classes):
        raise RecordingError(
            f"a label is class {labels.max()} at {time_s:.3f} s, but the recording has {len(classes)} classes: it is"
            " damaged"
        )

"""Checks of simulated traffic: presence and motion in the window, gridlock, collisions with walls and lasers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridSpec, window_about
from gridtrack.common.scene import UNLABELLED, Scene
from gridtrack.recordings.truth import OUTLINE, truth_grid
from gridtrack.simulation.bodies import body_outline
from gridtrack.simulation.tracks import ONLY_LASER, Tracks

MOVING_M_S = 0.3
STRIDE = 4
"""Moving cells are counted in every STRIDE-th frame."""
GRIDLOCK_S = 240.0
"""More than two signal cycles of the junction: longer than any queue at a signal."""


@dataclass(frozen=True)
class ClassTraffic:
    """One class in the window: the share of frames with at least one road user of the class, with at least one moving,
    and the outline cells of moving ones per minute."""

    name: str
    present: float
    moving: float
    moving_cells_per_minute: float


@dataclass(frozen=True)
class Traffic:
    """Traffic in the window; `faults` has one line for each fault of the simulation."""

    minutes: float
    classes: tuple[ClassTraffic, ...]
    longest_stand_s: float
    faults: tuple[str, ...]

    def __str__(self) -> str:
        lines = [f"{self.minutes:g} minutes; longest standing time of a vehicle: {self.longest_stand_s:.1f} s"]
        lines += [
            f"{c.name}: in {c.present:.1%} of frames, moving in {c.moving:.1%},"
            f" {c.moving_cells_per_minute:.0f} moving cells per minute"
            for c in self.classes
        ]
        return "\n".join(lines + [f"fault: {fault}" for fault in self.faults])


def check_traffic(tracks: Tracks) -> Traffic:
    """Check `tracks` in the window of its recording, which follows the first laser."""
    lasers = {name: tracks.sensor_poses(name) for name in tracks.info.lasers}
    faults = _through_walls(tracks)
    tracks = tracks.without_carrier()
    faults += [fault for name, poses in lasers.items() for fault in _on_the_laser(tracks, name, poses)]
    speed = _speeds(tracks)
    grid = GridSpec.parse(tracks.info.recording.grid) if tracks.info.recording.grid else GridSpec()
    windows = [window_about(SE2(*pose), grid.cell_m) for pose in next(iter(lasers.values())).tolist()]
    in_window = _in_window(tracks, grid, windows)
    stand_s, vehicle = _longest_stand(tracks, speed)
    if stand_s > GRIDLOCK_S:
        faults.append(f"gridlock: a vehicle stands for {stand_s:.0f} s, {vehicle}")
    moving = speed > MOVING_M_S
    cells = _moving_cells(tracks, moving, grid, windows)
    frames, minutes = tracks.info.frames, tracks.info.frames / tracks.info.rate_hz / 60.0
    names = [name for name in tracks.info.recording.classes if name != tracks.info.static_class]
    classes = []
    for name in names:
        there = in_window & (tracks.label == tracks.info.recording.classes.index(name))
        present, moved = (np.unique(tracks.frame[rows]).size / frames for rows in (there, there & moving))
        classes.append(ClassTraffic(name, present, moved, cells[name] / minutes))
    return Traffic(minutes, tuple(classes), stand_s, tuple(faults))


def _by_track(tracks: Tracks) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Row indices sorted by track and frame (N,), and whether each row follows the one before it without a gap (N,)."""
    order = np.lexsort((tracks.frame, tracks.track))
    track, frame = tracks.track[order], tracks.frame[order]
    return order, np.concatenate([[False], (np.diff(track) == 0) & (np.diff(frame) == 1)])


def _speeds(tracks: Tracks) -> NDArray[np.float64]:
    """Speed (N,), m/s, since the frame before; in the first frame of a track the speed of the second frame."""
    order, follows = _by_track(tracks)
    step = np.diff(tracks.pose[order, :2], axis=0, prepend=tracks.pose[order[:1], :2])
    speed = np.hypot(step[:, 0], step[:, 1]) * tracks.info.rate_hz
    first = np.flatnonzero(~follows)
    after = np.minimum(first + 1, len(order) - 1)
    speed[first] = np.where(follows[after], speed[after], 0.0)
    found = np.empty_like(speed)
    found[order] = speed
    return found


def _in_window(tracks: Tracks, grid: GridSpec, windows: list[SE2]) -> NDArray[np.bool_]:
    """Whether the centre of each body is in the window of its frame, (N,)."""
    corners = np.array([(window.x, window.y) for window in windows])
    _, inside = grid.cells_of(tracks.pose[:, :2] - corners[tracks.frame])
    return inside


def _longest_stand(tracks: Tracks, speed: NDArray[np.float64]) -> tuple[float, str]:
    """The longest time that a vehicle stands, seconds, and a text with the vehicle, its position and the frame."""
    classes = tracks.info.recording.classes
    order, follows = _by_track(tracks)
    walks = [i for i, name in enumerate(classes) if name == "pedestrian"]
    stands = (speed[order] <= MOVING_M_S) & ~np.isin(tracks.label[order], walks)
    if not stands.any():
        return 0.0, ""
    runs = np.cumsum(~(stands & follows))
    frames = np.bincount(runs[stands])
    first = order[np.flatnonzero(stands & (runs == frames.argmax()))[0]]
    x, y, _ = tracks.pose[first]
    vehicle = f"the {classes[tracks.label[first]]} of track {tracks.track[first]} at ({x:.1f}, {y:.1f})"
    return float(frames.max()) / tracks.info.rate_hz, f"{vehicle} from frame {tracks.frame[first]} on"


def _moving_cells(tracks: Tracks, moving: NDArray[np.bool_], grid: GridSpec, windows: list[SE2]) -> dict[str, float]:
    """Outline cells of the moving road users, summed over all frames, by class."""
    classes = tracks.info.recording.classes
    total = np.zeros(256)
    for k, scene in enumerate(tracks.where(moving).scenes()):
        if k % STRIDE == 0:
            truth = truth_grid(Scene((), UNLABELLED, scene.objects), grid, windows[k])
            total += np.bincount(truth.labels[truth.cover == OUTLINE], minlength=256)
    return {name: float(total[label]) * STRIDE for label, name in enumerate(classes)}


def _through_walls(tracks: Tracks) -> list[str]:
    """A line for each class with a corner of a body inside a static outline."""
    hit = np.zeros(len(tracks.frame), np.bool_)
    for rows, outline in _bodies(tracks):
        corners = _transformed(outline, tracks.pose[rows])
        for standing in tracks.info.static:
            hit[rows] |= inside(corners.reshape(-1, 2), np.array(standing)).reshape(len(rows), -1).any(axis=1)
    return _fault_lines(tracks, hit, "inside a static outline")


def _on_the_laser(tracks: Tracks, name: str, poses: NDArray[np.float64]) -> list[str]:
    """A line for each class with a body that covers the laser at `poses` (frames, 3), or is nearer to it than its
    minimum range."""
    hit = np.zeros(len(tracks.frame), np.bool_)
    for rows, outline in _bodies(tracks):
        x, y, heading = tracks.pose[rows].T
        c, s = np.cos(heading), np.sin(heading)
        dx, dy = poses[tracks.frame[rows], 0] - x, poses[tracks.frame[rows], 1] - y
        position = np.column_stack([c * dx + s * dy, c * dy - s * dx])
        nearest = np.linalg.norm(position[:, None] - outline, axis=2).min(axis=1)
        hit[rows] = inside(position, outline) | (nearest < tracks.info.lasers[name].range_min)
    return _fault_lines(tracks, hit, "on the laser" if name == ONLY_LASER else f"on the laser '{name}'")


def _fault_lines(tracks: Tracks, hit: NDArray[np.bool_], where: str) -> list[str]:
    lines = []
    for label, name in enumerate(tracks.info.recording.classes):
        rows = np.flatnonzero(hit & (tracks.label == label))
        if rows.size:
            first = rows[0]
            lines.append(
                f"{name} {where} in {rows.size} positions, the first of track {tracks.track[first]} in frame"
                f" {tracks.frame[first]}"
            )
    return lines


def _bodies(tracks: Tracks) -> Iterator[tuple[NDArray[np.int64], NDArray[np.float64]]]:
    """The rows (n,) of each distinct body, and its outline (N, 2), body frame."""
    classes = tracks.info.recording.classes
    kinds, kind = np.unique(np.column_stack([tracks.label, tracks.size]), axis=0, return_inverse=True)
    for k, (label, length, width) in enumerate(kinds.tolist()):
        yield np.flatnonzero(kind == k), body_outline(classes[int(label)], length, width).astype(np.float64)


def _transformed(outline: NDArray[np.float64], pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """The outline at each pose (n, 3): (n, N, 2), world frame."""
    c, s = np.cos(pose[:, 2, None]), np.sin(pose[:, 2, None])
    x = pose[:, 0, None] + c * outline[:, 0] - s * outline[:, 1]
    y = pose[:, 1, None] + s * outline[:, 0] + c * outline[:, 1]
    return np.stack([x, y], axis=2)


def inside(points: NDArray[np.float64], outline: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which of `points` (P, 2) are inside a closed outline (N, 2) by the even-odd rule, (P,)."""
    low, high = outline.min(axis=0), outline.max(axis=0)
    near = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
    x, y = points[near, 0], points[near, 1]
    odd = np.zeros(len(near), np.bool_)
    for (px, py), (qx, qy) in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        if py != qy:
            odd ^= ((py > y) != (qy > y)) & (x < (qx - px) * (y - py) / (qy - py) + px)
    found = np.zeros(len(points), np.bool_)
    found[near] = odd
    return found

"""A street: a pedestrian on one side, a car on the other; every cell is visible and labelled."""

import math

import numpy as np

from gridtrack.common.grid import GridSpec, LabelledFrame

from scenes import frames

GRID, PERIOD_S = GridSpec(60, 0.2, (0.0, -6.0)), 0.125
PEDESTRIAN, CAR = 0, 1


def frame_of(shapes, step=0, grid=GRID):
    """A frame in which all cells are visible and `shapes` (N, 2), metres, are occupied; the laser is at the origin."""
    occupied = np.zeros(grid.shape, bool)
    cells, inside = grid.cells_of(np.concatenate([np.empty((0, 2)), *shapes]))
    occupied[tuple(cells[inside].T)] = True
    return frames.frame_of(occupied, grid=grid, second=PERIOD_S * step)


def box(length, width, at, heading=0.0):
    """Points (N, 2), metres, on the side and the front of a box with its centre `at` a position."""
    along, across = np.arange(-length / 2, length / 2, 0.1), np.arange(-width / 2, width / 2, 0.1)
    side = np.stack([along, np.full_like(along, -width / 2)], 1)
    front = np.stack([np.full_like(across, length / 2), across], 1)
    cosine, sine = math.cos(heading), math.sin(heading)
    return np.concatenate([side, front]) @ np.array([[cosine, sine], [-sine, cosine]]) + at


def legs(at, apart=0.3):
    return np.array([(0.0, 0.0), (0.1, 0.0), (0.0, apart), (0.1, apart)]) + at


class Street:
    """A source with a pedestrian and a car of three metres; `classes` of its labels."""

    name, sha256, grid, period_s, site = "street.mcap", "0" * 64, GRID, PERIOD_S, "street"

    def __init__(self, frames=120, classes=("pedestrian", "car", "horse")):
        self.frames, self.classes = frames, classes

    def __len__(self):
        return self.frames

    def __iter__(self):
        return (item.frame for item in self.labelled())

    def labelled(self):
        for step in range(self.frames):
            t = step % 40 * PERIOD_S
            walker, car = legs((4.0, -4.0 + 1.2 * t)), box(3.0, 1.6, (8.0, 4.0 - 1.6 * t), -math.pi / 2)
            cells = [np.ravel_multi_index(GRID.cells_of(each)[0].T, GRID.shape) for each in (walker, car)]
            label_at = np.full(GRID.size**2, 255, np.uint8)
            label_at[cells[0]], label_at[cells[1]] = PEDESTRIAN, CAR
            labelled = np.flatnonzero(label_at < (255 if self.classes else 0))
            yield LabelledFrame(frame_of([walker, car], step), labelled, label_at[labelled])

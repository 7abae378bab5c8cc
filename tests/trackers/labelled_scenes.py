"""Scenes with labelled objects of two classes, and short trainings on them."""

from __future__ import annotations

import numpy as np

from gridtrack.common.config import validated
from gridtrack.common.grid import GridSpec, LabelledFrame
from gridtrack.trackers.contract import FitTask, stream_of
from tests.trackers.scores import no_score

from scenes.frames import frame_of

SIZE, ROUND = 16, 12


class Scene:
    """Every 12 frames two new objects at random positions: one of class 0, one of class 1."""

    sha256, site, classes = "0" * 64, "toy", ("stander", "walker", "horse")
    grid, period_s = GridSpec(SIZE, 0.5), 0.25

    def __init__(self, things, frames=240, seed=0, unlabelled=0):
        self.things, self.frames, self.seed, self.unlabelled = things, frames, seed, unlabelled
        self.name = f"toy-{seed}"

    def __len__(self):
        return self.frames

    def __iter__(self):
        return (item.frame for item in self.labelled())

    def labelled(self):
        draw = np.random.default_rng(self.seed)
        for t in range(self.frames):
            if t % ROUND == 0:
                rows, columns = 3 * draw.permutation(5)[:2] + 1, draw.integers(1, 4, 2)
            label_at = np.full((SIZE, SIZE), 255, np.uint8)
            for label, thing in enumerate(self.things):
                for row, column in thing(t % ROUND):
                    label_at[rows[label] + row, columns[label] + column] = label
            occupied = label_at < 255
            cells = np.flatnonzero(occupied)[: 0 if t < self.unlabelled else None]
            frame = frame_of(occupied, grid=self.grid, second=self.period_s * t)
            yield LabelledFrame(frame, cells, label_at.ravel()[cells])


def stands(t):
    return [(0, 4)]


def walks(t):
    return [(0, t)]


def lies(t):
    return [(0, t), (0, t + 1)]


def towers(t):
    return [(0, t), (1, t)]


def fit(tracker, folder, things, seed=3, train=None, **options):
    settings = validated(tracker.Options, {"labelled_scans": 150, **options}, "test")
    out, sources, validation = folder / "toy.toml", [train or Scene(things)], [Scene(things, 72, seed=1)]
    command = f"gridtrack train {options}"
    tracker.fit(FitTask(sources, validation, no_score, out, settings, folder / "log", seed, command))
    return out


def accuracy(tracker, weights, things, from_frame=4, **options):
    """Accuracy of the classes of occupied cells in a new scene, `from_frame` frames after each new pair of objects."""
    source = Scene(things, 96, seed=2)
    made = tracker(stream_of(source, weights), tracker.Options(**options))
    made.reset(0)
    right = []
    for t, (frame, cells, labels) in enumerate(source.labelled()):
        made.update(frame)
        if t % ROUND >= from_frame:
            semantics = made.predict(1).semantics[0].reshape(len(made.classes), -1)
            most_probable = semantics[:, cells].argmax(axis=0)
            right += [made.classes[k] == source.classes[label] for k, label in zip(most_probable, labels, strict=True)]
    return np.mean(right)

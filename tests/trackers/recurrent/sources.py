"""Small recordings, networks and trainings for the tests of the recurrent trackers."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import torch
from safetensors.numpy import load_file

from gridtrack.common.config import validated
from gridtrack.common.grid import GridSpec, LabelledFrame
from gridtrack.trackers.contract import FitTask, stream_of
from gridtrack.trackers.recurrent.conv_lstm import ConvLSTM, ConvLSTMSettings
from gridtrack.trackers.recurrent.convgru_tracker import DilatedConvGRUTracker
from gridtrack.trackers.recurrent.deep_tracking_rnn import DeepTrackingRNN, DeepTrackingRNNTracker
from gridtrack.trackers.recurrent.dilated_convgru import DilatedConvGRU
from gridtrack.trackers.recurrent.network import channels_last
from gridtrack.trackers.recurrent.settings import DeepTrackingRNNSettings, DilatedConvGRUSettings
from tests.trackers.scores import of_every_stratum

from scenes import frames

TRACKERS = [DilatedConvGRUTracker, DeepTrackingRNNTracker]
SMALL = {DilatedConvGRUTracker: {"channels": 4, "stage": "occupancy"}, DeepTrackingRNNTracker: {"variant": "paper"}}
"""Options of tiny networks."""
BRIEF = {"observed_frames": 5, "blank_frames": 3, "repetitions": 1}
SHORT = {"batch": 2, "warm_up": 0, "updates": 1, "validate_every": 1, "precision": "32-true"}


def frame_of(visible, occupied, *, stamp_s=0.0, cell_m=0.5, row=0, column=0):
    """A frame with its window at a cell of the world."""
    grid = GridSpec(len(visible), cell_m)
    return frames.frame_of(occupied, visible, grid=grid, second=stamp_s, x=column * cell_m, y=row * cell_m)


class Recording:
    """Frames of a scene that a subclass draws: all cells are visible and free before; it may return a column."""

    sha256, site, classes = "0" * 64, "", ()

    def __init__(self, size, cell_m, period_s, frames):
        self.grid, self.period_s, self.frames = GridSpec(size, cell_m), period_s, frames
        self.name = f"{type(self).__name__.lower()} {self.grid}"

    def __len__(self):
        return self.frames

    def __iter__(self):
        size, cell_m = self.grid.size, self.grid.cell_m
        for t in range(self.frames):
            visible, occupied = np.ones((size, size), bool), np.zeros((size, size), bool)
            column = self.draw(t, visible, occupied) or 0
            yield frame_of(visible, occupied, stamp_s=t * self.period_s, cell_m=cell_m, column=column)

    def labelled(self):
        """All occupied cells are of the first class."""
        for frame in self:
            cells = np.flatnonzero(frame.occupied)
            yield LabelledFrame(frame, cells, np.zeros(len(cells), np.uint8))


class Shuttle(Recording):
    """A dot moves along row 5, one cell a frame, and returns to column 0; row 0 is a wall; row 11 is never visible."""

    site = "shuttle"

    def __init__(self, frames=60):
        super().__init__(12, 0.5, 0.25, frames)
        self.name = "shuttle"

    def draw(self, t, visible, occupied):
        visible[11] = False
        occupied[0] = occupied[5, t % 12] = True


class Walk(Recording):
    """A dot walks to and fro at 2 m/s along a row; the first `unseen` rows are never visible."""

    def __init__(self, size, cell_m, period_s, frames=90, drift=0, unseen=3, classes=()):
        super().__init__(size, cell_m, period_s, frames)
        self.drift, self.unseen, self.classes = drift, unseen, classes

    def draw(self, t, visible, occupied):
        size, cells_a_frame = self.grid.size, 2.0 * self.period_s / self.grid.cell_m
        visible[: self.unseen] = False
        column = int(t * cells_a_frame) % (2 * size)
        occupied[(self.unseen + size) // 2, min(column, 2 * size - 1 - column)] = True
        return t * self.drift


class Drive(Recording):
    """The window moves to the right by `speed` cells a frame, from `start` on, past a post in column 40."""

    def __init__(self, frames=60, start=0, speed=1):
        super().__init__(12, 0.5, 0.25, frames)
        self.name, self.start, self.speed = "drive", start, speed

    def draw(self, t, visible, occupied):
        column = self.start + t * self.speed
        if 0 <= 40 - column < 12:
            occupied[4, 40 - column] = True
        return column


def randomised(network, scale=0.3):
    """The network with random parameters, equal for every size of the grid if it has no map; without gradient."""
    generator = torch.Generator().manual_seed(3)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.copy_(scale * torch.randn(parameter.shape, generator=generator))
    return channels_last(network.eval()).requires_grad_(requires_grad=False)


def convgru(size=12, channels=4, **settings):
    return randomised(DilatedConvGRU(size, DilatedConvGRUSettings(channels=channels, **settings)))


def rnn(size=12, **settings):
    return randomised(DeepTrackingRNN(size, DeepTrackingRNNSettings(variant="paper", **settings)))


def conv_lstm(size=12, channels=4, **settings):
    return randomised(ConvLSTM(size, ConvLSTMSettings(channels=channels, **settings)))


def log_loss_of(tracker, source, steps):
    """An objective in place of the host's: 1 - log loss of step 1, and that log loss."""
    tracker.reset(0)
    losses = []
    for now, future in pairwise(source):
        tracker.update(now)
        p = np.clip(tracker.predict(1).occupancy[1][future.visible], 1e-3, 1 - 1e-3)
        losses.append(-np.log(np.where(future.occupied[future.visible], p, 1 - p)).mean())
    return of_every_stratum(1.0 - np.mean(losses), np.mean(losses), steps)


def constant(tracker, source, steps):
    """An objective that runs the tracker and finds every network equally good."""
    forecast = forecast_of(tracker, source, steps)
    assert forecast.shape == (steps + 1, *source.grid.shape)
    return of_every_stratum(1.0, 0.1, steps)


def forecast_of(tracker, source, steps):
    """The occupancy that a tracker forecasts after the last frame."""
    tracker.reset(0)
    for frame in source:
        tracker.update(frame)
    return tracker.predict(steps).occupancy


def trained(tracker, card, source, **options):
    """The tracker with the weights of a card, for the stream of a source."""
    return tracker(stream_of(source, card), validated(tracker.Options, options, "test"))


def arrays_of(card):
    return load_file(card.with_suffix(".safetensors"))


def task_for(tracker, out, train, validation=None, *, objective=constant, general=False, start=None, **options):
    """The task of a short training, and the lines that it reports."""
    lines = []
    short = {name: value for name, value in SHORT.items() if name in tracker.Options.model_fields}
    settings = validated(tracker.Options, short | SMALL.get(tracker, {}) | options, "test")
    task = FitTask(
        train, validation or train, objective, out, settings, out.parent / "log", 7, "gridtrack train ...",
        general=general, start=start, report=lines.append,
    )  # fmt: skip
    return task, lines


def fit(tracker, out, train, validation=None, **given):
    """Run a short training; returns the lines that it reports."""
    task, lines = task_for(tracker, out, train, validation, **given)
    tracker.fit(task)
    return lines

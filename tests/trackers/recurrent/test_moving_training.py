"""Training on recordings whose sensor moves: every sequence is in one window, that of its last observed frame."""

from __future__ import annotations

import json

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("lightning")

from gridtrack.common.config import validated  # noqa: E402
from gridtrack.common.errors import ConfigurationError  # noqa: E402
from gridtrack.common.geometry import SE2  # noqa: E402
from gridtrack.common.grid import GridFrame, GridSpec  # noqa: E402
from gridtrack.trackers.contract import FitTask, stream_of  # noqa: E402
from gridtrack.trackers.recurrent import precision
from gridtrack.trackers.recurrent.convgru_tracker import DilatedConvGRUTracker  # noqa: E402
from gridtrack.trackers.recurrent.deep_tracking_rnn import DeepTrackingRNNTracker
from gridtrack.trackers.recurrent.sequences import SequenceDataset  # noqa: E402
from gridtrack.trackers.recurrent.settings import TrainingSettings  # noqa: E402
from gridtrack.trackers.recurrent.transfer import PastStates  # noqa: E402
from gridtrack.trackers.training.weights import read_card  # noqa: E402
from tests.trackers.scores import of_every_stratum  # noqa: E402

SIZE, CELL_M = 12, 0.5
POST = (4, 40)
"""The cell of the world in which a post stands: row, column."""


class Drive:
    """The window moves to the right by `speed` cells a frame, from `start` on; in it everything is visible."""

    name, sha256, site, classes = "drive", "0" * 64, "", ()
    grid, period_s = GridSpec(SIZE, CELL_M), 0.25

    def __init__(self, frames: int = 60, start: int = 0, speed: int = 1) -> None:
        self.frames, self.start, self.speed = frames, start, speed

    def __len__(self) -> int:
        return self.frames

    def __iter__(self):
        for t in range(self.frames):
            column = self.start + t * self.speed
            visible, occupied = np.ones((SIZE, SIZE), bool), np.zeros((SIZE, SIZE), bool)
            if 0 <= POST[1] - column < SIZE:
                occupied[POST[0], POST[1] - column] = True
            yield GridFrame(
                t * 250_000_000, visible, occupied, SE2(column * CELL_M, 0.0), np.zeros((1, 2), np.float32),
                self.grid.cell_centres(occupied), np.zeros(int(occupied.sum()), np.uint8),
            )  # fmt: skip


def no_score(tracker, source, steps):
    tracker.reset(0)
    for frame in source:
        tracker.update(frame)
    tracker.predict(steps)
    return of_every_stratum(1.0, 0.1, steps)


def fit(tracker, folder, sources=None, **options):
    given = {"batch": 1, "warm_up": 0, "updates": 1, "validate_every": 1, "precision": "32-true", **options}
    lines: list[str] = []
    options, out = validated(tracker.Options, given, "test"), folder / "drive.toml"
    train, validation = sources or [Drive()], [Drive(15)]
    tracker.fit(FitTask(train, validation, no_score, out, options, folder / "log", 7, report=lines.append))
    return out, lines


def of_eight(**options):
    """Settings of windows of eight frames, five of them observed."""
    return TrainingSettings(observed_frames=5, blank_frames=3, repetitions=1, **options)


@pytest.mark.parametrize("time_reversal", [False, True])
def test_the_frames_of_an_item_are_in_the_window_of_the_last_one_that_is_observed(time_reversal):
    data = SequenceDataset([Drive()], of_eight(time_reversal=time_reversal), seed=1)
    first_columns = set()
    for number in range(60):
        visible, occupied = data[number].window.numpy().transpose(1, 0, 2, 3).astype(bool)
        assert visible[4].all()
        for t in range(8):
            unseen = np.flatnonzero(~visible[t].any(axis=0))
            assert len(unseen) == abs(t - 4), "columns that came in later, or have left"
            first_columns |= {bool(unseen[0] == 0)} if len(unseen) and t < 4 else set()
        places = {tuple(place) for plane in occupied for place in np.argwhere(plane).tolist()}
        assert len(places) <= 1, "a post stays at its place"
    assert first_columns == ({True, False} if time_reversal else {False})


def test_the_last_observed_frame_is_that_before_the_last_blank_ones():
    assert TrainingSettings(observed_frames=3, blank_frames=2, repetitions=2, burn_in=4).last_observed == 11
    assert TrainingSettings(observed_frames=3, blank_frames=0, repetitions=1).last_observed == 2


def test_drives_are_not_superposed():
    with pytest.raises(ConfigurationError, match=r"drive: the sensor moves.*superposition=false"):
        SequenceDataset([Drive()], of_eight(superposition=True), seed=1)


@pytest.mark.parametrize("sources", [[Drive()], [Drive(speed=0), Drive(start=1, speed=0)]], ids=["moves", "elsewhere"])
def test_where_the_windows_differ_the_network_is_trained_without_static_memory_and_says_so(tmp_path, sources):
    path, lines = fit(DilatedConvGRUTracker, tmp_path, sources, channels=4)
    assert "the windows of the training frames differ: trained without static memory (static_gates=[])" in lines
    assert read_card(path).settings["static_gates"] == []
    tracker = DilatedConvGRUTracker(stream_of(Drive(), path), DilatedConvGRUTracker.Options())
    assert tracker.network.unseen(3)[0].shape == (4,)


def test_static_memory_that_was_asked_for_is_refused_where_the_windows_differ(tmp_path):
    with pytest.raises(ConfigurationError, match=r"static memory has the cells of one window.*static_gates=\[\]"):
        fit(DilatedConvGRUTracker, tmp_path, static_gates=["candidate"])


def test_where_the_window_stays_the_network_has_static_memory_at_its_place(tmp_path):
    path, _ = fit(DilatedConvGRUTracker, tmp_path, [Drive(start=30, speed=0)], channels=4)
    assert read_card(path).settings["static_gates"] == ["keep", "reset", "candidate"]
    assert read_card(path).map_pose == SE2(30 * CELL_M, 0.0)


def test_the_past_states_of_a_tracker_are_in_the_window_of_its_last_frame(tmp_path):
    path, _ = fit(DeepTrackingRNNTracker, tmp_path, variant="paper")
    tracker = DeepTrackingRNNTracker(stream_of(Drive(), path), DeepTrackingRNNTracker.Options())
    tracker.reset(0)
    past, kept = PastStates(tracker), []
    for frame in Drive(6, start=30, speed=2):
        past.update(frame)
        kept.append(tracker.state[0].clone())
    assert past.before(6) is None
    for lead in range(6):
        (found,), earlier = past.before(lead), kept[-1 - lead]
        assert torch.equal(found[..., : SIZE - 2 * lead], earlier[..., 2 * lead :])
        if lead:
            (unseen,) = tracker.network.unseen(6 - lead)
            assert np.array_equal(found[0, :, 3, -1].numpy(), unseen)


@pytest.mark.parametrize("faster", ["32-true", "bf16-mixed"])
def test_the_faster_precision_is_taken_told_once_and_on_the_card(tmp_path, monkeypatch, faster):
    monkeypatch.setattr(precision, "convolution_ms", lambda tried: 1.0 if tried == faster else 2.0)
    path, lines = fit(DeepTrackingRNNTracker, tmp_path, variant="paper", precision="auto")
    assert read_card(path).settings["precision"] == faster
    (line,) = [line for line in lines if line.startswith("precision")]
    assert line.startswith(f"precision {faster}: a convolution and its gradient take 32-true")


def test_a_resumed_training_keeps_the_precision_that_it_began_with(tmp_path, monkeypatch):
    times = {"32-true": 1.0, "bf16-mixed": 2.0}
    monkeypatch.setattr(precision, "convolution_ms", times.get)
    fit(DeepTrackingRNNTracker, tmp_path, variant="paper", precision="auto")
    times["32-true"] = 3.0
    path, lines = fit(DeepTrackingRNNTracker, tmp_path, variant="paper", precision="auto")
    assert read_card(path).settings["precision"] == "32-true"
    assert json.loads((tmp_path / "log" / "settings.json").read_text())["precision"] == "32-true"
    assert not any(line.startswith("precision") for line in lines)


def test_the_measurement_does_not_change_the_trained_network(tmp_path, monkeypatch):
    paths = []
    for name, chosen in (("auto", "auto"), ("chosen", "32-true")):
        monkeypatch.setattr(precision, "ROUNDS", 1)
        monkeypatch.setattr(precision, "get_args", lambda _: ("32-true",))
        path, _ = fit(DeepTrackingRNNTracker, tmp_path / name, variant="paper", precision=chosen)
        paths.append(path)
    one, other = (path.with_suffix(".safetensors").read_bytes() for path in paths)
    assert one == other

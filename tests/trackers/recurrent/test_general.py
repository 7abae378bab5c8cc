"""General weights of the networks: trained on unlike grids and periods, used on any."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("lightning")

from gridtrack.common.config import validated  # noqa: E402
from gridtrack.common.errors import ConfigurationError  # noqa: E402
from gridtrack.common.geometry import SE2  # noqa: E402
from gridtrack.common.grid import GridFrame, GridSpec, LabelledFrame  # noqa: E402
from gridtrack.trackers.contract import FitTask, StretchScore, stream_of  # noqa: E402
from gridtrack.trackers.one_shot import OneShotTracker  # noqa: E402
from gridtrack.trackers.recurrent.convgru_tracker import DilatedConvGRUTracker  # noqa: E402
from gridtrack.trackers.recurrent.deep_tracking_rnn import DeepTrackingRNNTracker
from gridtrack.trackers.recurrent.fit import validation_scores
from gridtrack.trackers.recurrent.network import (
    channels_last,  # noqa: E402
    resolution_of,
    set_resolution,
)
from gridtrack.trackers.recurrent.sequences import SequenceDataset  # noqa: E402
from gridtrack.trackers.recurrent.settings import TrainingSettings  # noqa: E402
from gridtrack.trackers.training import cell_training  # noqa: E402
from gridtrack.trackers.training.excerpts import VALIDATED_S, excerpts_of_places  # noqa: E402
from gridtrack.trackers.training.labelled_scans import ClassifierSettings  # noqa: E402
from gridtrack.trackers.training.weights import read_card  # noqa: E402
from tests.trackers.scores import of_every_stratum  # noqa: E402

TRACKERS = [DilatedConvGRUTracker, DeepTrackingRNNTracker]
SMALL = {
    DilatedConvGRUTracker: {"channels": 4, "stage": "occupancy"},
    DeepTrackingRNNTracker: {"variant": "paper"},
}


class Walk:
    """A dot walks to and fro at 2 m/s along a row; the first `unseen` rows are never visible."""

    sha256, site, classes = "0" * 64, "", ()

    def __init__(
        self, size: int, cell_m: float, period_s: float, frames: int = 90, drift: int = 0, unseen: int = 3
    ) -> None:
        self.grid, self.period_s, self.frames, self.drift = GridSpec(size, cell_m), period_s, frames, drift
        self.unseen = unseen
        self.name = f"walk {size}x{cell_m}"

    def __len__(self) -> int:
        return self.frames

    def __iter__(self):
        size, cells_a_frame = self.grid.size, 2.0 * self.period_s / self.grid.cell_m
        for t in range(self.frames):
            visible, occupied = np.ones((size, size), bool), np.zeros((size, size), bool)
            visible[: self.unseen] = False
            column = int(t * cells_a_frame) % (2 * size)
            occupied[(self.unseen + size) // 2, min(column, 2 * size - 1 - column)] = True
            yield GridFrame(
                round(t * self.period_s * 1e9), visible, occupied, SE2(t * self.drift * self.grid.cell_m, 0.0),
                np.zeros((1, 2), np.float32), self.grid.cell_centres(occupied), np.zeros(int(occupied.sum()), np.uint8),
            )  # fmt: skip


def no_score(tracker, source, steps):
    tracker.reset(0)
    for frame in source:
        tracker.update(frame)
    shape = tracker.predict(steps).occupancy.shape
    assert shape == (steps + 1, *source.grid.shape)
    return of_every_stratum(1.0, 0.1, steps)


HELD_OUT = (Walk(20, 0.1, 0.1), Walk(9, 0.3, 0.25))


def fit(tracker, folder, sources, held_out=HELD_OUT, **options):
    given = {"batch": 2, "warm_up": 0, "precision": "32-true", **SMALL[tracker], **options}
    lines: list[str] = []
    options, out = validated(tracker.Options, given, "test"), folder / "general.toml"
    more = {"general": True, "report": lines.append}
    tracker.fit(FitTask(sources, held_out, no_score, out, options, folder / "log", 7, "gridtrack train ...", **more))
    return out, lines


def items(*sources, **options):
    """Windows of eight steps, five of them observed."""
    step_s = options.pop("step_s", 0.0)
    settings = TrainingSettings(observed_frames=5, blank_frames=3, repetitions=1, **options)
    return SequenceDataset(sources, settings, seed=1, step_s=step_s, general=True)


@pytest.mark.parametrize("tracker", TRACKERS)
def test_a_general_training_takes_unlike_grids_and_periods_and_its_weights_run_on_any(tracker, tmp_path):
    sources = [Walk(16, 0.2, 0.125), Walk(24, 0.05, 0.05), Walk(10, 0.1, 0.2, drift=1)]
    path, lines = fit(tracker, tmp_path, sources, updates=2, validate_every=1)
    card = read_card(path)
    assert (card.general, card.cells_m, card.periods_s) == (True, (0.05, 0.2), (0.05, 0.2))
    assert card.settings["resolution_input"]
    if tracker is DilatedConvGRUTracker:
        assert card.settings["static_gates"] == []
        assert any("general weights know no place: trained without static memory" in line for line in lines)
    for source in (Walk(16, 0.2, 0.125), Walk(33, 0.07, 0.03, drift=2)):
        made = tracker(stream_of(source, path), tracker.Options())
        no_score(made, source, 3)


def test_a_map_of_a_place_that_was_asked_for_is_refused(tmp_path):
    with pytest.raises(ConfigurationError, match=r"general weights know no place.*static_gates=\[\]"):
        fit(DilatedConvGRUTracker, tmp_path, [Walk(12, 0.2, 0.1)], static_gates=["keep"])


def test_frames_of_unlike_places_are_not_superposed():
    with pytest.raises(ConfigurationError, match="superposition=false"):
        items(Walk(12, 0.2, 0.1), superposition=True)


def test_items_have_one_size_and_the_resolution_of_their_recording():
    """Larger grids are cut and smaller ones padded, at random places; nothing outside was observed."""
    data = items(Walk(140, 0.05, 0.1, unseen=60), Walk(40, 0.2, 0.1, unseen=10))
    rows = {0.05: set(), 0.2: set()}
    for number in range(30):
        window, resolution = data[number]
        assert window.shape == (8, 2, 64, 64)
        cell_m = min(rows, key=lambda cell: float((resolution_of(cell, 0.1) - resolution).abs().sum()))
        seen = window[4, 0].any(dim=1).nonzero().flatten().tolist()
        rows[cell_m].add(seen[0])
        assert window[4, 0].sum() == (len(seen) * 64 if cell_m == 0.05 else 30 * 40)
    assert all(len(found) > 5 for found in rows.values())


def test_every_recording_is_drawn_by_its_duration_and_not_by_its_number_of_frames():
    data = items(Walk(8, 0.2, 0.05, frames=407), Walk(8, 0.1, 0.2, frames=107))
    cells = [float(data[number].resolution[0]) for number in range(200)]
    assert 70 < sum(cell == 0.0 for cell in cells) < 130


def test_the_window_of_a_sensor_that_moves_is_that_of_the_last_observed_frame():
    window = items(Walk(12, 0.2, 0.1, drift=1))[0].window
    unseen = [int((~window[t, 0].bool()).all(dim=0).sum()) for t in range(8)]
    assert unseen == [4, 3, 2, 1, 0, 1, 2, 3]


def randomised(tracker, size, **options):
    settings = (
        validated(tracker.Options, {"static_gates": [], "channels": 4, **options}, "test")
        if (tracker is DilatedConvGRUTracker)
        else validated(tracker.Options, {"variant": "paper", **options}, "test")
    )
    network, generator = tracker.build(size, settings, 0), torch.Generator().manual_seed(5)
    for parameter in network.parameters():
        parameter.data = 0.3 * torch.randn(parameter.shape, generator=generator)
    return channels_last(network), settings


@pytest.mark.parametrize("size", [64, 130])
@pytest.mark.parametrize("tracker", TRACKERS)
def test_inference_on_any_grid_equals_the_differentiable_network_there(tracker, size):
    network, settings = randomised(tracker, 20, resolution_input=True)
    source = Walk(size, 0.05, 0.2)
    inference = tracker.inference_for(network, stream_of(source), settings)
    state, expected = inference.initial(1), network.initial(1)
    draw = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for t in range(4):
            x = (torch.rand((1, 2, size, size), generator=draw) > 0.7).float()
            x = None if t > 2 else x.contiguous(memory_format=torch.channels_last)
            state, expected = inference.step(x, state), network.step(x, expected)
        logits = inference.occupancy(inference.features(state))
        torch.testing.assert_close(logits, network.occupancy(network.features(expected)), rtol=0, atol=1e-4)


@pytest.mark.parametrize("tracker", TRACKERS)
def test_the_network_reads_cell_size_and_period(tracker):
    network, _ = randomised(tracker, 12, resolution_input=True)
    answers = []
    for cell_m, period_s in ((0.1, 0.1), (0.1, 0.2), (0.2, 0.1)):
        set_resolution(network, resolution_of(cell_m, period_s))
        answers.append(network.occupancy(network.features(network.step(None, network.initial(1)))).detach())
    assert not torch.equal(answers[0], answers[1])
    assert not torch.equal(answers[0], answers[2])
    without, _ = randomised(tracker, 12)
    assert len(network.state_dict()) > len(without.state_dict())


def test_a_validation_recording_in_which_nothing_moves_has_no_part_in_the_score():
    f1 = {Walk: [0.5, 0.5], None: [np.nan, 0.7]}
    sources = [Walk(8, 0.1, 1.0), Walk(9, 0.1, 1.0)]

    def score(source):
        dynamic, visible = f1[Walk if source is sources[0] else None]
        of = {"dynamic": np.full(3, dynamic), "in-motion": np.full(3, dynamic), "visible": np.full(3, visible)}
        return StretchScore(of, {name: 1.0 - values for name, values in of.items()})

    found = validation_scores(score, sources, (1.0,))
    assert (found["dynamic_f1_1s"], found["visible_f1_1s"]) == (0.5, pytest.approx(0.6))
    assert found["log_loss"] == pytest.approx(0.45), "the mean of 0.5, 0.5, 0.5 and 0.3"
    alone = validation_scores(score, sources[1:], (1.0,))
    assert alone["score"] == pytest.approx(0.7), "what is defined chooses between updates, not nothing"


def test_a_general_network_is_validated_on_the_middle_minute_of_a_long_recording():
    short, long = Walk(8, 0.1, 1.0, frames=40), Walk(8, 0.1, 0.5, frames=400)
    found = excerpts_of_places([short, long], VALIDATED_S)
    assert [len(one) for one in found] == [40, 120]
    assert [one.stamp_ns / 1e9 for one in found[1]][:: len(found[1]) - 1] == [70.0, 129.5]


def test_where_no_beam_reached_in_training_the_network_says_the_occupied_rate(tmp_path):
    """Also long after, and at every horizon, in a place where nothing was ever observed."""
    source = Walk(16, 0.2, 0.125, unseen=11)
    path, _ = fit(
        DilatedConvGRUTracker, tmp_path, [source], updates=150, validate_every=150, learning_rate=0.01,
        unseen_weight=1.0, burn_in=15, observed_frames=5, blank_frames=5,
    )  # fmt: skip
    made = DilatedConvGRUTracker(stream_of(source, path), DilatedConvGRUTracker.Options())
    for frame in Walk(16, 0.2, 0.125, frames=300, unseen=11):
        made.update(frame)
    unseen = made.predict(20).occupancy[:, 1:7]
    rate = 1 / (16 * 5)
    assert rate / 5 < unseen.min() < unseen.max() < 5 * rate


class LabelledWalk(Walk):
    """The dot is a walker; in fine cells it is a wide car."""

    def __init__(self, *arguments, classes=("walker",), **options):
        super().__init__(*arguments, **options)
        self.classes = classes

    def labelled(self):
        for frame in self:
            cells = np.flatnonzero(frame.occupied)
            yield LabelledFrame(frame, cells, np.zeros(len(cells), np.uint8))


FINE, COARSE = LabelledWalk(20, 0.05, 0.1, classes=("car",)), LabelledWalk(14, 0.2, 0.2)


@pytest.mark.parametrize(
    ("tracker", "options"),
    [
        (OneShotTracker, {"channels": 8}),
        (DilatedConvGRUTracker, {"channels": 4, "warm_up": 0, "updates": 1, "validate_every": 1, "class_channels": 8}),
    ],
)
def test_classes_are_learned_from_all_recordings_and_a_dot_is_told_by_the_size_of_its_cells(
    tracker, options, tmp_path, monkeypatch
):
    """The classes of the card are those of all recordings together."""
    short = {"learning_rate": 0.01, "updates": 150, "batch": 32}
    monkeypatch.setattr(
        cell_training, "candidate_settings", lambda given, seed: [ClassifierSettings(**(short | dict(given)))]
    )
    settings = validated(tracker.Options, {"labelled_scans": 40, **options}, "test")
    sources, out = [FINE, COARSE], tmp_path / "general.toml"
    tracker.fit(FitTask(sources, sources, no_score, out, settings, tmp_path / "log", 3, general=True))
    assert set(read_card(out).classes) == {"walker", "car"}
    for source, expected in ((FINE, "car"), (COARSE, "walker")):
        made = tracker(stream_of(source, out), tracker.Options())
        for frame in source:
            made.update(frame)
        ((row, column),) = np.argwhere(frame.occupied)
        semantics = made.predict(2).semantics[0]
        assert semantics.shape[1:] == source.grid.shape
        assert made.classes[semantics[:, row, column].argmax()] == expected


def dots_of(window):
    """The number of occupied cells in each frame of a window (T, 2, M, M)."""
    return window[:, 1].flatten(1).sum(dim=1).tolist()


def test_a_window_in_which_nothing_moves_is_drawn_anew():
    """As long of a dot that stands as of one that walks: nearly every window has the walk."""

    class Stands(Walk):
        sha256 = "1" * 64

        def __iter__(self):
            first = next(super().__iter__())
            for t in range(self.frames):
                yield GridFrame(
                    round(t * self.period_s * 1e9), first.visible, first.occupied, first.world_T_grid, first.origins,
                    first.points, first.point_origin,
                )  # fmt: skip

    sources = Stands(40, 0.2, 0.1, frames=200), Walk(40, 0.2, 0.1, frames=200)
    shape = {"observed_frames": 20, "blank_frames": 20, "repetitions": 1}
    shares = []
    for moving in (False, True):
        settings = TrainingSettings(**shape, moving_windows=moving)
        data = SequenceDataset(sources, settings, seed=1, general=True)
        moves = [bool((data[number].window[0] != data[number].window[-1]).any()) for number in range(60)]
        shares.append(sum(moves) / 60)
    assert 0.3 < shares[0] < 0.7
    assert shares[1] > 0.95


def test_the_first_updates_are_on_moving_shapes_and_a_share_of_the_others_has_some_added():
    settings = {"shape_updates": 3, "batch": 2, "shape_share": 0.5}
    data = items(Walk(40, 0.2, 0.1, unseen=10), **settings)
    plain = items(Walk(40, 0.2, 0.1, unseen=10))
    for number in range(6):
        window, resolution = data[number]
        assert not (window[:, 1] & ~window[:, 0]).any()
        assert max(dots_of(window)) > 5
        assert torch.equal(resolution, resolution_of(0.2, 0.1))
    added = 0
    for number in range(6, 106):
        window, own = data[number].window, plain[number].window
        assert not (window[:, 0] & ~own[:, 0]).any(), "shapes hide, and show nothing"
        assert not (window[:, 1] & ~window[:, 0]).any(), "only visible cells are occupied"
        assert (window[:, 1] >= own[:, 1] & window[:, 0]).all()
        added += bool((window != own).any())
    assert 35 < added < 65


def test_slow_frames_are_the_input_of_every_second_step_and_fast_ones_are_taken_in_turn():
    slow = items(Walk(40, 0.2, 0.2, unseen=10), step_s=0.1)[0]
    assert [bool(frame.any()) for frame in slow.window[:, 0]] == [False, True] * 4
    fast = items(Walk(40, 0.2, 0.05, unseen=10), step_s=0.1)[0]
    columns = fast.window[:, 1].any(dim=1).float().argmax(dim=1)
    assert {abs(int(step)) for step in columns.diff()} <= {0, 1, 2}, "a walk of 2 m/s: a cell of 0.2 m a step"
    assert all(torch.equal(each.resolution, resolution_of(0.2, 0.1)) for each in (slow, fast))

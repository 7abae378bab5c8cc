"""Training of the recurrent networks: the loss, the windows, resumption, and the card."""

from __future__ import annotations

import multiprocessing
import os
import re
import signal
import time
from itertools import pairwise

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("lightning")

from safetensors.numpy import load_file  # noqa: E402

from gridtrack.common.config import validated  # noqa: E402
from gridtrack.common.errors import ConfigurationError, WeightsError  # noqa: E402
from gridtrack.common.geometry import SE2  # noqa: E402
from gridtrack.common.grid import GridFrame, GridSpec  # noqa: E402
from gridtrack.trackers.contract import FitTask, stream_of  # noqa: E402
from gridtrack.trackers.recurrent import accelerated_convgru, training
from gridtrack.trackers.recurrent.convgru_tracker import DilatedConvGRUTracker  # noqa: E402
from gridtrack.trackers.recurrent.deep_tracking_rnn import DeepTrackingRNNTracker
from gridtrack.trackers.recurrent.motion import near_entered_cells
from gridtrack.trackers.recurrent.network import set_resolution
from gridtrack.trackers.recurrent.sequences import EpochSampler, Item, SequenceDataset, superposed  # noqa: E402
from gridtrack.trackers.recurrent.settings import TrainingSettings  # noqa: E402
from gridtrack.trackers.recurrent.training_module import (
    TrainingModule,  # noqa: E402
    sequence_loss,
)
from gridtrack.trackers.training.weights import read_card  # noqa: E402
from tests.trackers.scores import of_every_stratum  # noqa: E402

SIZE = 12


class Shuttle:
    """A dot moves along row 5, one cell a frame, and returns to column 0; row 0 is a wall; row 11 is never visible."""

    name, sha256, site, classes = "shuttle", "0" * 64, "shuttle", ()
    grid, period_s = GridSpec(SIZE, 0.5), 0.25

    def __init__(self, frames: int = 60) -> None:
        self.frames = frames

    def __len__(self) -> int:
        return self.frames

    def __iter__(self):
        for t in range(self.frames):
            visible, occupied = np.ones((SIZE, SIZE), bool), np.zeros((SIZE, SIZE), bool)
            visible[11] = False
            occupied[0] = occupied[5, t % SIZE] = True
            yield GridFrame(
                t * 250_000_000, visible, occupied, SE2(), np.zeros((1, 2), np.float32),
                self.grid.cell_centres(occupied), np.zeros(int(occupied.sum()), np.uint8),
            )  # fmt: skip


def no_score(tracker, source, steps):
    """A score in place of the referee's, which trackers cannot import: 1 - log loss of step 1."""
    tracker.reset(0)
    frames, losses = list(source), []
    for now, future in pairwise(frames):
        tracker.update(now)
        p = np.clip(tracker.predict(1).occupancy[1][future.visible], 1e-3, 1 - 1e-3)
        hit = future.occupied[future.visible]
        losses.append(-np.log(np.where(hit, p, 1 - p)).mean())
    return of_every_stratum(1.0 - np.mean(losses), np.mean(losses), steps)


def fit(tracker, folder, **options):
    settings = validated(tracker.Options, {"batch": 2, "warm_up": 0, "precision": "32-true", **options}, "test")
    lines: list[str] = []
    out, train, validation = folder / "shuttle.toml", [Shuttle()], [Shuttle(30)]
    more = {"command": "gridtrack train ...", "report": lines.append}
    task = FitTask(train, validation, no_score, out, settings, folder / "log", 7, **more)
    tracker.fit(task)
    return task, lines


def forecast(tracker, weights, frames=25, steps=3):
    source = Shuttle(frames)
    made = tracker(stream_of(source, weights), tracker.Options())
    made.reset(0)
    for frame in source:
        made.update(frame)
    return made.predict(steps).occupancy


def test_a_trained_network_forecasts_a_moving_dot(tmp_path):
    task, _ = fit(DilatedConvGRUTracker, tmp_path, updates=150, validate_every=75, learning_rate=0.01, channels=8)
    occupancy = forecast(DilatedConvGRUTracker, task.out)
    assert occupancy.shape == (4, SIZE, SIZE)
    assert occupancy.dtype == np.float32
    assert occupancy[:, 0].min() > 0.8  # the wall
    for step in range(4):
        assert occupancy[step, 5].argmax() == (24 + step) % SIZE


def test_a_training_does_not_repeat_what_its_libraries_warn_of_each_other(tmp_path, recwarn, monkeypatch):
    monkeypatch.setattr("shutil.which", lambda name, *rest, **more: f"/usr/bin/{name}")  # a machine with Slurm
    fit(DilatedConvGRUTracker, tmp_path, updates=2, validate_every=1, channels=4)
    assert [str(warning.message) for warning in recwarn] == []


def fit_paper_rnn(folder, score):
    options = {"variant": "paper", "updates": 6, "validate_every": 2, "batch": 2, "warm_up": 0, "precision": "32-true"}
    settings = validated(DeepTrackingRNNTracker.Options, options, "test")
    out, train, validation = folder / "shuttle.toml", [Shuttle()], [Shuttle(30)]
    DeepTrackingRNNTracker.fit(FitTask(train, validation, score, out, settings, folder / "log", 7))
    return read_card(out)


def test_a_resumed_training_equals_an_uninterrupted_one(tmp_path):
    def worse_and_worse(interrupt_at=None):
        """A score that falls from validation to validation, so that the best is not the last."""
        calls = iter(range(10))

        def score(tracker, source, steps):
            call = next(calls)
            if call == interrupt_at:
                raise KeyboardInterrupt
            return of_every_stratum(0.9 - 0.1 * call, 0.1, steps)

        return score

    seen = []

    def counted(tracker, source, steps):
        scored = no_score(tracker, source, steps)
        seen.append(tracker.predict(2).occupancy)
        return scored

    whole = fit_paper_rnn(tmp_path / "whole", counted)
    with pytest.raises((KeyboardInterrupt, SystemExit)):
        fit_paper_rnn(tmp_path / "parts", worse_and_worse(interrupt_at=2))
    through, seen[:] = seen[-1], []
    fit_paper_rnn(tmp_path / "parts", counted)
    assert len(seen) == 1
    assert np.array_equal(seen[0], through)
    assert whole.settings["updates"] == 6


def test_an_interrupt_keeps_the_best_weights_and_a_checkpoint_between_validations_is_resumed(tmp_path, monkeypatch):
    options = {"updates": 6, "validate_every": 3, "channels": 4}
    whole, _ = fit(DilatedConvGRUTracker, tmp_path / "whole", **options)
    monkeypatch.setattr(training, "CHECKPOINT_EVERY_S", 1e-6)
    drawn = []

    class InterruptedDataset(SequenceDataset):
        """Draws windows until an index."""

        end = 10

        def __getitem__(self, index):
            drawn.append(index)
            if index == self.end:
                raise KeyboardInterrupt
            return super().__getitem__(index)

    monkeypatch.setattr("gridtrack.trackers.recurrent.sequences.SequenceDataset", InterruptedDataset)
    with pytest.raises(KeyboardInterrupt):
        fit(DilatedConvGRUTracker, tmp_path / "parts", **options)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler, "the process hears the next one"
    kept = tmp_path / "parts" / "shuttle.toml"
    done = int(re.fullmatch(r"update (4|5) of 6", read_card(kept).interrupted)[1])
    forecast(DilatedConvGRUTracker, kept)

    drawn.clear()
    InterruptedDataset.end = 100
    resumed, _ = fit(DilatedConvGRUTracker, tmp_path / "parts", **options)
    assert drawn == list(range(2 * done, 12))
    assert np.array_equal(forecast(DilatedConvGRUTracker, resumed.out), forecast(DilatedConvGRUTracker, whole.out))
    assert read_card(resumed.out).interrupted == ""


def test_a_log_folder_of_another_training_is_refused(tmp_path):
    fit(DeepTrackingRNNTracker, tmp_path, updates=1, validate_every=1, variant="paper")
    with pytest.raises(ConfigurationError, match="other settings"):
        fit(DeepTrackingRNNTracker, tmp_path, updates=2, validate_every=1, variant="paper")


def test_the_card_has_the_settings_and_data_of_the_training(tmp_path):
    task, lines = fit(DeepTrackingRNNTracker, tmp_path, updates=2, validate_every=1, variant="paper")
    card = read_card(task.out)
    assert (card.tracker, card.site, card.seed, card.period_s) == ("deep-tracking-rnn", "shuttle", 7, 0.25)
    assert card.settings["variant"] == "paper"
    assert card.train[0].recording == "shuttle"
    assert any("update 2" in line for line in lines)


def test_an_option_that_contradicts_the_weights_is_refused(tmp_path):
    task, _ = fit(DeepTrackingRNNTracker, tmp_path, updates=1, validate_every=1, variant="paper")
    stream = stream_of(Shuttle(), task.out)
    with pytest.raises(WeightsError, match="variant=paper"):
        DeepTrackingRNNTracker(stream, DeepTrackingRNNTracker.Options(variant="code"))


def test_cells_that_are_not_visible_have_no_loss():
    settings = TrainingSettings(observed_frames=2, blank_frames=1, repetitions=1)
    network = DeepTrackingRNNTracker.build(SIZE, DeepTrackingRNNTracker.Options(variant="paper"), 0)
    windows = torch.zeros(1, 3, 2, SIZE, SIZE)
    windows[:, :, 0, 3, 4] = 1.0
    loss = sequence_loss(network, windows, settings, 0.05).mean
    state, logits = network.initial(1), []
    for x in (windows[:, 0], windows[:, 1], None):
        state = network.step(x, state)
        logits.append(network.occupancy(network.features(state))[0, 3, 4])
    expected = torch.nn.functional.softplus(torch.stack(logits)).mean()
    torch.testing.assert_close(loss, expected)


def test_the_burn_in_updates_the_state_without_loss_or_gradient():
    network = DilatedConvGRUTracker.build(SIZE, validated(DilatedConvGRUTracker.Options, {}, "test"), 0)
    settings = TrainingSettings(burn_in=5, observed_frames=2, blank_frames=2, repetitions=1)
    window = SequenceDataset([Shuttle()], settings, seed=0)[0].window[None].float()
    assert [settings.is_observed(frame) for frame in range(settings.length)] == [True] * 7 + [False] * 2

    loss = sequence_loss(network, window, settings, 0.05).mean

    state = network.initial(1)
    for x in window[0, :5]:
        state = network.step(x[None], state)
    after = [None] * 4
    for t, x in enumerate(window[0, 5:]):
        state = network.step(x[None] if t < 2 else None, tuple(h.detach() for h in state) if t == 0 else state)
        after[t] = network.occupancy(network.features(state))[0]
    seen, hit = window[0, 5:].unbind(dim=1)
    cells = torch.nn.functional.binary_cross_entropy_with_logits(torch.stack(after), hit, reduction="none") * seen
    by_hand = cells.sum() / seen.sum()
    gradients = [torch.autograd.grad(value, next(iter(network.parameters())))[0] for value in (loss, by_hand)]

    torch.testing.assert_close(loss, by_hand)
    torch.testing.assert_close(*gradients)


@pytest.mark.parametrize(("half", "tolerance"), [(False, 1e-5), (True, 0.01)])
@pytest.mark.parametrize(
    ("kind", "device"),
    [(DilatedConvGRUTracker, "cpu"), (DilatedConvGRUTracker, "cuda"), (DeepTrackingRNNTracker, "cpu")],
)
def test_the_training_network_has_the_loss_and_gradient_of_the_network(monkeypatch, kind, device, half, tolerance):
    """That of a CUDA device is computed here on the processor, its gates by PyTorch's operations."""
    monkeypatch.setattr(accelerated_convgru, "_compiled_gates", lambda: accelerated_convgru._gates)
    torch.manual_seed(3)
    settings = validated(
        kind.Options, {"burn_in": 2, "observed_frames": 3, "blank_frames": 2, "repetitions": 2}, "test"
    )
    network = kind.build(SIZE, settings, 0)
    in_training = kind.prepare_training(network, 0.05, device)
    for parameter in network.parameters():
        torch.nn.init.normal_(parameter, std=0.3)
    data = SequenceDataset([Shuttle()], settings, seed=0)
    windows = torch.stack([data[0].window, data[1].window]).float()

    def loss_and_gradient(one):
        with torch.autocast("cpu", torch.bfloat16, enabled=half):
            loss = sequence_loss(one, windows, settings, 0.05).mean
        return loss.detach(), torch.autograd.grad(loss, tuple(network.parameters()))

    loss, gradient = loss_and_gradient(network)
    found_loss, found_gradient = loss_and_gradient(in_training)

    assert in_training is not network
    torch.testing.assert_close(found_loss, loss, rtol=tolerance, atol=0)
    for found, expected in zip(found_gradient, gradient, strict=True):
        assert (found - expected).norm() < tolerance * expected.norm()


@pytest.mark.parametrize("device", ["cpu", "cuda"])
def test_the_loss_of_a_batch_is_that_of_the_cells_of_all_its_windows(monkeypatch, tmp_path, device):
    """By the plain network, a window at a time: those of unlike resolutions, of which the first sees little."""
    monkeypatch.setattr(accelerated_convgru, "_compiled_gates", lambda: accelerated_convgru._gates)
    monkeypatch.setattr(TrainingModule, "global_step", 0)
    torch.manual_seed(3)
    settings = validated(DilatedConvGRUTracker.Options, {"resolution_input": True, "static_gates": []}, "test")
    network = DilatedConvGRUTracker.build(SIZE, settings, 0)
    in_training = DilatedConvGRUTracker.prepare_training(network, 0.05, device)
    for parameter in network.parameters():
        torch.nn.init.normal_(parameter, std=0.3)
    data = SequenceDataset([Shuttle()], settings, seed=0)
    windows = torch.stack([data[0].window, data[1].window])
    windows[0, :, :, 1:] = 0
    resolutions = torch.tensor([[-1.0, 0.5], [1.0, -0.5]])
    module = TrainingModule(network, in_training, data, settings, lambda trained: {})

    def with_gradient(loss):
        return loss.detach(), torch.autograd.grad(loss, tuple(network.parameters()))

    loss, found = with_gradient(module.loss_of(Item(windows, resolutions)).mean)

    alone = []
    for window, resolution in zip(windows.float(), resolutions, strict=True):
        set_resolution(network, resolution)
        alone.append(with_gradient(sequence_loss(network, window[None], settings, 0.05).mean))
    share = windows[:, :, 0].sum(dim=(1, 2, 3)) / windows[:, :, 0].sum()
    torch.testing.assert_close(loss, share[0] * alone[0][0] + share[1] * alone[1][0])
    for together, first, second in zip(found, alone[0][1], alone[1][1], strict=True):
        expected = share[0] * first + share[1] * second
        assert (together - expected).norm() < 1e-4 * expected.norm()


@pytest.mark.parametrize(("every", "validated_after"), [(50, ["3"]), (2, ["2", "3"])])
def test_a_training_ends_after_its_updates_and_is_validated(tmp_path, every, validated_after):
    lines = []
    options = {"channels": 4, "updates": 3, "validate_every": every, "precision": "32-true", "stage": "occupancy"}
    options = validated(DilatedConvGRUTracker.Options, options, "test")

    def score(tracker, source, steps):
        return of_every_stratum(1.0, 0.1, steps)

    out, log = tmp_path / "shuttle.toml", tmp_path / "log"
    DilatedConvGRUTracker.fit(FitTask([Shuttle()], [Shuttle(30)], score, out, options, log, 1, report=lines.append))

    assert [line.split()[1] for line in lines if line.startswith("update")] == validated_after
    assert read_card(out).results["score"] == 1.0


def of_ten(**options):
    """Settings of windows of ten frames, five of them observed."""
    return TrainingSettings(observed_frames=5, blank_frames=5, repetitions=1, **options)


def test_windows_are_frames_of_the_recordings_and_depend_only_on_seed_and_number():
    data = SequenceDataset([Shuttle(30), Shuttle(40)], of_ten(time_reversal=True), seed=1)
    again = SequenceDataset([Shuttle(30), Shuttle(40)], of_ten(time_reversal=True), seed=1)
    directions = set()
    for number in range(40):
        window = data[number].window
        assert torch.equal(window, again[number].window)
        columns = window[:, 1, 5].argmax(dim=-1)
        directions |= set(((columns[1:] - columns[:-1]) % SIZE).tolist())
        assert window[:, 1, 0].all()
        assert not window[:, 0, 11].any()
    assert directions == {1, SIZE - 1}


def test_superposed_windows_are_the_frames_of_a_laser_with_the_objects_of_both():
    # Along a beam from the left: `one` is hit in cell 2, `other` in cell 5; cells behind a return are not visible.
    one = np.array([[[1, 1, 1, 0, 0, 0, 0, 0], [0, 0, 1, 0, 0, 0, 0, 0]]], np.uint8)
    other = np.array([[[1, 1, 1, 1, 1, 1, 0, 0], [0, 0, 0, 0, 0, 1, 0, 0]]], np.uint8)
    packed = superposed(np.packbits(one, axis=-1), np.packbits(other, axis=-1))
    assert np.array_equal(np.unpackbits(packed, axis=-1), one)


def test_superposition_applies_to_half_of_the_windows():
    data = SequenceDataset([Shuttle(60)], of_ten(superposition=True), seed=1)
    dots = [int(data[number].window[0, 1, 5].sum()) for number in range(200)]
    assert set(dots) == {1, 2}
    assert 60 < sum(count == 2 for count in dots) < 130


def test_every_epoch_continues_the_series_of_windows():
    sampler = EpochSampler(3, 8)
    sampler.set_epoch(1)
    assert list(sampler) == [3, 4, 5]
    sampler.set_epoch(2)
    assert list(sampler) == [6, 7], "no more than a training has"


def test_devices_share_each_batch():
    """Two devices, batches of four: each has two windows of each."""
    samplers = [EpochSampler(8, 12, 4, rank=rank, devices=2) for rank in range(2)]
    assert [list(sampler) for sampler in samplers] == [[4, 6], [5, 7]], (
        "a resumed training goes on after its first batch"
    )
    for sampler in samplers:
        sampler.set_epoch(1)
    assert [list(sampler) for sampler in samplers] == [[8, 10], [9, 11]]


@pytest.mark.parametrize("tracker", [DilatedConvGRUTracker, DeepTrackingRNNTracker])
def test_a_training_on_two_devices_has_the_weights_of_one(tmp_path, monkeypatch, tracker):
    """Here processors; every second window sees a row only, so that a mean of means would be another loss."""
    monkeypatch.setattr("os.sched_getaffinity", lambda of: {0, 1})

    class UnlikeWindows(SequenceDataset):
        def __getitem__(self, index):
            item = super().__getitem__(index)
            if index % 2:
                item.window[:, :, 1:] = 0
            return item

    monkeypatch.setattr("gridtrack.trackers.recurrent.sequences.SequenceDataset", UnlikeWindows)
    options = {"updates": 4, "validate_every": 2, "batch": 4, "learning_rate": 0.01}
    options |= {"channels": 4, "stage": "occupancy"} if tracker is DilatedConvGRUTracker else {"variant": "paper"}
    one, lines = fit(tracker, tmp_path / "one", **options)
    two, lines_of_two = fit(tracker, tmp_path / "two", **options, devices=2)

    expected, found = (load_file(task.out.with_suffix(".safetensors")) for task in (one, two))
    for name, value in expected.items():
        np.testing.assert_allclose(found[name], value, atol=2e-5, err_msg=name)
    updates = [[line.split()[1] for line in each if line.startswith("update")] for each in (lines, lines_of_two)]
    assert updates == [["2", "4"], ["2", "4"]], "a device tells this process of its validations"
    assert read_card(two.out).settings["devices"] == 2
    assert read_card(two.out).results == pytest.approx(read_card(one.out).results, abs=1e-4)


def test_an_interrupt_of_a_training_on_two_devices_ends_them_and_keeps_the_best_weights(tmp_path, monkeypatch):
    """Ctrl-C in the second validation, which the process of a device does."""
    monkeypatch.setattr("os.sched_getaffinity", lambda of: {0, 1})
    here, calls = os.getpid(), iter(range(9))

    def score(tracker, source, steps):
        if next(calls) == 1:
            os.kill(here, signal.SIGINT)
            time.sleep(60)
        return no_score(tracker, source, steps)

    options = {"variant": "paper", "updates": 6, "validate_every": 2, "batch": 2, "precision": "32-true", "devices": 2}
    options = validated(DeepTrackingRNNTracker.Options, options, "test")
    out, log = tmp_path / "shuttle.toml", tmp_path / "log"
    with pytest.raises(KeyboardInterrupt):
        DeepTrackingRNNTracker.fit(FitTask([Shuttle()], [Shuttle(30)], score, out, options, log, 7))

    assert multiprocessing.active_children() == []
    assert re.fullmatch("update [24] of 6", read_card(out).interrupted)


@pytest.mark.parametrize(
    ("options", "message"),
    [({"devices": 2, "batch": 3}, "devices=2 cannot share batch=3 equally"),
     ({"devices": 4096, "batch": 4096}, "devices=4096: this machine has [0-9]+ of kind cpu")],
)  # fmt: skip
def test_devices_that_cannot_train_are_refused(tmp_path, options, message):
    with pytest.raises(ConfigurationError, match=message):
        fit(DilatedConvGRUTracker, tmp_path, channels=4, **options)


def test_the_occupied_rate_is_that_of_the_visible_cells():
    data = SequenceDataset([Shuttle(12)], of_ten(), seed=0)
    assert data.occupied_rate == pytest.approx((SIZE + 1) / (SIZE * (SIZE - 1)))


def test_a_stretch_shorter_than_a_window_is_refused_by_name():
    with pytest.raises(ConfigurationError, match="shuttle: 5 frames; training needs at least 40"):
        SequenceDataset([Shuttle(5)], TrainingSettings(), seed=0)


def test_cells_near_an_entered_one_have_more_weight_until_the_last_update(monkeypatch, tmp_path):
    """By hand: the loss is the weighted mean over visible cells; the weight falls linearly to zero."""
    torch.manual_seed(1)
    settings = validated(
        DilatedConvGRUTracker.Options,
        {"observed_frames": 8, "blank_frames": 6, "repetitions": 1, "motion_weight": 3.0, "updates": 4},
        "test",
    )
    network = DilatedConvGRUTracker.build(SIZE, settings, 0)
    data = SequenceDataset([Shuttle()], settings, seed=0)
    window = data[0].window[None]
    near = near_entered_cells(window.bool())[0]
    assert 0 < near.float().mean() < 0.9
    state, logits = network.initial(1), []
    for t, x in enumerate(window[0]):
        state = network.step(x[None].float() if t < 8 else None, state)
        logits.append(network.occupancy(network.features(state))[0])
    weight = window[0, :, 0] * (1.0 + 2.0 * near)
    cells = torch.nn.functional.binary_cross_entropy_with_logits(
        torch.stack(logits), window[0, :, 1].float(), reduction="none"
    )
    loss = sequence_loss(network, window.float(), settings, 0.05, motion_weight=2.0).mean
    torch.testing.assert_close(loss, (cells * weight).sum() / weight.sum())

    module = TrainingModule(network, network, data, settings, lambda trained: {})
    weights = []
    for step in range(4):
        monkeypatch.setattr(TrainingModule, "global_step", step)
        weights.append(module.motion_weight)
    assert weights == [3.0, 2.25, 1.5, 0.75]

"""Training of the recurrent networks: loss, resumption, interrupts, devices, precision, static memory, and the card."""

from __future__ import annotations

import json
import multiprocessing
import os
import re
import signal
import time
import warnings

import numpy as np
import pytest
import torch
from torch.nn.functional import binary_cross_entropy_with_logits

from gridtrack.common.errors import ConfigurationError, WeightsError
from gridtrack.common.geometry import SE2
from gridtrack.trackers.recurrent import devices
from gridtrack.trackers.recurrent import fit as fit_module
from gridtrack.trackers.recurrent.convgru_tracker import DilatedConvGRUTracker
from gridtrack.trackers.recurrent.deep_tracking_rnn import DeepTrackingRNNTracker
from gridtrack.trackers.recurrent.devices import Devices
from gridtrack.trackers.recurrent.kernels import convgru as convgru_kernels
from gridtrack.trackers.recurrent.motion import near_entered_cells
from gridtrack.trackers.recurrent.network import set_resolution
from gridtrack.trackers.recurrent.sequences import Item, SequenceDataset
from gridtrack.trackers.recurrent.settings import TrainingSettings
from gridtrack.trackers.recurrent.training_module import TrainingModule, sequence_loss
from gridtrack.trackers.training.weights import read_card
from tests.trackers.recurrent.sources import (
    BRIEF,
    TRACKERS,
    Drive,
    Shuttle,
    arrays_of,
    convgru,
    fit,
    forecast_of,
    log_loss_of,
    task_for,
    trained,
)
from tests.trackers.scores import of_every_stratum

TRAIN, VALIDATE = [Shuttle()], [Shuttle(30)]


def card_in(folder):
    return folder / "shuttle.toml"


# The loss


def settings_of(**options):
    return TrainingSettings(**BRIEF | options)


@pytest.mark.parametrize("options", [{}, {"burn_in": 5}, {"motion_weight": 2.0}, {"unseen_weight": 0.5}])
def test_the_loss_is_the_weighted_cross_entropy_of_the_visible_cells_in_every_frame_after_the_burn_in(options):
    """By hand, with its gradient, which does not reach the burn-in; blank frames have empty input."""
    network, settings = convgru().requires_grad_(), settings_of(observed_frames=8, blank_frames=6, **options)
    window = SequenceDataset(TRAIN, settings, seed=0)[0].window.float()
    loss = sequence_loss(network, window[None], settings, 0.05, settings.motion_weight).mean

    state, logits, start = network.initial(1), [], settings.burn_in
    for t, x in enumerate(window):
        if t == start:
            state = tuple(h.detach() for h in state)
        state = network.step(x[None] if t < start + 8 else None, state)
        logits.append(network.occupancy(network.features(state))[0])
    logits, (seen, hit) = torch.stack(logits[start:]), window[start:].unbind(dim=1)
    near = near_entered_cells(window[None].bool())[0, start:]
    assert 0 < near.float().mean() < 0.9
    weight = seen * (1.0 + settings.motion_weight * near)
    never = ~window[:, 0].bool().any(dim=0)
    total = (weight * binary_cross_entropy_with_logits(logits, hit, reduction="none")).sum()
    rate = torch.full_like(logits[:, never], 0.05)
    total += settings.unseen_weight * binary_cross_entropy_with_logits(logits[:, never], rate, reduction="sum")
    by_hand = total / weight.sum()
    gradients = [torch.autograd.grad(value, next(iter(network.parameters())))[0] for value in (loss, by_hand)]
    torch.testing.assert_close(loss, by_hand)
    torch.testing.assert_close(*gradients)


def module_of(network, in_training, data, settings):
    return TrainingModule(network, in_training, data, settings, Devices("cpu", 1), lambda trained: {})


def test_the_motion_weight_falls_to_zero_until_the_last_update(monkeypatch):
    settings = settings_of(motion_weight=3.0, updates=4)
    module, weights = module_of(convgru(), convgru(), SequenceDataset(TRAIN, settings, seed=0), settings), []
    for step in range(4):
        monkeypatch.setattr(TrainingModule, "global_step", step)
        weights.append(module.motion_weight)
    assert weights == [3.0, 2.25, 1.5, 0.75]


@pytest.mark.parametrize("device", ["cpu", "cuda"])
def test_the_loss_of_a_batch_is_over_the_cells_of_all_its_windows(monkeypatch, device):
    """By the plain network, a window at a time: windows of different resolutions, of which the first sees little."""
    monkeypatch.setattr(convgru_kernels, "compiled_gates", lambda: convgru_kernels.plain_gates)
    monkeypatch.setattr(TrainingModule, "global_step", 0)
    network, settings = convgru(resolution_input=True, static_gates=()).requires_grad_(), settings_of()
    data = SequenceDataset(TRAIN, settings, seed=0)
    windows = torch.stack([data[0].window, data[1].window])
    windows[0, :, :, 1:] = 0
    resolutions = torch.tensor([[-1.0, 0.5], [1.0, -0.5]])
    module = module_of(network, DilatedConvGRUTracker.prepare_training(network, device), data, settings)

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


# A training


def test_a_trained_network_forecasts_a_moving_dot(tmp_path):
    card = card_in(tmp_path)
    long = {"updates": 150, "validate_every": 150, "learning_rate": 0.02, "observed_frames": 6, "blank_frames": 4}
    fit(DilatedConvGRUTracker, card, TRAIN, VALIDATE, objective=log_loss_of, repetitions=1, **long)
    occupancy = forecast_of(trained(DilatedConvGRUTracker, card, Shuttle()), Shuttle(25), 3)
    assert occupancy.shape == (4, 12, 12)
    assert occupancy.dtype == np.float32
    assert occupancy[:, 0].min() > 0.8  # the wall
    for step in range(4):
        assert occupancy[step, 5].argmax() == (24 + step) % 12


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    """The card of a training of two updates, its lines and its warnings."""
    card = card_in(tmp_path_factory.mktemp("short"))
    with pytest.MonkeyPatch.context() as patch, warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("default")
        patch.setattr("shutil.which", lambda name, *rest, **more: f"/usr/bin/{name}")  # a machine with Slurm
        lines = fit(DeepTrackingRNNTracker, card, TRAIN, VALIDATE, updates=2, **BRIEF)
    return card, lines, [str(warning.message) for warning in warned]


def test_the_card_has_the_settings_and_data_of_the_training(short):
    card, lines, _ = short
    written = read_card(card)
    assert (written.tracker, written.site, written.seed, written.period_s) == ("deep-tracking-rnn", "shuttle", 7, 0.25)
    assert written.settings["variant"] == "paper"
    assert written.train[0].recording == "shuttle"
    assert any("update 2" in line for line in lines)


def test_a_training_does_not_repeat_warnings_of_its_libraries_about_each_other(short):
    assert short[2] == []


def test_a_log_folder_of_another_training_is_refused(short):
    with pytest.raises(ConfigurationError, match="of another training: updates is 3, there 2"):
        fit(DeepTrackingRNNTracker, short[0], TRAIN, VALIDATE, updates=3, **BRIEF)


def test_an_option_that_contradicts_the_weights_is_refused(short):
    with pytest.raises(WeightsError, match="variant=paper"):
        trained(DeepTrackingRNNTracker, short[0], Shuttle(), variant="code")


@pytest.mark.parametrize(("every", "validated_after"), [(50, ["3"]), (2, ["2", "3"])])
def test_a_training_ends_after_its_updates_and_is_validated(tmp_path, every, validated_after):
    card = card_in(tmp_path)
    lines = fit(DilatedConvGRUTracker, card, TRAIN, VALIDATE, updates=3, validate_every=every, **BRIEF)
    assert [line.split()[1] for line in lines if line.startswith("update")] == validated_after
    assert read_card(card).results["score"] == 1.0


class WorseAndWorse:
    """An objective that falls from validation to validation, so that the best is not the last; keeps the forecasts."""

    def __init__(self, interrupt_at=None):
        self.interrupt_at, self.forecasts = interrupt_at, []

    def __call__(self, tracker, source, steps):
        calls = len(self.forecasts)
        if calls == self.interrupt_at:
            raise KeyboardInterrupt
        self.forecasts.append(forecast_of(tracker, source, 2))
        return of_every_stratum(0.9 - 0.1 * calls, 0.1, steps)


def test_a_resumed_training_equals_an_uninterrupted_one(tmp_path):
    def run(name, objective):
        options = {"updates": 6, "validate_every": 2, "objective": objective, **BRIEF}
        fit(DeepTrackingRNNTracker, card_in(tmp_path / name), TRAIN, VALIDATE, **options)
        return objective.forecasts

    whole = run("whole", WorseAndWorse())
    with pytest.raises((KeyboardInterrupt, SystemExit)):
        run("parts", WorseAndWorse(interrupt_at=2))
    (resumed,) = run("parts", WorseAndWorse())
    assert np.array_equal(resumed, whole[-1])


def test_an_interrupt_keeps_the_best_weights_and_a_checkpoint_between_validations_is_resumed(tmp_path, monkeypatch):
    def run(name):
        card = card_in(tmp_path / name)
        options = {"updates": 6, "validate_every": 3, "objective": log_loss_of, **BRIEF}
        fit(DilatedConvGRUTracker, card, TRAIN, VALIDATE, **options)
        return card

    whole = run("whole")
    monkeypatch.setattr(fit_module, "CHECKPOINT_EVERY_S", 1e-6)
    drawn = []

    class InterruptedDataset(SequenceDataset):
        """Draws windows until an index."""

        end = 10

        def __getitem__(self, index):
            drawn.append(index)
            if index == self.end:
                raise KeyboardInterrupt
            return super().__getitem__(index)

    monkeypatch.setattr(fit_module, "SequenceDataset", InterruptedDataset)
    with pytest.raises(KeyboardInterrupt):
        run("parts")
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler, "the process hears the next one"
    kept = card_in(tmp_path / "parts")
    done = int(re.fullmatch(r"update (4|5) of 6", read_card(kept).interrupted)[1])
    forecast_of(trained(DilatedConvGRUTracker, kept, Shuttle()), Shuttle(25), 3)

    drawn.clear()
    InterruptedDataset.end = 100
    resumed = run("parts")
    assert drawn == list(range(2 * done, 12))
    for name, value in arrays_of(whole).items():
        assert np.array_equal(arrays_of(resumed)[name], value), name
    assert read_card(resumed).interrupted == ""


# Devices and precision


@pytest.mark.parametrize("tracker", TRACKERS)
def test_a_training_on_two_devices_has_the_weights_of_one(tmp_path, monkeypatch, tracker):
    """Here processors; every second window sees a row only, so that a mean of means would be another loss."""
    monkeypatch.setattr("os.sched_getaffinity", lambda of: {0, 1})

    class UnlikeWindows(SequenceDataset):
        def __getitem__(self, index):
            item = super().__getitem__(index)
            if index % 2:
                item.window[:, :, 1:] = 0
            return item

    monkeypatch.setattr(fit_module, "SequenceDataset", UnlikeWindows)
    monkeypatch.setattr(fit_module, "STORED_AS", torch.float32)  # a step of float16 is larger than the difference
    options = {"updates": 4, "validate_every": 2, "batch": 4, "learning_rate": 0.01, "objective": log_loss_of, **BRIEF}
    one, two = card_in(tmp_path / "one"), card_in(tmp_path / "two")
    lines = [fit(tracker, card, TRAIN, VALIDATE, devices=n, **options) for n, card in ((1, one), (2, two))]

    found = arrays_of(two)
    for name, value in arrays_of(one).items():
        np.testing.assert_allclose(found[name], value, atol=2e-5, err_msg=name)
    updates = [[line.split()[1] for line in each if line.startswith("update")] for each in lines]
    assert updates == [["2", "4"], ["2", "4"]], "a device reports its validations to this process"
    assert read_card(two).settings["devices"] == 2
    assert read_card(two).results == pytest.approx(read_card(one).results, abs=1e-4)


def test_an_interrupt_of_a_training_on_two_devices_ends_them_and_keeps_the_best_weights(tmp_path, monkeypatch):
    """Ctrl-C in the second validation, which the process of a device does."""
    monkeypatch.setattr("os.sched_getaffinity", lambda of: {0, 1})
    here, calls = os.getpid(), iter(range(9))

    def interrupted(tracker, source, steps):
        if next(calls) == 1:
            os.kill(here, signal.SIGINT)
            time.sleep(60)
        return log_loss_of(tracker, source, steps)

    options = {"updates": 6, "validate_every": 2, "devices": 2, "objective": interrupted, **BRIEF}
    with pytest.raises(KeyboardInterrupt):
        fit(DeepTrackingRNNTracker, card_in(tmp_path), TRAIN, VALIDATE, **options)

    assert multiprocessing.active_children() == []
    assert re.fullmatch("update [24] of 6", read_card(card_in(tmp_path)).interrupted)


@pytest.mark.parametrize(
    ("kind", "number", "batch", "message"),
    [("auto", 2, 3, "devices=2 cannot share batch=3 equally"),
     ("auto", 4096, 4096, "devices=4096: this machine has [0-9]+ of kind cpu"),
     ("xpu", 1, 2, "device xpu: this machine has none; train on cpu")],
)  # fmt: skip
def test_devices_that_cannot_train_are_refused(kind, number, batch, message):
    with pytest.raises(ConfigurationError, match=message):
        Devices.of(kind, number, batch)


@pytest.mark.parametrize("faster", ["32-true", "bf16-mixed"])
def test_the_faster_precision_is_taken_reported_once_and_on_the_card(tmp_path, monkeypatch, faster):
    """A resumed training keeps it."""
    took_ms = {"32-true": 2.0, "bf16-mixed": 2.0, faster: 1.0}
    monkeypatch.setattr(devices, "convolution_ms", lambda precision, device: took_ms[precision])
    lines = fit(DeepTrackingRNNTracker, card_in(tmp_path), TRAIN, VALIDATE, precision="auto", **BRIEF)
    assert read_card(card_in(tmp_path)).settings["precision"] == faster
    (line,) = [line for line in lines if line.startswith("precision")]
    assert line.startswith(f"precision {faster}: a convolution and its gradient take 32-true")

    took_ms[faster] = 3.0
    lines = fit(DeepTrackingRNNTracker, card_in(tmp_path), TRAIN, VALIDATE, precision="auto", **BRIEF)
    assert read_card(card_in(tmp_path)).settings["precision"] == faster
    assert json.loads((tmp_path / "log" / "settings.json").read_text())["precision"] == faster
    assert not any(line.startswith("precision") for line in lines)


@pytest.mark.parametrize(("bfloat16_ms", "tries"), [(3.0, 8), (30.0, 1)])
def test_a_clearly_slower_precision_is_tried_once(tmp_path, monkeypatch, bfloat16_ms, tries):
    took_ms, tried = {"32-true": 2.0, "bf16-mixed": bfloat16_ms}, []
    monkeypatch.setattr(
        devices, "convolution_ms", lambda precision, device: tried.append(precision) or took_ms[precision]
    )
    fit(DeepTrackingRNNTracker, card_in(tmp_path), TRAIN, VALIDATE, precision="auto", **BRIEF)
    assert (tried.count("32-true"), tried.count("bf16-mixed")) == (8, tries)


def test_the_measurement_does_not_change_the_trained_network(tmp_path, monkeypatch):
    monkeypatch.setattr(devices, "TRIES", 1)
    monkeypatch.setattr(devices, "get_args", lambda _: ("32-true",))
    cards = {chosen: card_in(tmp_path / chosen) for chosen in ("auto", "32-true")}
    for chosen, card in cards.items():
        fit(DeepTrackingRNNTracker, card, TRAIN, VALIDATE, precision=chosen, **BRIEF)
    one, other = (card.with_suffix(".safetensors").read_bytes() for card in cards.values())
    assert one == other


# Static memory


@pytest.mark.parametrize("sources", [[Drive()], [Drive(speed=0), Drive(start=1, speed=0)]], ids=["moves", "elsewhere"])
def test_if_the_windows_differ_the_network_is_trained_without_static_memory_and_says_so(tmp_path, sources):
    card = card_in(tmp_path)
    lines = fit(DilatedConvGRUTracker, card, sources, [Drive(15)], **BRIEF)
    assert "the windows of the training frames differ: trained without static memory (static_gates=[])" in lines
    assert read_card(card).settings["static_gates"] == []
    assert trained(DilatedConvGRUTracker, card, Drive()).network.unseen(3)[0][0].shape == (4,)


@pytest.mark.parametrize(
    ("general", "message"),
    [(False, r"static memory has the cells of one window.*static_gates=\[\]"),
     (True, r"general weights know no place.*static_gates=\[\]")],
)  # fmt: skip
def test_static_memory_that_was_asked_for_is_refused_without_one_place(tmp_path, general, message):
    task, _ = task_for(DilatedConvGRUTracker, card_in(tmp_path), [Drive()], general=general, static_gates=["candidate"])
    with pytest.raises(ConfigurationError, match=message):
        DilatedConvGRUTracker.fit(task)


def test_if_the_window_stays_the_network_has_static_memory_at_its_place(tmp_path):
    card = card_in(tmp_path)
    fit(DilatedConvGRUTracker, card, [Drive(start=30, speed=0)], [Drive(15)], **BRIEF)
    assert read_card(card).settings["static_gates"] == ["keep", "reset", "candidate"]
    assert read_card(card).map_pose == SE2(15.0, 0.0)

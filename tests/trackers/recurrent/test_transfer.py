"""Inductive transfer: classes from a latent state, and together with the scan in the cells that are occupied now."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from gridtrack.common.errors import WeightsError
from gridtrack.common.grid import GridSpec
from gridtrack.trackers.contract import StreamSpec, stream_of
from gridtrack.trackers.one_shot import OneShotTracker
from gridtrack.trackers.recurrent import transfer
from gridtrack.trackers.recurrent.convgru_tracker import DilatedConvGRUTracker
from gridtrack.trackers.recurrent.deep_tracking_rnn import DeepTrackingRNNTracker
from gridtrack.trackers.recurrent.seen_cells import PREFIX, SeenCells, seen_cells_of
from gridtrack.trackers.recurrent.transfer import latent_cells
from gridtrack.trackers.training import cell_training
from gridtrack.trackers.training.cell_classifier import planes_of, scan_classifier
from gridtrack.trackers.training.cell_training import LabelledCells, logits_of
from gridtrack.trackers.training.labelled_scans import ClassifierSettings
from gridtrack.trackers.training.weights import Weights, load_weights, read_card, save_weights
from tests.trackers.labelled_scenes import SIZE, Scene, accuracy, fit, stands, walks
from tests.trackers.recurrent import sources
from tests.trackers.recurrent.sources import Walk, frame_of

from scenes.frames import card_of

NETWORK = {"channels": 4, "layers": 2, "updates": 1, "warm_up": 0, "validate_every": 1, "precision": "32-true"}
DECODER = {"class_layers": 2, "class_channels": 16}


@pytest.fixture(scope="module", autouse=True)
def short_trainings():
    """The search of the class decoder has one iteration instead of ten: the scenes need no search."""
    short = {"learning_rate": 0.01, "updates": 200, "batch": 64}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            cell_training, "candidate_settings", lambda given, seed: [ClassifierSettings(**(short | dict(given)))]
        )
        patch.setattr(transfer, "SCAN_SETTINGS", ClassifierSettings(class_weights="none", updates=20, batch=64))
        yield


@pytest.fixture(scope="module")
def latent(tmp_path_factory):
    """Weights of a ConvGRU after one update, with a class decoder trained after it."""
    return fit(DilatedConvGRUTracker, tmp_path_factory.mktemp("latent"), (stands, walks), **NETWORK, **DECODER)


def test_classes_that_differ_in_motion_are_separated_by_a_latent_state_and_not_by_one_scan(latent, tmp_path):
    assert accuracy(DilatedConvGRUTracker, latent, (stands, walks), evidence="state") > 0.95
    one_shot = fit(OneShotTracker, tmp_path, (stands, walks), channels=16, updates=100)
    assert accuracy(OneShotTracker, one_shot, (stands, walks)) < 0.75


def test_labels_are_learned_for_the_scan_and_for_forecasts_of_it_from_earlier_frames(latent):
    source = Scene((stands, walks), 40, unlabelled=20)
    tracker = DilatedConvGRUTracker(stream_of(source, latent), DilatedConvGRUTracker.Options())
    found = latent_cells(lambda _: tracker, [(source, source.labelled())], ("stander", "walker"), "last", every=5)
    now, ahead, scan = found.now.cells(), found.ahead.cells(), found.scan.cells()
    assert now.planes.shape == (4, SIZE, SIZE, NETWORK["channels"])
    assert scan.planes.shape == (4, SIZE, SIZE, 2)
    assert torch.equal(scan.planes.flatten(1, 2)[now.at, now.cells, 1], torch.ones(len(now.cells), dtype=torch.uint8))
    assert ahead.targets.tolist() == [label for at in range(4) for label in now.targets[now.at == at].tolist() * 2]
    frames = list(source)
    tracker.reset(0)
    for frame in frames[:17]:
        tracker.update(frame)
    blind = tracker.state
    for _ in range(4):
        blind = tracker.network.step(None, blind)
    torch.testing.assert_close(ahead.planes[0], blind[-1][-1][0].permute(1, 2, 0).half(), msg="frame 20 from frame 16")


def test_all_layers_of_the_state_can_be_decoded(tmp_path):
    path = fit(DilatedConvGRUTracker, tmp_path, (stands, walks), decoded_layers="all", **NETWORK, **DECODER)
    weights = load_weights(stream_of(Scene(()), path), "dilated-convgru")
    assert weights.arrays["decode_semantics.layers.0.weight"].shape[1] == NETWORK["layers"] * NETWORK["channels"]
    assert accuracy(DilatedConvGRUTracker, path, (stands, walks), evidence="state") > 0.95
    other = DilatedConvGRUTracker.Options(decoded_layers="last")
    with pytest.raises(WeightsError, match="trained with decoded_layers=all, not last"):
        DilatedConvGRUTracker(stream_of(Scene(()), path), other)


def test_adding_classes_does_not_change_the_occupancy_weights(latent, tmp_path):
    path = fit(DilatedConvGRUTracker, tmp_path, (stands, walks), stage="occupancy", **NETWORK)
    before = load_weights(stream_of(Scene(()), path), "dilated-convgru")
    assert before.card.classes == ()
    fit(DilatedConvGRUTracker, tmp_path, (stands, walks), stage="classes", **DECODER)
    after = load_weights(stream_of(Scene(()), path), "dilated-convgru")
    added = {name.partition(".")[0] for name in after.arrays.keys() - before.arrays.keys()}
    assert added == {"decode_semantics", "seen_cells"}
    assert all(after.arrays[name].tobytes() == array.tobytes() for name, array in before.arrays.items())
    assert after.card.command == before.card.command
    assert after.card.results["classes"]["command"] == f"gridtrack train { ({'stage': 'classes'} | DECODER) }"
    at_once = load_weights(stream_of(Scene(()), latent), "dilated-convgru")
    assert {k: v.tobytes() for k, v in at_once.arrays.items()} == {k: v.tobytes() for k, v in after.arrays.items()}


def test_the_card_names_only_the_classes_with_labelled_cells(latent):
    card = read_card(latent)
    assert card.classes == ("stander", "walker")
    assert card.settings["labelled_scans"] == 150
    other = replace(stream_of(Scene(()), latent), classes=("cow", "walker", "stander"))
    assert DilatedConvGRUTracker(other, DilatedConvGRUTracker.Options()).classes == ("stander", "walker")


@pytest.mark.parametrize(
    ("classes", "message"),
    [
        ((), "arrays that do not belong to the network on its card: .*decode_semantics"),
        (("stander", "stander"), "a class is named twice"),
        (("stander", "walker", "horse"), r"layers.1.weight' is \(2, 16, 3, 3\), expected \(3, 16, 3, 3\)"),
    ],
)
def test_a_card_with_other_classes_than_the_decoder_is_refused(latent, tmp_path, classes, message):
    weights = load_weights(stream_of(Scene(()), latent), "dilated-convgru")
    path = tmp_path / "toy.toml"
    save_weights(path, weights.card.model_copy(update={"classes": classes}), weights.arrays)
    with pytest.raises(WeightsError, match=message):
        DilatedConvGRUTracker(stream_of(Scene(()), path), DilatedConvGRUTracker.Options())


def test_classes_cannot_be_added_without_weights_or_to_a_network_of_other_shape(latent, tmp_path):
    with pytest.raises(WeightsError, match=r"toy\.toml: no weights to add classes to"):
        fit(DilatedConvGRUTracker, tmp_path, (stands, walks), stage="classes")
    with pytest.raises(WeightsError, match="trained with channels=4, not 8"):
        fit(DilatedConvGRUTracker, latent.parent, (stands, walks), stage="classes", channels=8)


def test_a_decoder_of_one_layer_replaces_another_decoder(latent, tmp_path):
    before = load_weights(stream_of(Scene(()), latent), "dilated-convgru")
    path = tmp_path / "toy.toml"
    save_weights(path, before.card, before.arrays)
    fit(DilatedConvGRUTracker, tmp_path, (stands, walks), stage="classes", class_layers=1, class_channels=8)
    after = load_weights(stream_of(Scene(()), path), "dilated-convgru")
    decoder = {name: array.shape for name, array in after.arrays.items() if name.startswith("decode_semantics")}
    assert decoder == {"decode_semantics.layers.0.weight": (2, 4, 3, 3), "decode_semantics.layers.0.bias": (2,)}
    assert after.card.settings["class_layers"] == 1
    assert accuracy(DilatedConvGRUTracker, path, (stands, walks)) > 0.9


FINE, COARSE = Walk(20, 0.05, 0.1, classes=("car",)), Walk(14, 0.2, 0.2, classes=("walker",))
GENERAL = {"labelled_scans": 40, "updates": 1, "stage": "both", "class_channels": 8}


@pytest.fixture(scope="module")
def general(tmp_path_factory):
    """The card of general weights of the ConvGRU with a class decoder, from recordings with one class each."""
    card = tmp_path_factory.mktemp("general") / "general.toml"
    sources.fit(DilatedConvGRUTracker, card, [FINE, COARSE], general=True, **GENERAL)
    return card


def test_classes_are_learned_from_all_recordings_and_a_dot_is_classified_by_the_size_of_its_cells(general, tmp_path):
    """The card has the classes of all recordings together."""
    one_shot, options = tmp_path / "general.toml", OneShotTracker.Options(labelled_scans=40, channels=8)
    task, _ = sources.task_for(DilatedConvGRUTracker, one_shot, [FINE, COARSE], general=True)
    OneShotTracker.fit(replace(task, options=options))
    for tracker, card in ((DilatedConvGRUTracker, general), (OneShotTracker, one_shot)):
        assert set(read_card(card).classes) == {"walker", "car"}
        for source, expected in ((FINE, "car"), (COARSE, "walker")):
            made = sources.trained(tracker, card, source)
            for frame in source:
                made.update(frame)
            ((row, column),) = np.argwhere(frame.occupied)
            semantics = made.predict(2).semantics[0]
            assert semantics.shape[1:] == source.grid.shape
            assert made.classes[semantics[:, row, column].argmax()] == expected


def test_without_labels_the_class_decoder_of_the_general_weights_is_left_out(general, tmp_path):
    class Place(Walk):
        site = "yard"

    card, place = tmp_path / "yard.toml", Place(18, 0.15, 0.16)
    lines = sources.fit(DilatedConvGRUTracker, card, [place], start=general, stage="both")
    assert read_card(card).classes == ()
    assert any("class decoder of the general weights is left out" in line for line in lines)
    assert sources.trained(DilatedConvGRUTracker, card, place).predict(1).semantics is None
    for tracker, options, starts in (
        (DilatedConvGRUTracker, {}, True),
        (DilatedConvGRUTracker, {"stage": "classes"}, False),
        (DeepTrackingRNNTracker, {}, True),
    ):
        assert tracker.starts_from_general(tracker.Options(**options)) == starts


# Cells that are occupied now

CLASSES = ("pedestrian", "car", "static")
GRID = GridSpec(SIZE, 0.5)
STREAM = StreamSpec(GRID, 0.1, "toy")


def frame_with(*cells):
    occupied = np.zeros((SIZE, SIZE), bool)
    for cell in cells:
        occupied[cell] = True
    return frame_of(np.ones_like(occupied), occupied)


@pytest.fixture
def seen():
    torch.manual_seed(2)
    return SeenCells(scan_classifier(32, len(CLASSES))).eval()


def random_semantics(seed=0):
    return np.random.default_rng(seed).dirichlet(np.ones(3), (SIZE, SIZE)).transpose(2, 0, 1).astype(np.float32)


def test_seen_cells_have_the_product_of_both_classifiers_and_hidden_ones_keep_the_state(seen):
    seen.with_scan.copy_(torch.tensor([0.5, 0.8]))
    frame = frame_with((3, 4), (3, 5), (0, 11))
    state, semantics = random_semantics(), random_semantics()
    with torch.inference_mode():
        seen.apply_to(semantics, frame, "scan")
        scan = torch.softmax(seen.classifier(planes_of(frame)[None].float()), dim=1)[0].numpy()
    for row, column in ((3, 4), (3, 5), (0, 11)):
        product = state[:, row, column] ** 0.5 * scan[:, row, column] ** 0.8
        assert semantics[:, row, column] == pytest.approx(product / product.sum(), abs=1e-5)
    assert (semantics[:, ~frame.occupied] == state[:, ~frame.occupied]).all()
    assert semantics.sum(axis=0) == pytest.approx(np.ones((SIZE, SIZE)), abs=1e-5)


def test_without_the_scan_seen_cells_are_calibrated_by_a_power(seen):
    seen.state_alone.copy_(torch.tensor([2.0, 0.0]))
    state, semantics = random_semantics(), random_semantics()
    seen.apply_to(semantics, frame_with((3, 4)), "state")
    assert semantics[:, 3, 4] == pytest.approx(state[:, 3, 4] ** 2 / (state[:, 3, 4] ** 2).sum(), abs=1e-5)
    seen.apply_to(semantics, frame_with(), "state")
    assert (semantics[:, 5, 5] == state[:, 5, 5]).all()


@pytest.mark.parametrize(("given", "evidence"), [({}, "scan"), ({"evidence": "state"}, "state")])
def test_the_scan_decides_too_unless_the_state_alone_is_asked_for(latent, monkeypatch, given, evidence):
    used = []
    monkeypatch.setattr(SeenCells, "apply_to", lambda self, semantics, frame, evidence: used.append(evidence))
    source = Scene((stands, walks))
    tracker = DilatedConvGRUTracker(stream_of(source, latent), DilatedConvGRUTracker.Options(**given))
    tracker.reset(0)
    tracker.update(next(iter(source)))
    tracker.predict(1)
    assert used == [evidence]


def labelled(seen, number=400):
    """Cells of random scans with classes drawn from the scan classifier's own probabilities."""
    draw = np.random.default_rng(0)
    planes = torch.from_numpy((draw.random((number, SIZE, SIZE, 2)) < 0.5).astype(np.uint8))
    at, cells = torch.arange(number), torch.from_numpy(draw.integers(SIZE**2, size=number))
    unknown = LabelledCells(planes, at, cells, torch.zeros(number, dtype=torch.int64))
    with torch.no_grad():
        p = torch.softmax(logits_of(seen.classifier, unknown), dim=1).double().numpy()
    return replace(unknown, targets=torch.from_numpy(np.array([draw.choice(3, p=each / each.sum()) for each in p])))


def test_evidence_that_says_nothing_has_no_power(seen):
    with torch.no_grad():
        seen.classifier.layers[-1].weight.mul_(40)
    cells = labelled(seen)
    noise = torch.from_numpy(np.random.default_rng(1).normal(size=(400, 3))).float() * 3
    loss = seen.fit_powers(noise, cells)
    state, scan = seen.with_scan.tolist()
    assert state <= 0.1
    assert scan == pytest.approx(1.0, abs=0.21)
    assert loss["scan"] < loss["state"] - 0.1
    knows = torch.nn.functional.one_hot(cells.targets, 3).float() * 4
    with torch.no_grad():
        seen.classifier.layers[-1].weight.zero_()
        seen.classifier.layers[-1].bias.zero_()
    loss = seen.fit_powers(knows, cells)
    assert loss["scan"] == pytest.approx(loss["state"])
    assert seen.state_alone[1] == 0.0


def weights_with(seen, **changes):
    arrays = {PREFIX + name: value.numpy() for name, value in seen.state_dict().items()} | changes
    return Weights(card_of("dilated-convgru", GRID, 0.1, "toy", classes=CLASSES), arrays)


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("with_scan", lambda a: a + 9, "'seen_cells.with_scan' is not from 0 to 1.5"),
        ("state_alone", lambda a: a - 9, "'seen_cells.state_alone' is not from 0 to 1.5"),
        ("state_alone", lambda a: a * np.nan, "'seen_cells.state_alone' is not finite"),
        ("with_scan", lambda a: a[:1], r"'seen_cells.with_scan' is \(1,\), expected \(2,\)"),
        ("classifier.other", lambda a: np.zeros(2, np.float32), r"do not belong .*seen_cells.classifier.other"),
    ],
)
def test_damaged_arrays_are_refused_in_one_line(seen, name, change, message):
    state = {key: value.numpy() for key, value in seen.state_dict().items()}
    changed = {PREFIX + name: change(state.get(name))}
    with pytest.raises(WeightsError, match=message):
        seen_cells_of(weights_with(seen, **changed), STREAM)
    assert seen_cells_of(weights_with(seen), STREAM) is not None


def test_weights_without_a_classifier_of_scans_say_how_to_get_one(tmp_path):
    options = DilatedConvGRUTracker.Options(layers=1, channels=4)
    network = DilatedConvGRUTracker.build(SIZE, options, classes=0)
    card = weights_with(SeenCells(scan_classifier(32, 3))).card
    settings = options.model_dump(mode="json", include={"layers", "channels"})
    card = card.model_copy(update={"classes": (), "settings": settings})
    arrays = {name: value.detach().contiguous().numpy() for name, value in network.state_dict().items()}
    save_weights(tmp_path / "toy.toml", card, arrays)
    stream = StreamSpec(GRID, 0.1, "toy", (), tmp_path / "toy.toml")
    assert load_weights(stream, "dilated-convgru").card.classes == ()
    assert DilatedConvGRUTracker(stream, DilatedConvGRUTracker.Options()).classes == ()
    with pytest.raises(WeightsError, match="no classifier of scans for evidence=scan: train again with stage=classes"):
        DilatedConvGRUTracker(stream, DilatedConvGRUTracker.Options(evidence="scan"))

"""Classes of the cells that are seen now: what is remembered and what is seen are different evidence."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from gridtrack.common.errors import WeightsError  # noqa: E402
from gridtrack.common.geometry import SE2  # noqa: E402
from gridtrack.common.grid import GridFrame, GridSpec  # noqa: E402
from gridtrack.trackers.contract import StreamSpec  # noqa: E402
from gridtrack.trackers.recurrent.convgru_tracker import DilatedConvGRUTracker  # noqa: E402
from gridtrack.trackers.recurrent.seen_cells import PREFIX, SeenCells, seen_cells_of  # noqa: E402
from gridtrack.trackers.training.card import Card  # noqa: E402
from gridtrack.trackers.training.cell_classifier import planes_of, scan_classifier  # noqa: E402
from gridtrack.trackers.training.cell_training import LabelledCells, logits_of  # noqa: E402
from gridtrack.trackers.training.weights import Weights, load_weights, save_weights  # noqa: E402

SIZE, CLASSES = 12, ("pedestrian", "car", "static")
GRID = GridSpec(SIZE, 0.5)


def frame_with(*cells):
    occupied = np.zeros((SIZE, SIZE), bool)
    for cell in cells:
        occupied[cell] = True
    points = GRID.cell_centres(occupied)
    origin = np.zeros((1, 2), np.float32)
    return GridFrame(0, np.ones_like(occupied), occupied, SE2(), origin, points, np.zeros(len(points), np.uint8))


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


def labelled(seen, number=400):
    """Cells of random scans, whose classes are drawn from the scan classifier's own probabilities."""
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
    card = Card(
        tracker="dilated-convgru",
        site="toy",
        grid=str(GRID),
        period_s=0.1,
        seed=0,
        command="",
        train=(),
        classes=CLASSES,
    )
    return Weights(card, arrays)


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("with_scan", lambda a: a + 9, "'seen_cells.with_scan' is not from 0 to 1.5"),
        ("state_alone", lambda a: a - 9, "'seen_cells.state_alone' is not from 0 to 1.5"),
        ("state_alone", lambda a: a * np.nan, "'seen_cells.state_alone' is not finite"),
        ("with_scan", lambda a: a[:1], r"'seen_cells.with_scan' is \(1,\), expected \(2,\)"),
        ("classifier.other", lambda a: np.zeros(2, np.float32), r"unknown arrays .*seen_cells.classifier.other"),
    ],
)
def test_damaged_arrays_are_refused_in_one_line(seen, name, change, message):
    state = {key: value.numpy() for key, value in seen.state_dict().items()}
    changed = {PREFIX + name: change(state.get(name))}
    with pytest.raises(WeightsError, match=message) as raised:
        seen_cells_of(weights_with(seen, **changed), GRID)
    assert "\n" not in str(raised.value)
    assert seen_cells_of(weights_with(seen), GRID) is not None


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

"""Classes learned from few labels: from the shape in one scan, and from the motion in a latent state."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("lightning")

from gridtrack.common.config import validated  # noqa: E402
from gridtrack.common.errors import WeightsError  # noqa: E402
from gridtrack.common.geometry import SE2  # noqa: E402
from gridtrack.common.grid import GridFrame, GridSpec, LabelledFrame  # noqa: E402
from gridtrack.trackers.contract import FitTask, stream_of  # noqa: E402
from gridtrack.trackers.one_shot import OneShotTracker  # noqa: E402
from gridtrack.trackers.recurrent.convgru_tracker import DilatedConvGRUTracker  # noqa: E402
from gridtrack.trackers.recurrent.transfer import latent_cells  # noqa: E402
from gridtrack.trackers.training import cell_training  # noqa: E402
from gridtrack.trackers.training.cell_classifier import CellClassifier  # noqa: E402
from gridtrack.trackers.training.cell_training import CellCollector, LabelledCells, candidate_settings, train_classifier  # noqa: E402
from gridtrack.trackers.training.labelled_scans import (  # noqa: E402
    ClassifierSettings,
    class_indices,
    inverse_frequency,
)
from gridtrack.trackers.training.weights import load_weights, read_card, save_weights  # noqa: E402
from tests.trackers.scores import of_every_stratum  # noqa: E402

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
            points = self.grid.cell_centres(occupied)
            frame = GridFrame(
                t * 250_000_000, np.ones((SIZE, SIZE), bool), occupied, SE2(), np.zeros((1, 2), np.float32),
                points, np.zeros(len(points), np.uint8),
            )  # fmt: skip
            yield LabelledFrame(frame, cells, label_at.ravel()[cells])


def stands(t):
    return [(0, 4)]


def walks(t):
    return [(0, t)]


def lies(t):
    return [(0, t), (0, t + 1)]


def towers(t):
    return [(0, t), (1, t)]


def no_score(tracker, source, steps):
    return of_every_stratum(0.0, 0.0, steps)


def fit(tracker, folder, things, seed=3, train=None, **options):
    settings = validated(tracker.Options, {"labelled_scans": 150, **options}, "test")
    out, sources, validation = folder / "toy.toml", [train or Scene(things)], [Scene(things, 72, seed=1)]
    command = f"gridtrack train {options}"
    tracker.fit(FitTask(sources, validation, no_score, out, settings, folder / "log", seed, command))
    return out


NETWORK = {"channels": 8, "layers": 2, "updates": 1, "warm_up": 0, "validate_every": 1, "precision": "32-true"}
DECODER = {"class_layers": 2, "class_channels": 16}
CLASSIFIER = {"channels": 16, "learning_rate": 0.01, "weight_decay": 0.001, "updates": 200}


@pytest.fixture(scope="module", autouse=True)
def one_short_trial():
    """The search of the class decoder has one iteration instead of ten: the scene needs no search."""
    with pytest.MonkeyPatch.context() as patch:
        short = {"learning_rate": 0.01, "updates": 300, "batch": 64}
        patch.setattr(
            cell_training, "candidate_settings", lambda given, seed: [ClassifierSettings(**(short | dict(given)))]
        )
        yield


def accuracy(tracker, weights, things, from_frame=4):
    """Accuracy of the classes of occupied cells in a new scene, `from_frame` frames after each new pair of objects."""
    source = Scene(things, 96, seed=2)
    made = tracker(stream_of(source, weights), tracker.Options())
    made.reset(0)
    right = []
    for t, (frame, cells, labels) in enumerate(source.labelled()):
        made.update(frame)
        if t % ROUND >= from_frame:
            semantics = made.predict(1).semantics[0].reshape(len(made.classes), -1)
            most_probable = semantics[:, cells].argmax(axis=0)
            right += [made.classes[k] == source.classes[label] for k, label in zip(most_probable, labels, strict=True)]
    return np.mean(right)


@pytest.fixture(scope="module")
def latent(tmp_path_factory):
    """Weights of a ConvGRU after one update, with a class decoder trained after it."""
    return fit(DilatedConvGRUTracker, tmp_path_factory.mktemp("latent"), (stands, walks), **NETWORK, **DECODER)


def test_classes_that_differ_in_motion_are_separated_by_a_latent_state_and_not_by_one_scan(latent, tmp_path):
    assert accuracy(DilatedConvGRUTracker, latent, (stands, walks)) > 0.95
    one_shot = fit(OneShotTracker, tmp_path, (stands, walks), **CLASSIFIER)
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
    torch.testing.assert_close(ahead.planes[0], blind[-1][0].permute(1, 2, 0).half(), msg="frame 20 from frame 16")


def test_all_layers_of_the_state_can_be_decoded(tmp_path):
    path = fit(DilatedConvGRUTracker, tmp_path, (stands, walks), decoded_layers="all", **NETWORK, **DECODER)
    weights = load_weights(stream_of(Scene(()), path), "dilated-convgru")
    assert weights.arrays["decode_semantics.layers.0.weight"].shape[1] == NETWORK["layers"] * NETWORK["channels"]
    assert accuracy(DilatedConvGRUTracker, path, (stands, walks)) > 0.95
    other = DilatedConvGRUTracker.Options(decoded_layers="last")
    with pytest.raises(WeightsError, match="trained with decoded_layers=all, not last"):
        DilatedConvGRUTracker(stream_of(Scene(()), path), other)


def test_one_scan_separates_two_shapes(tmp_path):
    path = fit(OneShotTracker, tmp_path, (lies, towers), **CLASSIFIER)
    assert accuracy(OneShotTracker, path, (lies, towers), from_frame=0) > 0.95


def test_one_shot_forecasts_the_observed_frame_for_every_step(tmp_path):
    path = fit(OneShotTracker, tmp_path, (lies, towers), **{**CLASSIFIER, "updates": 1})
    source = Scene((lies, towers), 30)
    tracker = OneShotTracker(stream_of(source, path), OneShotTracker.Options())
    for frame in islice(source, 20):
        tracker.update(frame)
    forecast = tracker.predict(3)
    assert forecast.occupancy.shape == (4, SIZE, SIZE)
    assert forecast.semantics.shape == (4, 2, SIZE, SIZE)
    assert (forecast.occupancy == frame.occupied).all()
    assert (forecast.semantics == forecast.semantics[0]).all()


def test_adding_classes_does_not_change_the_occupancy_weights(latent, tmp_path):
    path = fit(DilatedConvGRUTracker, tmp_path, (stands, walks), stage="occupancy", **NETWORK)
    before = load_weights(stream_of(Scene(()), path), "dilated-convgru")
    assert before.card.classes == ()
    fit(DilatedConvGRUTracker, tmp_path, (stands, walks), stage="classes", **DECODER)
    after = load_weights(stream_of(Scene(()), path), "dilated-convgru")
    assert {name.partition(".")[0] for name in after.arrays.keys() - before.arrays.keys()} == {
        "decode_semantics",
        "seen_cells",
    }
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
    with pytest.raises(WeightsError, match="trained with channels=8, not 4"):
        fit(DilatedConvGRUTracker, latent.parent, (stands, walks), stage="classes", channels=4)


def test_classes_are_matched_by_name_and_weighted_by_inverse_frequency():
    labels = np.array([0, 1, 2, 255], np.uint8)
    assert class_indices(labels, ("a", "b", "c"), ("c", "a")).tolist() == [1, -1, 0, -1]
    assert inverse_frequency(np.array([0, 0, 0, 1]), 2).tolist() == pytest.approx([4 / 6, 2.0])


def test_a_decoder_of_one_layer_replaces_another_decoder(latent, tmp_path):
    before = load_weights(stream_of(Scene(()), latent), "dilated-convgru")
    path = tmp_path / "toy.toml"
    save_weights(path, before.card, before.arrays)
    fit(DilatedConvGRUTracker, tmp_path, (stands, walks), stage="classes", class_layers=1, class_channels=8)
    after = load_weights(stream_of(Scene(()), path), "dilated-convgru")
    decoder = {name: array.shape for name, array in after.arrays.items() if name.startswith("decode_semantics")}
    assert decoder == {"decode_semantics.layers.0.weight": (2, 8, 3, 3), "decode_semantics.layers.0.bias": (2,)}
    assert after.card.settings["class_layers"] == 1
    assert accuracy(DilatedConvGRUTracker, path, (stands, walks)) > 0.9


@pytest.mark.parametrize("hidden", [(), (4,), (4, 5)])
def test_the_classifier_gives_the_same_logits_on_patches_and_on_the_grid(hidden):
    torch.manual_seed(0)
    classifier, planes = CellClassifier(2, hidden, 3), torch.rand(1, 2, 20, 20)
    everywhere = torch.arange(400)
    cells = LabelledCells(planes.permute(0, 2, 3, 1), torch.zeros_like(everywhere), everywhere, everywhere)
    patches = cells.patches(everywhere, classifier.reach)
    assert patches.shape[-1] == 2 ** (len(hidden) + 2) - 1
    torch.testing.assert_close(classifier.of_patches(patches), classifier(planes)[0].flatten(1).T)


def test_one_layer_learns_the_class_weighted_logistic_regression_of_scikit_learn():
    linear_model = pytest.importorskip("sklearn.linear_model")
    draw = np.random.default_rng(0)
    targets = np.repeat([0, 1, 2], [360, 180, 60])
    features = draw.normal(size=(600, 5)) + draw.normal(size=(3, 5))[targets]
    planes = torch.zeros(600, 3, 3, 5)
    planes[:, 1, 1] = torch.from_numpy(features).float()
    learned = LabelledCells(planes, torch.arange(600), torch.full((600,), 4), torch.from_numpy(targets))
    alike = torch.arange(600).repeat_interleave(torch.tensor([1, 2, 6])[learned.targets])
    balanced = LabelledCells(planes, learned.at[alike], learned.cells[alike], learned.targets[alike])
    torch.manual_seed(0)
    settings = ClassifierSettings(learning_rate=0.05, weight_decay=0.0, batch=600, updates=1000)
    classifier = train_classifier(CellClassifier(5, (), 3), settings, learned, [balanced]).classifier
    ours = torch.softmax(classifier.of_patches(learned.patches(torch.arange(600), 1)), dim=1).detach().numpy()
    oracle = linear_model.LogisticRegression(C=np.inf, class_weight="balanced", tol=1e-8, max_iter=1000)
    expected = oracle.fit(features, targets).predict_proba(features)
    assert np.abs(ours - expected).mean() < 0.01
    unweighted = linear_model.LogisticRegression(C=np.inf, tol=1e-8, max_iter=1000).fit(features, targets)
    assert np.abs(ours - unweighted.predict_proba(features)).mean() > 0.03


def test_labelled_cells_are_stored_with_the_planes_of_their_frame():
    names = ("a", "b", "c")
    collector = CellCollector(("c", "a"))
    for t, (cells, labels) in enumerate((([5, 7], [0, 1]), ([2], [2]))):
        item = LabelledFrame(None, np.array(cells), np.array(labels, np.uint8))
        collector.add(torch.full((2, 3, 3), float(t)), item, names)
    found = collector.cells()
    assert found.planes.shape == (2, 3, 3, 2)
    assert (found.at.tolist(), found.cells.tolist(), found.targets.tolist()) == ([0, 1], [5, 2], [1, 0])
    assert found.patches(torch.tensor([1]), 1)[0, 0].tolist() == [[0, 0, 0], [1, 1, 0], [1, 1, 0]]


def test_labelled_cells_of_unlike_grids_keep_their_places():
    collector = CellCollector(("a",))
    for size, cell in ((2, 3), (4, 9)):
        planes = torch.zeros(1, size, size)
        planes.view(-1)[cell] = 1.0
        collector.add(planes, LabelledFrame(None, np.array([cell]), np.zeros(1, np.uint8)), ("a",))
    found = collector.cells()
    assert found.planes.shape == (2, 4, 4, 1)
    assert found.patches(torch.arange(2), 1)[:, 0, 1, 1].tolist() == [1.0, 1.0]


def test_the_search_tries_equal_settings_for_equal_seeds_and_keeps_given_ones():
    tried = list(candidate_settings({"channels": 8}, 3))
    assert tried == list(candidate_settings({"channels": 8}, 3))
    assert (len(tried), {settings.channels for settings in tried}) == (10, {8})
    assert len({settings.learning_rate for settings in tried}) == 10
    assert {settings.class_weights for settings in tried} == {"inverse-frequency", "none"}
    low, high = np.log(cell_training.WEIGHT_DECAYS)
    parts = [int(9 * (np.log(settings.weight_decay) - low) / (high - low)) for settings in tried[1:]]
    assert sorted(parts) == list(range(9)), "a Latin hypercube: one draw in each ninth of the range"
    given = {"channels": 8, "learning_rate": 0.1, "weight_decay": 0.0, "class_weights": "none"}
    assert list(candidate_settings(given, 3)) == [ClassifierSettings(**given)]

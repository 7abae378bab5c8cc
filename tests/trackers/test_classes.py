"""What things are, learned from a few labels: from one scan by its shape, from a latent state also by its motion."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("lightning")

from gridtrack.common.config import validated  # noqa: E402
from gridtrack.common.errors import ConfigurationError, WeightsError  # noqa: E402
from gridtrack.common.geometry import SE2  # noqa: E402
from gridtrack.common.grid import GridFrame, GridSpec, LabelledFrame  # noqa: E402
from gridtrack.trackers.contract import FitOutput, StretchScore, stream_of  # noqa: E402
from gridtrack.trackers.labelled import class_indices, draw_labelled, inverse_frequency, possible_starts  # noqa: E402
from gridtrack.trackers.one_shot import OneShotTracker  # noqa: E402
from gridtrack.trackers.one_shot.network import OneShotNetwork, patches_around  # noqa: E402
from gridtrack.trackers.recurrent import DilatedConvGRUTracker  # noqa: E402
from gridtrack.trackers.recurrent.transfer import Samples, fit_decoder, latent_patches  # noqa: E402
from gridtrack.trackers.weights import load_weights, read_card, save_weights  # noqa: E402

SIZE, ROUND = 16, 12


class Scene:
    """Every 12 frames two new things of one row each, somewhere: class 0, and class 1."""

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
    flat = np.zeros(steps + 1)
    return StretchScore({"moving": flat, "visible": flat}, {})


def fit(tracker, folder, things, seed=3, train=None, **options):
    settings = validated(tracker.Options, {"labelled_scans": 150, **options}, "test")
    out = FitOutput(folder / "toy.toml", f"gridtrack train {options}", seed, folder / "log", lambda line: None)
    tracker.fit([train or Scene(things)], [Scene(things, 72, seed=1)], no_score, out, settings)
    return out.path


NETWORK = {"channels": 8, "layers": 2, "updates": 1, "warm_up": 0, "validate_every": 1, "precision": "32-true"}
CLASSIFIER = {"channels": 16, "learning_rate": 0.01, "weight_decay": 0.001, "updates": 200}


def accuracy(tracker, weights, things, from_frame=4):
    """Of the classes of what is occupied, in a scene that it has not seen, some frames after each round's begin."""
    source = Scene(things, 96, seed=2)
    made = tracker(stream_of(source, weights), tracker.Options())
    made.reset(0)
    right = []
    for t, (frame, cells, labels) in enumerate(source.labelled()):
        made.update(frame)
        if t % ROUND >= from_frame:
            semantics = made.predict(1).semantics[0].reshape(len(made.classes), -1)
            said = semantics[:, cells].argmax(axis=0)
            right += [made.classes[k] == source.classes[label] for k, label in zip(said, labels, strict=True)]
    return np.mean(right)


@pytest.fixture(scope="module")
def latent(tmp_path_factory):
    """Weights of a ConvGRU that has hardly been trained, its classes learned after its occupancy."""
    return fit(DilatedConvGRUTracker, tmp_path_factory.mktemp("latent"), (stands, walks), **NETWORK)


def test_a_latent_state_tells_apart_what_only_motion_does_and_one_scan_cannot(latent, tmp_path):
    assert accuracy(DilatedConvGRUTracker, latent, (stands, walks)) > 0.95
    one_shot = fit(OneShotTracker, tmp_path, (stands, walks), **CLASSIFIER)
    assert accuracy(OneShotTracker, one_shot, (stands, walks)) < 0.75


def test_one_scan_tells_apart_two_shapes(tmp_path):
    path = fit(OneShotTracker, tmp_path, (lies, towers), **CLASSIFIER)
    assert accuracy(OneShotTracker, path, (lies, towers), from_frame=0) > 0.95


def test_one_shot_forecasts_what_is_visible_now_for_every_step(tmp_path):
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


def test_the_occupancy_weights_stay_as_they_are_bit_for_bit(latent, tmp_path):
    path = fit(DilatedConvGRUTracker, tmp_path, (stands, walks), stage="occupancy", **NETWORK)
    before = load_weights(stream_of(Scene(()), path), "dilated-convgru")
    assert before.card.classes == ()
    fit(DilatedConvGRUTracker, tmp_path, (stands, walks), stage="classes")
    after = load_weights(stream_of(Scene(()), path), "dilated-convgru")
    assert after.arrays.keys() - before.arrays.keys() == {"decode_semantics.weight", "decode_semantics.bias"}
    assert all(after.arrays[name].tobytes() == array.tobytes() for name, array in before.arrays.items())
    assert after.card.command == before.card.command
    assert after.card.results["classes"]["command"] == "gridtrack train {'stage': 'classes'}"
    at_once = load_weights(stream_of(Scene(()), latent), "dilated-convgru")
    assert {k: v.tobytes() for k, v in at_once.arrays.items()} == {k: v.tobytes() for k, v in after.arrays.items()}


def test_the_card_names_the_classes_and_a_class_nobody_labelled_is_none_of_them(latent):
    card = read_card(latent)
    assert card.classes == ("stander", "walker")
    assert card.settings["labelled_scans"] == 150
    other = replace(stream_of(Scene(()), latent), classes=("cow", "walker", "stander"))
    assert DilatedConvGRUTracker(other, DilatedConvGRUTracker.Options()).classes == ("stander", "walker")


@pytest.mark.parametrize(
    ("classes", "message"),
    [
        ((), "arrays that its card does not account for: .*decode_semantics"),
        (("stander", "stander"), "a class is named twice"),
        (("stander", "walker", "horse"), r"decode_semantics.weight' is \(2, 8, 3, 3\), expected \(3, 8, 3, 3\)"),
    ],
)
def test_a_card_whose_classes_are_not_those_of_the_decoder_is_refused(latent, tmp_path, classes, message):
    weights = load_weights(stream_of(Scene(()), latent), "dilated-convgru")
    path = tmp_path / "toy.toml"
    save_weights(path, weights.card.model_copy(update={"classes": classes}), weights.arrays)
    with pytest.raises(WeightsError, match=message):
        DilatedConvGRUTracker(stream_of(Scene(()), path), DilatedConvGRUTracker.Options())


def test_classes_without_weights_to_add_them_to_or_for_other_ones_are_refused(latent, tmp_path):
    with pytest.raises(WeightsError, match=r"toy\.toml: no weights to add classes to"):
        fit(DilatedConvGRUTracker, tmp_path, (stands, walks), stage="classes")
    with pytest.raises(WeightsError, match="trained with channels=8, not 4"):
        fit(DilatedConvGRUTracker, latent.parent, (stands, walks), stage="classes", channels=4)


def test_labelled_scans_lie_in_a_row_where_all_are_labelled_and_the_same_seed_draws_the_same():
    source = Scene((stands, walks), 240, unlabelled=100)
    stretches = [draw_labelled([source], 50, seed) for seed in range(8)]
    for stretch in stretches:
        assert 100 <= stretch.first <= 190
        assert [item.frame.stamp_ns // 250_000_000 for item in stretch.frames] == list(
            range(stretch.first - 40, stretch.first + 50)
        )
        assert [item.labels.size > 0 for item in stretch.frames] == [False] * 40 + [True] * 50
    assert len({stretch.first for stretch in stretches}) > 4
    assert draw_labelled([source], 50, 5).first == stretches[5].first
    with pytest.raises(ConfigurationError, match="toy-0: nowhere 141 labelled scans in a row"):
        draw_labelled([source], 141, 0)


def test_every_possible_start_is_found_in_every_source():
    labelled = np.array([1, 1, 0, 1, 1, 1], bool)
    assert possible_starts(labelled, 2).tolist() == [0, 3, 4]
    assert possible_starts(labelled, 7).tolist() == []
    few, many = Scene((stands, walks), 51, seed=0), Scene((stands, walks), 150, seed=1)
    names = [draw_labelled([few, many], 50, seed).name.partition(",")[0] for seed in range(60)]
    assert set(names) == {"toy-0", "toy-1"}
    assert names.count("toy-1") > 50


def test_classes_are_matched_by_name_and_weighted_by_inverse_frequency():
    labels = np.array([0, 1, 2, 255], np.uint8)
    assert class_indices(labels, ("a", "b", "c"), ("c", "a")).tolist() == [1, -1, 0, -1]
    assert inverse_frequency(np.array([0, 0, 0, 1]), 2).tolist() == pytest.approx([4 / 6, 2.0])


def test_a_latent_patch_times_the_decoder_is_its_convolution():
    torch.manual_seed(0)
    features, decoder = torch.randn(1, 3, 7, 7), torch.nn.Conv2d(3, 4, 3, padding=1)
    everywhere = latent_patches(features, np.arange(49)) @ decoder.weight.flatten(1).T + decoder.bias
    torch.testing.assert_close(everywhere.T.reshape(1, 4, 7, 7), decoder(features))


def test_the_decoder_is_the_weighted_logistic_regression_of_scikit_learn():
    linear_model = pytest.importorskip("sklearn.linear_model")
    draw = np.random.default_rng(0)
    targets = draw.choice(3, 600, p=[0.6, 0.3, 0.1])
    patches = (draw.normal(size=(600, 5)) + draw.normal(size=(3, 5))[targets]).astype(np.float32)
    learned = Samples(torch.from_numpy(patches), torch.from_numpy(targets))
    decoder = fit_decoder(learned, learned, 3, lambda line: None)
    oracle = linear_model.LogisticRegression(C=1 / (decoder.penalty * 600), class_weight="balanced", tol=1e-8)
    oracle.fit(patches, targets)
    ours = torch.softmax(learned.patches @ decoder.weight.T + decoder.bias, dim=1).numpy()
    np.testing.assert_allclose(ours, oracle.predict_proba(patches), atol=2e-3)


def test_one_shot_classifies_a_cell_from_its_patch_as_from_the_whole_grid():
    torch.manual_seed(0)
    network, planes = OneShotNetwork(6, 3), (torch.rand(2, 20, 20) < 0.3).float()
    dense = network(planes[None])[0].flatten(1).T
    torch.testing.assert_close(network.of_patches(patches_around(planes, np.arange(400))), dense)

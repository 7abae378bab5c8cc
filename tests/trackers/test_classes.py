"""Classes of cells learned from few labels: the classifier, its training and search, and the tracker `one-shot`."""

from __future__ import annotations

from itertools import islice

import numpy as np
import pytest
import torch

from gridtrack.common.grid import LabelledFrame
from gridtrack.trackers.contract import stream_of
from gridtrack.trackers.one_shot import OneShotTracker
from gridtrack.trackers.training import cell_training
from gridtrack.trackers.training.cell_classifier import CellClassifier
from gridtrack.trackers.training.cell_training import CellCollector, LabelledCells, candidate_settings, train_classifier
from gridtrack.trackers.training.labelled_scans import ClassifierSettings, class_indices, inverse_frequency
from tests.trackers.labelled_scenes import SIZE, Scene, accuracy, fit, lies, towers

CLASSIFIER = {"channels": 16, "learning_rate": 0.01, "weight_decay": 0.001, "updates": 200}


@pytest.fixture(scope="module", autouse=True)
def one_short_trial():
    """The search has one iteration instead of ten: the scenes need no search."""
    with pytest.MonkeyPatch.context() as patch:
        short = {"learning_rate": 0.01, "updates": 300, "batch": 64}
        patch.setattr(
            cell_training, "candidate_settings", lambda given, seed: [ClassifierSettings(**(short | dict(given)))]
        )
        yield


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


def test_classes_are_matched_by_name_and_weighted_by_inverse_frequency():
    labels = np.array([0, 1, 2, 255], np.uint8)
    assert class_indices(labels, ("a", "b", "c"), ("c", "a")).tolist() == [1, -1, 0, -1]
    assert inverse_frequency(np.array([0, 0, 0, 1]), 2).tolist() == pytest.approx([4 / 6, 2.0])


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

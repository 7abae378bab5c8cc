"""Classes of the model-free trackers: training, weights and their validation."""

from __future__ import annotations

import numpy as np
import pytest

from gridtrack.common.errors import ConfigurationError, WeightsError
from gridtrack.common.grid import LabelledFrame
from gridtrack.trackers.contract import FitTask, stream_of
from gridtrack.trackers.model_free.classes import ClassModel
from gridtrack.trackers.model_free.factor_graph import FactorGraphTracker
from gridtrack.trackers.model_free.kalman import KalmanTracker
from gridtrack.trackers.model_free.settings import ModelFreeSettings
from gridtrack.trackers.model_free.training import count_labelled_cells
from gridtrack.trackers.training import searched_fit
from gridtrack.trackers.training.labelled_scans import LabelledScans
from gridtrack.trackers.training.weights import load_weights, read_card, save_weights
from tests.trackers.scores import no_score

from scenes.street import GRID, Street, frame_of


def fit(folder, tracker=KalmanTracker, street=None, **options):
    street = street or Street()
    out, command = folder / "street.toml", f"gridtrack train {options}"
    settings = ModelFreeSettings(**({"labelled_scans": 80, "link_m": 0.5} | options))
    tracker.fit(FitTask([street], [street], no_score, out, settings, folder / "log", 3, command))
    return out


@pytest.fixture(scope="module", autouse=True)
def one_trial():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(searched_fit, "SEARCH_ITERATIONS", 1)
        yield


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return fit(tmp_path_factory.mktemp("street"))


def test_trained_classes_are_right_for_cells_and_objects_at_all_steps(path):
    tracker, source = KalmanTracker(stream_of(Street(), path), ModelFreeSettings()), Street(34)
    assert tracker.classes == ("pedestrian", "car")
    for item in source.labelled():
        tracker.update(item.frame)
    forecast = tracker.predict(4)
    assert forecast.semantics.shape == (5, 2, *GRID.shape)
    assert forecast.semantics.dtype == np.float32
    assert forecast.semantics.min() >= 0.0
    assert forecast.semantics.sum(axis=1) == pytest.approx(np.ones((5, *GRID.shape)), abs=1e-5)
    for step, then in enumerate(list(Street(38).labelled())[33:]):
        said = forecast.semantics[step].reshape(2, -1)[:, then.cells].argmax(axis=0)
        assert (said == then.labels).mean() > 0.9, step
    assert {(one.label, one.box[0] > 6.0) for one in forecast.objects} == {("pedestrian", False), ("car", True)}
    before = forecast.semantics.copy()
    assert (tracker.predict(4).semantics == before).all()


def test_the_card_describes_the_training_of_classes(path):
    card = read_card(path)
    assert card.classes == ("pedestrian", "car")
    assert card.settings["labelled_scans"] == 80
    results = card.results["classes"]
    assert results["labelled"].startswith("street.mcap, 80 scans from")
    assert results["tracks"]["pedestrian"] >= 2
    assert results["validation_log_loss"] < 0.2


def test_adding_classes_leaves_other_arrays_unchanged_and_is_reproducible(path, tmp_path):
    other = fit(tmp_path, stage="occupancy")
    before = load_weights(stream_of(Street(), other), "kalman")
    assert before.card.classes == ()
    fit(tmp_path, stage="classes")
    after = load_weights(stream_of(Street(), other), "kalman")
    assert all(after.arrays[name].tobytes() == array.tobytes() for name, array in before.arrays.items())
    assert after.card.command == before.card.command
    assert "'stage': 'classes'" in after.card.results["classes"]["command"]
    at_once = load_weights(stream_of(Street(), path), "kalman")
    assert {k: v.tobytes() for k, v in at_once.arrays.items()} == {k: v.tobytes() for k, v in after.arrays.items()}


def test_new_classes_replace_earlier_ones_even_damaged_ones(path, tmp_path):
    weights = load_weights(stream_of(Street(), path), "kalman")
    other = tmp_path / "street.toml"
    save_weights(other, weights.card, weights.arrays | {"class_means": np.zeros((2, 1, 99)), "class_old": np.zeros(3)})
    fit(tmp_path, stage="classes")
    again = load_weights(stream_of(Street(), other), "kalman")
    assert {k: v.tobytes() for k, v in weights.arrays.items()} == {k: v.tobytes() for k, v in again.arrays.items()}


def test_a_recording_without_labels_is_trained_without_classes_and_its_card_states_it(tmp_path):
    path = fit(tmp_path, FactorGraphTracker, Street(classes=()))
    card = read_card(path)
    assert card.classes == ()
    assert card.results["classes"] == "none: street.mcap has no labels"
    tracker = FactorGraphTracker(stream_of(Street(), path), ModelFreeSettings())
    tracker.update(next(iter(Street())))
    forecast = tracker.predict(2)
    assert forecast.semantics is None
    assert {one.label for one in forecast.objects} <= {""}
    with pytest.raises(ConfigurationError, match=r"street\.mcap: no labelled scans"):
        fit(tmp_path, FactorGraphTracker, Street(classes=()), stage="classes")


def test_too_few_labels_and_missing_weights_are_refused_before_the_search(tmp_path):
    with pytest.raises(ConfigurationError, match="120 labelled scans, not 121"):
        fit(tmp_path, labelled_scans=121)
    assert not list(tmp_path.iterdir())
    with pytest.raises(WeightsError, match=r"street\.toml: no weights to add classes to"):
        fit(tmp_path, stage="classes")


def spoilt(name, change):
    def of(arrays):
        return arrays | {f"class_{name}": change(arrays[f"class_{name}"])}

    return of


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (spoilt("means", lambda a: a * np.nan), "'class_means' is not finite"),
        (spoilt("means", lambda a: a + 1e30), "'class_means' is not finite or beyond 1e\\+09"),
        (spoilt("means", lambda a: a[..., :3]), r"'class_means' is \(2, \d+, 3\), expected"),
        (spoilt("cell_prior", lambda a: a[:, :9]), r"'class_cell_prior' is \(2, 9, 60\), expected"),
        (spoilt("cell_prior", lambda a: -a), "'class_cell_prior' does not hold probabilities"),
        (spoilt("frequency", lambda a: np.array([1.0, 0.0], np.float32)), "'class_frequency' rules a class out"),
        (spoilt("mixture_weights", lambda a: a * 2), "'class_mixture_weights' does not hold probabilities"),
        (
            spoilt("mixture_weights", lambda a: np.zeros((2, 10**4), np.float32)),
            "10000 Gaussians of a class, expected 1 to 64",
        ),
        (spoilt("mixture_weights", lambda a: a[0]), r"'class_mixture_weights' is \(\d+,\), expected"),
        (spoilt("whitening", lambda a: a * 0), "'class_whitening' is singular"),
        (spoilt("powers", lambda a: a + 1e6), "'class_powers' are not from 0 to 10"),
        (lambda arrays: {k: v for k, v in arrays.items() if k != "class_powers"}, "'class_powers' is missing"),
    ],
)
def test_hostile_weights_give_one_clear_line(path, tmp_path, change, message):
    weights = load_weights(stream_of(Street(), path), "kalman")
    spoiled = tmp_path / "street.toml"
    save_weights(spoiled, weights.card, change(weights.arrays))
    with pytest.raises(WeightsError, match=message):
        KalmanTracker(stream_of(Street(), spoiled), ModelFreeSettings())


def test_only_labelled_cells_of_the_trained_classes_are_counted():
    class Labelled(Street):
        def labelled(self):
            for labels in ([0, 2], [1, 1], [0, 0]):
                yield LabelledFrame(frame_of([]), np.array([3, 3600 - 1]), np.array(labels, np.uint8))

    labelled = LabelledScans((Labelled(),), (np.array([0, 2]),), ("horse", "pedestrian"))
    count = count_labelled_cells(labelled, ("horse", "pedestrian"))
    assert count.sum() == 4.0
    assert (count[1, 0, 3], count[0, 59, 59], count[1, 59, 59]) == (2.0, 1.0, 1.0)
    assert ClassModel._fields == ("mixture_weights", "means", "whitening", "frequency", "powers", "cell_prior")

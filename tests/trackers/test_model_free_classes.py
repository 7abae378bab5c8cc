"""Classes of the model-free trackers: what tells a car from a pedestrian, the place's own, and both in a forecast."""

from __future__ import annotations

import math
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("filterpy")
pytest.importorskip("sklearn")
from scipy.stats import multivariate_normal

from gridtrack.common.errors import ConfigurationError, WeightsError
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec, LabelledFrame
from gridtrack.trackers.contract import FitOutput, StretchScore, stream_of
from gridtrack.trackers.labelled import LabelledStretch
from gridtrack.trackers.model_free import FactorGraphTracker, KalmanTracker, tuning
from gridtrack.trackers.model_free.class_training import Tracked, count_cells, fit_mixtures, log_loss, place_classes
from gridtrack.trackers.model_free.classes import (
    FEATURES,
    ClassFilter,
    ClassModel,
    attribute,
    features_of,
    normalise,
    place_weighted,
)
from gridtrack.trackers.model_free.rasterise import draw_track
from gridtrack.trackers.model_free.settings import ModelFreeSettings
from gridtrack.trackers.weights import load_weights, read_card, save_weights

GRID, PERIOD_S = GridSpec(60, 0.2, (0.0, -6.0)), 0.125
PEDESTRIAN, CAR = 0, 1


def frame_of(shapes, step=0, grid=GRID):
    """All visible; `shapes` (N, 2) metres are occupied. The laser stands at the origin."""
    occupied = np.zeros(grid.shape, bool)
    cells, inside = grid.cells_of(np.concatenate([np.empty((0, 2)), *shapes]))
    occupied[tuple(cells[inside].T)] = True
    points = grid.cell_centres(occupied)
    laser, owner = np.zeros((1, 2), np.float32), np.zeros(len(points), np.uint8)
    return GridFrame(step * 125_000_000, np.ones(grid.shape, bool), occupied, SE2(), laser, points, owner)


def box(length, width, at, heading=0.0):
    """The side and the front of a box whose centre is `at` a place, (N, 2) metres."""
    along, across = np.arange(-length / 2, length / 2, 0.1), np.arange(-width / 2, width / 2, 0.1)
    side = np.stack([along, np.full_like(along, -width / 2)], 1)
    front = np.stack([np.full_like(across, length / 2), across], 1)
    cosine, sine = math.cos(heading), math.sin(heading)
    return np.concatenate([side, front]) @ np.array([[cosine, sine], [-sine, cosine]]) + at


def legs(at, apart=0.3):
    return np.array([(0.0, 0.0), (0.1, 0.0), (0.0, apart), (0.1, apart)]) + at


def track_of(points, velocity, identity=0, unseen=0):
    """As much of a track as its class is read from."""
    mean = np.array([*points.mean(axis=0), 0.0, *velocity, 0.0])
    return SimpleNamespace(
        identity=identity, returns=points, estimator=SimpleNamespace(mean=mean), unseen=unseen, existence=1.0
    )


def some_people_and_cars(seed=0, count=80):
    """Tracked: each track one frame, cars as long as cars, people as people are, where and as fast as they may be."""
    draw, rows, cells = np.random.default_rng(seed), [], []
    for number in range(2 * count):
        kind, heading, at = number % 2, draw.uniform(0, 2 * math.pi), draw.uniform((3.0, -4.0), (10.0, 4.0))
        body = box(draw.normal(4.3, 0.3), 1.8, at, heading) if kind == CAR else legs(at, draw.uniform(0.1, 0.5))
        speed = abs(draw.normal(7.0, 3.0) if kind == CAR else draw.normal(1.2, 0.4))
        velocity = speed * np.array([math.cos(heading), math.sin(heading)])
        rows.append(features_of([track_of(body, velocity)], frame_of([]))[0])
        cells.append([len(body), 0] if kind == PEDESTRIAN else [0, len(body)])
    return Tracked(np.array(rows), np.arange(2 * count), np.array(cells), [np.array([0])] * 2 * count)


def anywhere(kinds=2, grid=GRID):
    return np.full((kinds, *grid.shape), 1.0 / kinds)


@pytest.fixture(scope="module")
def model():
    return fit_mixtures(some_people_and_cars(), anywhere(), components=2, seed=0)


# What a track looks like


def test_a_box_of_car_size_at_8_m_per_s_is_a_car_and_two_legs_at_walking_speed_a_pedestrian(model):
    car = track_of(box(4.4, 1.8, (6.0, 1.0), 0.3), (8 * math.cos(0.3), 8 * math.sin(0.3)), identity=7)
    walker = track_of(legs((5.0, -2.0)), (0.0, 1.2), identity=9)
    classes = ClassFilter(model, GRID)
    classes.observe([car, walker], frame_of([]))
    found = classes.posteriors([car, walker])
    assert found.dtype == np.float32
    assert found.sum(axis=1) == pytest.approx([1.0, 1.0])
    assert found[0, CAR] > 0.99
    assert found[1, PEDESTRIAN] > 0.99


def test_features_are_extents_speed_and_range():
    track = track_of(np.array([(3.0, 4.0), (5.0, 4.0), (3.0, 4.5), (5.0, 4.5)]), (0.0, 2.0))
    other = track_of(np.array([(4.0, 5.0), (9.0, 5.0)]), (1.0, 0.0))
    found = features_of([track, other], frame_of([]))
    assert found[1] == pytest.approx(np.log([5.2, 5.2, 0.2, 1.3, 1.0 + math.hypot(6.5, 5.0)]))
    expected = [2.2, 0.7, 2.2, 2.3, 1.0 + math.hypot(4.0, 4.25)]
    assert len(FEATURES) == found.shape[1]
    assert found[0] == pytest.approx(np.log(expected))


def test_extents_do_not_depend_on_how_the_body_is_turned():
    found = [
        features_of([track_of(box(4.0, 1.6, (6.0, 0.0), turn), (math.cos(turn), math.sin(turn)))], frame_of([]))[0, :3]
        for turn in (0.0, 1.0, 2.5)
    ]
    assert found[1] == pytest.approx(found[0])
    assert found[2] == pytest.approx(found[0])


def test_densities_are_those_of_scipys_gaussians(model):
    features = some_people_and_cars(seed=1).features
    expected = np.zeros((len(features), 2))
    for k in range(2):
        factor = np.linalg.inv(model.whitening[k])
        for share, mean in zip(model.shares[k], model.means[k], strict=True):
            expected[:, k] += share * multivariate_normal(mean, factor.T @ factor).pdf(features)
    assert model.log_densities(features) == pytest.approx(np.log(expected))


def test_a_track_keeps_its_class_while_it_is_hidden_and_counts_every_frame_in_which_it_was_seen(model):
    walker, crowd = track_of(legs((5.0, 0.0)), (0.0, 1.2)), track_of(box(1.4, 0.6, (5.0, 0.0)), (0.0, 1.2))
    classes = ClassFilter(model, GRID)
    densities = [model.log_densities(features_of([each], frame_of([])))[0] for each in (walker, crowd)]
    for each in (walker, crowd, walker):
        classes.observe([each], frame_of([]))
    before = classes.posteriors([walker])
    place = np.log([[0.5, 0.5]])
    assert before == pytest.approx(model.posteriors((2 * densities[0] + densities[1])[None] / 3, place), abs=1e-6)
    walker.unseen = 5
    classes.observe([walker], frame_of([]))
    assert (classes.posteriors([walker]) == before).all()
    classes.observe([], frame_of([]))
    with pytest.raises(KeyError):
        classes.posteriors([walker])


def test_what_looks_alike_is_what_the_place_says_as_far_as_its_power_goes(model):
    place = anywhere()
    place[:, :, :30], place[:, :, 30:] = [[[0.9]], [[0.1]]], [[[0.2]], [[0.8]]]
    left, right = track_of(legs((2.0, 0.0)), (0.0, 1.0)), track_of(legs((10.0, 0.0)), (0.0, 1.0))
    told = model._replace(powers=np.array([0.0, 1.0]), place=place)
    log_place = told.log_place([left, right], GRID)
    assert told.posteriors(np.zeros((2, 2)), log_place) == pytest.approx(np.array([[0.9, 0.1], [0.2, 0.8]]))
    untold = told._replace(powers=np.zeros(2))
    assert untold.posteriors(np.zeros((2, 2)), log_place) == pytest.approx(np.tile(model.frequency, (2, 1)))


def test_probabilities_hold_what_they_promise_on_tracks_not_learned_from(model):
    fresh = some_people_and_cars(seed=2, count=400)
    found = model.posteriors(model.log_densities(fresh.features), np.log(np.full((800, 2), 0.5)))
    assert log_loss(found, fresh.cells) < 0.1
    assert log_loss(found[:, ::-1], fresh.cells) > 1.0


def test_a_class_that_no_track_has_is_as_all_tracks_are():
    learned = some_people_and_cars()
    third = learned._replace(cells=np.pad(learned.cells, ((0, 0), (0, 1))))
    model = fit_mixtures(third, anywhere(3), components=4, seed=0)
    assert np.isfinite(model.log_densities(learned.features)).all()
    assert 0.0 < model.frequency[2] < 0.01


def test_a_mean_over_a_life_ends_with_the_track():
    tracked = Tracked(np.zeros((5, 5)), np.array([0, 0, 1, 1, 1]), np.zeros((5, 2), np.int64), [])
    values = np.array([[1.0], [3.0], [10.0], [20.0], [60.0]])
    assert tracked.mean_over_life(values).ravel().tolist() == [1.0, 2.0, 10.0, 15.0, 30.0]


# The place


def test_a_cells_own_returns_go_before_those_beside_it_and_these_before_the_rest_of_the_place():
    count = np.zeros((2, 80, 80))
    count[0, 5:8, 5:8], count[1, 5, 6] = 30.0, 60.0
    count[1, 30:34, 30:34] = 50.0
    place = place_classes(count, 0.2)
    assert place.sum(axis=0) == pytest.approx(np.ones((80, 80)))
    assert place.min() > 0.0
    assert place[1, 5, 6] == pytest.approx(2 / 3, abs=0.02)
    assert place[0, 6, 6] > 0.98
    assert place[0, 9, 9] > 0.7
    assert place[1, 36, 36] > 0.95
    assert place[1, 5, 78] == pytest.approx(860 / (860 + 270), abs=0.02)


# What a forecast says


def test_semantics_are_shared_out_by_what_background_and_tracks_show():
    occupancy = np.full((1, 9, 9), 0.2, np.float32)
    place = np.zeros((2, 9, 9), np.float32)
    place[PEDESTRIAN] = 1.0
    semantics = place_weighted(occupancy, place)
    body = np.zeros((1, 2)), np.ones(1), np.array([[[4.5, 4.5, 0.0]]]), np.zeros((1, 1, 2, 2)), np.ones((1, 1))
    still, classes = np.zeros((0, 1), np.float32), np.array([0.25, 0.75], np.float32)
    draw_track(occupancy, *body, np.empty((0, 2)), 0.3, still, np.array([0.5]), semantics, classes)
    normalise(semantics)
    shown = 0.5 * math.erf(0.5 / 0.2 / math.sqrt(2)) ** 2
    assert semantics[0, :, 4, 4] == pytest.approx([(0.2 + 0.25 * shown) / (0.2 + shown), 0.75 * shown / (0.2 + shown)])
    assert semantics[0, :, 0, 0].tolist() == [1.0, 0.0]


def test_what_is_seen_has_the_classes_of_whose_return_it_is():
    semantics, place = np.zeros((2, *GRID.shape), np.float32), anywhere().astype(np.float32)
    body, behind = legs((5.0, 0.0)), legs((5.0, 4.0))
    frame = frame_of([body, np.array([(9.0, 3.0)])])
    tracks = [track_of(body, (0.0, 1.0)), track_of(behind, (0.0, 1.0), unseen=1)]
    attribute(semantics, place, frame.occupied, tracks, np.array([[0.1, 0.9], [1.0, 0.0]], np.float32), GRID)
    (own, hidden, other), _ = GRID.cells_of(np.array([body[0], behind[0], (9.0, 3.0)]))
    assert semantics[:, own[0], own[1]] == pytest.approx([0.1, 0.9])
    assert semantics[:, hidden[0], hidden[1]].tolist() == [0.0, 0.0]
    assert semantics[:, other[0], other[1]] == pytest.approx([0.5, 0.5])


# Fit, and weights


class Street:
    """Somebody walks up one side, and a box of three metres drives down the other; `classes` its labels'."""

    name, sha256, grid, period_s, site = "street.mcap", "0" * 64, GRID, PERIOD_S, "street"

    def __init__(self, frames=120, classes=("pedestrian", "car", "horse")):
        self.frames, self.classes = frames, classes

    def __len__(self):
        return self.frames

    def __iter__(self):
        return (item.frame for item in self.labelled())

    def labelled(self):
        for step in range(self.frames):
            t = step % 40 * PERIOD_S
            walker, car = legs((4.0, -4.0 + 1.2 * t)), box(3.0, 1.6, (8.0, 4.0 - 1.6 * t), -math.pi / 2)
            cells = [np.ravel_multi_index(GRID.cells_of(each)[0].T, GRID.shape) for each in (walker, car)]
            label_at = np.full(GRID.size**2, 255, np.uint8)
            label_at[cells[0]], label_at[cells[1]] = PEDESTRIAN, CAR
            labelled = np.flatnonzero(label_at < (255 if self.classes else 0))
            yield LabelledFrame(frame_of([walker, car], step), labelled, label_at[labelled])


def no_score(tracker, source, steps):
    flat = np.zeros(steps + 1)
    return StretchScore({"moving": flat, "visible": flat}, {"moving": flat})


def fit(folder, tracker=KalmanTracker, street=None, **options):
    street = street or Street()
    out = FitOutput(folder / "street.toml", f"gridtrack train {options}", 3, folder / "log", lambda line: None)
    settings = ModelFreeSettings(**({"labelled_scans": 80, "link_m": 0.5} | options))
    tracker.fit([street], [street], no_score, out, settings)
    return out.path


@pytest.fixture(scope="module", autouse=True)
def one_trial():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tuning, "TRIALS", 1)
        yield


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return fit(tmp_path_factory.mktemp("street"))


def test_what_was_learned_from_labelled_scans_tells_the_classes_of_cells_and_objects_now_and_ahead(path):
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


STARTED_AND_FED = """
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from gridtrack.trackers.contract import stream_of
from gridtrack.trackers.model_free import KalmanTracker, classes, rasterise
from gridtrack.trackers.model_free.settings import ModelFreeSettings

spec = spec_from_file_location("scenes", sys.argv[1])
spec.loader.exec_module(scenes := module_from_spec(spec))

def compiled():
    kernels = rasterise.draw_tracks, classes._features, classes._log_densities, classes._normalise
    return [len(kernel.signatures) for kernel in kernels]

tracker = KalmanTracker(stream_of(scenes.Street(), Path(sys.argv[2])), ModelFreeSettings())
before = compiled()
for frame in scenes.Street(30):
    tracker.update(frame)
tracker.predict(20)
print(before, compiled())
"""


def test_what_is_compiled_on_first_use_is_compiled_when_it_starts(path):
    command = [sys.executable, "-c", STARTED_AND_FED, __file__, str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout == "[1, 1, 1, 1] [1, 1, 1, 1]\n"


def test_the_card_says_what_was_learned_from_what(path):
    card = read_card(path)
    assert card.classes == ("pedestrian", "car")
    assert card.settings["labelled_scans"] == 80
    told = card.results["classes"]
    assert told["labelled"].startswith("street.mcap, 80 scans from")
    assert told["tracks"]["pedestrian"] >= 2
    assert told["validation_log_loss"] < 0.2


def test_classes_are_added_to_weights_that_stay_as_they_are_bit_for_bit_and_fitted_twice_are_the_same(path, tmp_path):
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


def test_classes_take_the_place_of_others_even_of_such_as_cannot_be_read(path, tmp_path):
    weights = load_weights(stream_of(Street(), path), "kalman")
    other = tmp_path / "street.toml"
    save_weights(other, weights.card, weights.arrays | {"class_means": np.zeros((2, 1, 99)), "class_old": np.zeros(3)})
    fit(tmp_path, stage="classes")
    again = load_weights(stream_of(Street(), other), "kalman")
    assert {k: v.tobytes() for k, v in weights.arrays.items()} == {k: v.tobytes() for k, v in again.arrays.items()}


def test_a_recording_without_labels_is_trained_without_classes_and_the_card_says_so(tmp_path):
    path = fit(tmp_path, FactorGraphTracker, Street(classes=()))
    card = read_card(path)
    assert card.classes == ()
    assert card.results["classes"] == "none: street.mcap has no labels"
    tracker = FactorGraphTracker(stream_of(Street(), path), ModelFreeSettings())
    tracker.update(next(iter(Street())))
    forecast = tracker.predict(2)
    assert forecast.semantics is None
    assert {one.label for one in forecast.objects} <= {""}
    with pytest.raises(ConfigurationError, match=r"street\.mcap: nowhere 80 labelled scans in a row"):
        fit(tmp_path, FactorGraphTracker, Street(classes=()), stage="classes")


def test_too_few_labels_are_told_before_the_search_and_classes_without_weights_too(tmp_path):
    with pytest.raises(ConfigurationError, match="nowhere 121 labelled scans in a row"):
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
        (spoilt("place", lambda a: a[:, :9]), r"'class_place' is \(2, 9, 60\), expected"),
        (spoilt("place", lambda a: -a), "'class_place' does not hold probabilities"),
        (spoilt("frequency", lambda a: np.array([1.0, 0.0], np.float32)), "'class_frequency' rules a class out"),
        (spoilt("shares", lambda a: a * 2), "'class_shares' does not hold probabilities"),
        (spoilt("shares", lambda a: np.zeros((2, 10**4), np.float32)), "10000 Gaussians of a class, expected 1 to 64"),
        (spoilt("shares", lambda a: a[0]), r"'class_shares' is \(\d+,\), expected"),
        (spoilt("whitening", lambda a: a * 0), "'class_whitening' is singular"),
        (spoilt("powers", lambda a: a + 1e6), "'class_powers' are not from 0 to 10"),
        (lambda arrays: {k: v for k, v in arrays.items() if k != "class_powers"}, "'class_powers' is missing"),
    ],
)
def test_hostile_weights_give_one_clear_line(path, tmp_path, change, message):
    weights = load_weights(stream_of(Street(), path), "kalman")
    spoiled = tmp_path / "street.toml"
    save_weights(spoiled, weights.card, change(weights.arrays))
    with pytest.raises(WeightsError, match=message) as raised:
        KalmanTracker(stream_of(Street(), spoiled), ModelFreeSettings())
    assert "\n" not in str(raised.value)


def test_only_labelled_cells_of_learned_classes_are_counted():
    items = [LabelledFrame(None, np.array([3, 3600 - 1]), np.array(labels, np.uint8)) for labels in ([0, 2], [0, 0])]
    stretch = LabelledStretch(Street(), 0, 0, items)
    count = count_cells(stretch, ("horse", "pedestrian"))
    assert count.sum() == 4.0
    assert (count[1, 0, 3], count[0, 59, 59], count[1, 59, 59]) == (2.0, 1.0, 1.0)
    assert ClassModel._fields == ("shares", "means", "whitening", "frequency", "powers", "place")

"""A training that starts from a general network: first the same forecasts, then what it adds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("lightning")

from gridtrack.common.config import validated  # noqa: E402
from gridtrack.common.errors import ConfigurationError, WeightsError  # noqa: E402
from gridtrack.trackers.contract import FitTask, stream_of  # noqa: E402
from gridtrack.trackers.recurrent.convgru_tracker import DilatedConvGRUTracker  # noqa: E402
from gridtrack.trackers.recurrent.deep_tracking_rnn import DeepTrackingRNNTracker
from gridtrack.trackers.recurrent.fit import settings_from_general
from gridtrack.trackers.registry import registered_name  # noqa: E402
from gridtrack.trackers.training.weights import load_start, read_card  # noqa: E402
from tests.trackers.recurrent.test_general import HELD_OUT, SMALL, TRACKERS, LabelledWalk, Walk, fit  # noqa: E402
from tests.trackers.scores import of_every_stratum  # noqa: E402

SITE = Walk(18, 0.15, 0.16, unseen=4)
"""Of another number and size of cells, and of another period than the general weights."""


class Place(Walk):
    """The walk at a site."""

    site = "yard"


@pytest.fixture(scope="module", params=TRACKERS)
def general(request, tmp_path_factory):
    """A tracker and the card of its general weights, whose shifts by resolution are not zero."""
    folder = tmp_path_factory.mktemp("general")
    sources = [Walk(16, 0.2, 0.125), Walk(24, 0.05, 0.05)]
    path, _ = fit(
        request.param,
        folder,
        sources,
        HELD_OUT[1:],
        updates=20,
        validate_every=20,
        learning_rate=0.02,
        unseen_weight=0.1,
    )
    assert any(
        np.abs(value).max() > 0
        for name, value in load_start(path, registered_name(request.param)).arrays.items()
        if "shift" in name
    )
    return request.param, path


class Scores:
    """A `score` that keeps the forecast after each frame of the first trackers.

    The n-th network has `f1[n]` and `log_loss[n]`, those after the last ones too.
    """

    def __init__(self, *f1, log_loss=(0.1,)):
        self.f1, self.log_loss, self.forecasts = f1, log_loss, []

    def __call__(self, tracker, source, steps):
        f1, log_loss = (of[min(len(self.forecasts), len(of) - 1)] for of in (self.f1, self.log_loss))
        self.forecasts.append(forecasts_of(tracker, source))
        return of_every_stratum(f1, log_loss, steps)


def forecasts_of(tracker, source):
    tracker.reset(0)
    found = []
    for frame in source:
        tracker.update(frame)
        found.append(tracker.predict(2).occupancy)
    return np.stack(found)


def train_at_site(tracker, start, folder, score, source=None, **options):
    return train(tracker, start, folder / "yard.toml", score, [source or Place(18, 0.15, 0.16, unseen=4)], options)


def train(tracker, start, path, score, sources, options, *, general=False):
    lines: list[str] = []
    log = path.parent / "log"
    given = {"precision": "32-true", **options}
    if tracker is DilatedConvGRUTracker:
        given = {"stage": "occupancy", **given}
    options = validated(tracker.Options, given, "test")
    more = {"general": general, "start": start, "report": lines.append}
    tracker.fit(FitTask(sources, sources, score, path, options, log, 7, **more))
    return path, lines


def test_before_the_first_update_the_forecasts_are_those_of_the_general_weights(general, tmp_path):
    tracker, path = general
    score = Scores(0.5)
    train_at_site(tracker, path, tmp_path, score, updates=1, validate_every=1, learning_rate=0.1)
    expected = forecasts_of(tracker(stream_of(SITE, path), tracker.Options()), SITE)
    np.testing.assert_array_equal(score.forecasts[0], expected)
    assert np.abs(score.forecasts[1] - expected).max() > 1e-3, "and after it they are others"


def test_what_the_place_adds_is_learned_and_used(general, tmp_path):
    tracker, path = general
    card_path, _ = train_at_site(tracker, path, tmp_path, Scores(0.1, 0.9), updates=4, learning_rate=0.05)
    card = read_card(card_path)
    assert (card.site, card.settings["resolution_input"]) == ("yard", True)
    made = tracker(stream_of(Place(18, 0.15, 0.16), card_path), tracker.Options())
    assert np.isfinite(forecasts_of(made, SITE)).all()
    if tracker is DilatedConvGRUTracker:
        arrays = load_arrays(card_path)
        maps = arrays["layers.0.biases.candidate"]
        assert maps.shape == (4, 18, 18)
        assert np.ptp(maps, axis=(1, 2)).max() > 1e-3, "the static memory differs from cell to cell"


def test_a_general_training_goes_on_with_the_same_network(general, tmp_path):
    """Of further places, in cells of other sizes: the network gets no map, and runs on any grid as before."""
    tracker, start = general
    score, sources = Scores(0.5, 0.5, 0.9), [SITE, Walk(24, 0.05, 0.05)]
    options = {"updates": 2, "learning_rate": 0.05}
    path, _ = train(tracker, start, tmp_path / "general.toml", score, sources, options, general=True)
    expected = forecasts_of(tracker(stream_of(SITE, start), tracker.Options()), SITE)
    np.testing.assert_array_equal(score.forecasts[0], expected)
    arrays, theirs = load_arrays(path), load_start(start, registered_name(tracker)).arrays
    assert {name: value.shape for name, value in arrays.items()} == {n: theirs[n].shape for n in arrays}
    assert any(np.abs(value - theirs[name]).max() > 1e-3 for name, value in arrays.items())
    assert read_card(path).general


def load_arrays(card_path):
    from safetensors.numpy import load_file

    return load_file(card_path.with_suffix(".safetensors"))


def test_general_weights_that_no_update_improves_are_kept(general, tmp_path):
    tracker, path = general
    card_path, lines = train_at_site(tracker, path, tmp_path, Scores(0.9, 0.2), updates=2, learning_rate=0.1)
    arrays, theirs = load_arrays(card_path), load_start(path, registered_name(tracker)).arrays
    for name, value in arrays.items():
        np.testing.assert_array_equal(value, np.broadcast_to(theirs[name], value.shape))
    assert read_card(card_path).results["score"] == pytest.approx(0.9)
    assert any("they are kept" in line for line in lines)


def test_at_nearly_the_same_f1_the_log_loss_decides_whether_they_are_kept(general, tmp_path):
    tracker, path = general
    for log_loss, f1 in ((0.2, 0.5005), (0.1, 0.4995)):
        score = Scores(0.5, f1, log_loss=(0.15, log_loss))
        card_path, lines = train_at_site(tracker, path, tmp_path / str(f1), score, updates=2, learning_rate=0.1)
        assert read_card(card_path).results["log_loss"] == min(log_loss, 0.15)
        assert any("they are kept" in line for line in lines) == (log_loss > 0.15)


def test_settings_are_those_of_the_general_weights_but_for_the_length_of_the_training(general):
    tracker, path = general
    weights = load_start(path, registered_name(tracker))
    of_accelerator = replace(
        weights,
        card=weights.card.model_copy(update={"settings": {**weights.card.settings, "batch": 32, "burn_in": 80}}),
    )
    for start, options, burn_in in ((weights, tracker.Options(), 0), (of_accelerator, tracker.Options(), 20)):
        settings = settings_from_general(options, start).model_dump()
        assert [settings[key] for key in ("updates", "learning_rate", "batch", "burn_in")] == [600, 1e-3, 2, burn_in]
        assert settings["unseen_weight"] == 0.1
        shape = SMALL[tracker].keys() - {"stage"}
        assert {name: settings[name] for name in shape} == {name: weights.card.settings[name] for name in shape}
    assert settings_from_general(validated(tracker.Options, {"batch": 4, "updates": 9}, "test"), weights).batch == 4


def test_another_shape_is_refused(general, tmp_path):
    tracker, path = general
    other = {"channels": 5} if tracker is DilatedConvGRUTracker else {"variant": "code"}
    with pytest.raises(WeightsError, match="leave the option out, or train with --from-scratch"):
        train_at_site(tracker, path, tmp_path, Scores(0.5), **other)


def test_where_the_sensor_moves_there_is_no_static_memory(general, tmp_path):
    tracker, path = general
    source = Place(18, 0.15, 0.16, drift=1)
    card_path, _ = train_at_site(tracker, path, tmp_path, Scores(0.1, 0.9), source, updates=1)
    if tracker is DilatedConvGRUTracker:
        assert load_arrays(card_path)["layers.0.biases.keep"].shape == (4, 1, 1)


def test_checkpoints_of_a_start_from_other_weights_are_refused(general, tmp_path):
    tracker, path = general
    train_at_site(tracker, path, tmp_path, Scores(0.5), updates=2)
    with pytest.raises(ConfigurationError, match="checkpoints of a training with other settings, data or seed"):
        train_at_site(tracker, None, tmp_path, Scores(0.5), **{**read_card(tmp_path / "yard.toml").settings})


def test_without_labels_the_class_decoder_of_the_general_weights_is_left_out(tmp_path, monkeypatch):
    from gridtrack.trackers.training import cell_training
    from gridtrack.trackers.training.labelled_scans import ClassifierSettings

    monkeypatch.setattr(
        cell_training, "candidate_settings", lambda given, seed: [ClassifierSettings(updates=2, **dict(given))]
    )
    labelled = [LabelledWalk(16, 0.2, 0.125), LabelledWalk(12, 0.1, 0.1, classes=("car",))]
    options = {"stage": "both", "labelled_scans": 40, "class_channels": 4, "updates": 1, "validate_every": 1}
    path, _ = fit(DilatedConvGRUTracker, tmp_path, labelled, labelled, **options)
    assert set(read_card(path).classes) == {"walker", "car"}
    short = {"updates": 1, "validate_every": 1}
    card_path, lines = train_at_site(DilatedConvGRUTracker, path, tmp_path / "site", Scores(0.5), stage="both", **short)
    assert read_card(card_path).classes == ()
    assert any("class decoder of the general weights is left out" in line for line in lines)
    tracker = DilatedConvGRUTracker(stream_of(Place(18, 0.15, 0.16), card_path), DilatedConvGRUTracker.Options())
    assert tracker.predict(1).semantics is None
    assert DilatedConvGRUTracker.starts_from_general(DilatedConvGRUTracker.Options())
    assert not DilatedConvGRUTracker.starts_from_general(DilatedConvGRUTracker.Options(stage="classes"))
    assert DeepTrackingRNNTracker.starts_from_general(DeepTrackingRNNTracker.Options())

"""General weights: trained on different grids and periods, used on any, and the start of a training at a site."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from gridtrack.common.config import validated
from gridtrack.common.errors import ConfigurationError, WeightsError
from gridtrack.trackers.contract import StretchScore, stream_of
from gridtrack.trackers.recurrent.convgru_tracker import DilatedConvGRUTracker
from gridtrack.trackers.recurrent.deep_tracking_rnn import DeepTrackingRNNTracker
from gridtrack.trackers.recurrent.fit import settings_from_general, validation_scores
from gridtrack.trackers.recurrent.network import resolution_of, set_resolution
from gridtrack.trackers.training.excerpts import VALIDATED_S, excerpts_of_places
from gridtrack.trackers.training.weights import load_start, read_card
from tests.trackers.recurrent.sources import (
    BRIEF,
    SMALL,
    TRACKERS,
    Walk,
    arrays_of,
    constant,
    convgru,
    fit,
    forecast_of,
    rnn,
    trained,
)
from tests.trackers.scores import of_every_stratum


@pytest.fixture(scope="module", params=TRACKERS)
def general(request, tmp_path_factory):
    """A tracker, the card of its general weights with non-zero shifts by resolution, and the training's lines."""
    card = tmp_path_factory.mktemp("general") / "general.toml"
    sources = [Walk(16, 0.2, 0.125), Walk(24, 0.05, 0.05), Walk(10, 0.1, 0.2, drift=1)]
    options = {"updates": 10, "validate_every": 10, "learning_rate": 0.02, "unseen_weight": 0.1}
    lines = fit(request.param, card, sources, [Walk(9, 0.3, 0.25)], general=True, **options, **BRIEF)
    shifts = [value for name, value in arrays_of(card).items() if "shift" in name]
    assert max(np.abs(value).max() for value in shifts) > 0
    return request.param, card, lines


# General weights


def test_general_weights_run_on_any_grid_and_period_and_their_card_has_the_ranges(general):
    tracker, card, lines = general
    written = read_card(card)
    assert (written.general, written.cells_m, written.periods_s) == (True, (0.05, 0.2), (0.05, 0.2))
    assert written.settings["resolution_input"]
    if tracker is DilatedConvGRUTracker:
        assert written.settings["static_gates"] == []
        assert any("general weights know no place: trained without static memory" in line for line in lines)
    for source in (Walk(16, 0.2, 0.125), Walk(33, 0.07, 0.03, drift=2)):
        constant(trained(tracker, card, source), source, 3)


@pytest.mark.parametrize("network", [convgru(static_gates=(), resolution_input=True), rnn(resolution_input=True)])
def test_the_network_reads_cell_size_and_period(network):
    answers = []
    for cell_m, period_s in ((0.1, 0.1), (0.1, 0.2), (0.2, 0.1)):
        set_resolution(network, resolution_of(cell_m, period_s))
        answers.append(network.occupancy(network.features(network.step(None, network.initial(1)))))
    assert not torch.equal(answers[0], answers[1])
    assert not torch.equal(answers[0], answers[2])


def test_inference_takes_on_the_size_and_the_resolution_of_its_stream():
    """Two steps of 0.1 s a frame."""
    network, options = rnn(resolution_input=True), DeepTrackingRNNTracker.Options(step_s=0.1)
    DeepTrackingRNNTracker.inference_for(network, stream_of(Walk(20, 0.05, 0.2)), options)
    assert network.size == 20
    assert torch.equal(network.shifts["recur"].resolution, resolution_of(0.05, 0.1))


def test_a_validation_recording_in_which_nothing_moves_has_no_part_in_the_score():
    moves, stands = Walk(8, 0.1, 1.0), Walk(9, 0.1, 1.0)

    def score(source):
        dynamic, visible = (0.5, 0.5) if source is moves else (np.nan, 0.7)
        of = {"dynamic": np.full(3, dynamic), "in-motion": np.full(3, dynamic), "visible": np.full(3, visible)}
        return StretchScore(of, {name: 1.0 - values for name, values in of.items()}, np.full(3, np.nan))

    found = validation_scores(score, [moves, stands])
    assert (found["dynamic_f1_1s"], found["visible_f1_1s"]) == (0.5, pytest.approx(0.6))
    assert found["log_loss"] == pytest.approx(0.45), "the mean of 0.5, 0.5, 0.5 and 0.3"
    alone = validation_scores(score, [stands])
    assert alone["score"] == pytest.approx(0.7), "the defined scores choose between updates"


def test_a_general_network_is_validated_on_the_middle_minute_of_a_long_recording():
    short, long = Walk(8, 0.1, 1.0, frames=40), Walk(8, 0.1, 0.5, frames=400)
    found = excerpts_of_places([short, long], VALIDATED_S)
    assert [len(one) for one in found] == [40, 120]
    assert [one.stamp_ns / 1e9 for one in found[1]][:: len(found[1]) - 1] == [70.0, 129.5]


def test_where_no_beam_reached_in_training_the_network_forecasts_the_occupied_rate(tmp_path):
    """Also long after, and at every horizon, in a place where nothing was ever observed."""
    card, source = tmp_path / "general.toml", Walk(12, 0.2, 0.125, unseen=8)
    shape = {"burn_in": 15, "observed_frames": 5, "blank_frames": 5, "repetitions": 1}
    options = {"updates": 40, "validate_every": 40, "learning_rate": 0.02, "unseen_weight": 1.0}
    fit(DilatedConvGRUTracker, card, [source], general=True, **shape, **options)
    long = Walk(12, 0.2, 0.125, frames=300, unseen=8)
    unseen = forecast_of(trained(DilatedConvGRUTracker, card, long), long, 20)[:, 1:5]
    rate = 1 / (12 * 4)
    assert rate / 5 < unseen.min() < unseen.max() < 5 * rate


# A training that starts from them

SITE = Walk(18, 0.15, 0.16, unseen=4)
"""Another number and size of cells, and another period than the general weights have."""


class Place(Walk):
    """The walk at a site."""

    site = "yard"


class Scores:
    """An objective that keeps the forecast after each frame; the n-th network has `f1[n]` and `log_loss[n]`.

    Later networks have the last ones.
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


def fit_at_site(tracker, start, folder, scores, drift=0, **options):
    """A training at a site of another number and size of cells, and another period; its card and lines."""
    card, place = folder / "yard.toml", Place(18, 0.15, 0.16, frames=30, unseen=4, drift=drift)
    given = {"updates": 2, "validate_every": 2, "learning_rate": 0.1, **BRIEF, **options}
    return card, fit(tracker, card, [place], objective=scores, start=start, **given)


def test_a_training_begins_with_the_forecasts_of_the_general_weights_and_adds_the_place(general, tmp_path):
    tracker, start, _ = general
    score = Scores(0.1, 0.9)
    card, _ = fit_at_site(tracker, start, tmp_path, score)
    place = Place(18, 0.15, 0.16, frames=30, unseen=4)
    expected = forecasts_of(trained(tracker, start, place), place)
    np.testing.assert_array_equal(score.forecasts[0], expected)
    assert np.abs(score.forecasts[1] - expected).max() > 1e-3
    np.testing.assert_array_equal(forecasts_of(trained(tracker, card, place), place), score.forecasts[1])
    assert (read_card(card).site, read_card(card).settings["resolution_input"]) == ("yard", True)
    if tracker is DilatedConvGRUTracker:
        maps = arrays_of(card)["layers.0.biases.candidate"]
        assert maps.shape == (4, 18, 18)
        assert np.ptp(maps, axis=(1, 2)).max() > 1e-3, "the static memory differs from cell to cell"


def test_a_general_training_goes_on_with_the_same_network(general, tmp_path):
    """Of further places, in cells of other sizes: the network gets no map, and runs on any grid as before."""
    tracker, start, _ = general
    score, card = Scores(0.5, 0.5, 0.9), tmp_path / "general.toml"
    options = {"updates": 2, "learning_rate": 0.05, **BRIEF}
    fit(tracker, card, [SITE, Walk(24, 0.05, 0.05)], objective=score, general=True, start=start, **options)
    np.testing.assert_array_equal(score.forecasts[0], forecasts_of(trained(tracker, start, SITE), SITE))
    arrays, theirs = arrays_of(card), arrays_of(start)
    assert {name: value.shape for name, value in arrays.items()} == {n: theirs[n].shape for n in arrays}
    assert any(np.abs(value - theirs[name]).max() > 1e-3 for name, value in arrays.items())
    assert read_card(card).general


@pytest.mark.parametrize(
    ("f1", "log_loss", "kept"),
    [((0.9, 0.2), (0.1,), True), ((0.5, 0.5005), (0.15, 0.2), True), ((0.5, 0.4995), (0.15, 0.1), False)],
    ids=["worse", "nearly equal f1 and more log loss", "nearly equal f1 and less log loss"],
)
def test_general_weights_that_no_update_improves_are_kept(general, tmp_path, f1, log_loss, kept):
    tracker, start, _ = general
    card, lines = fit_at_site(tracker, start, tmp_path, Scores(*f1, log_loss=log_loss))
    theirs = arrays_of(start)
    equal = [np.array_equal(value, np.broadcast_to(theirs[n], value.shape)) for n, value in arrays_of(card).items()]
    assert all(equal) == kept
    assert any("they are kept" in line for line in lines) == kept
    results = read_card(card).results
    chosen = 0 if kept else -1
    assert (results["score"], results["log_loss"]) == pytest.approx((f1[chosen], log_loss[chosen]))


def test_settings_come_from_the_general_weights_except_the_length_of_the_training(general):
    tracker, start, _ = general
    weights = load_start(start, read_card(start).tracker)
    of_accelerator = replace(
        weights,
        card=weights.card.model_copy(update={"settings": {**weights.card.settings, "batch": 32, "burn_in": 80}}),
    )
    for general_weights, burn_in in ((weights, 0), (of_accelerator, 20)):
        settings = settings_from_general(tracker, tracker.Options(), general_weights).model_dump()
        assert [settings[key] for key in ("updates", "learning_rate", "batch", "burn_in")] == [600, 1e-3, 2, burn_in]
        assert settings["unseen_weight"] == 0.1
        shape = SMALL[tracker].keys() - {"stage"}
        assert {name: settings[name] for name in shape} == {name: weights.card.settings[name] for name in shape}
    given = validated(tracker.Options, {"batch": 4, "updates": 9}, "test")
    assert settings_from_general(tracker, given, weights).batch == 4


def test_another_shape_is_refused(general, tmp_path):
    tracker, start, _ = general
    other = {"channels": 5} if tracker is DilatedConvGRUTracker else {"variant": "code"}
    with pytest.raises(WeightsError, match="leave the option out, or train with --from-scratch"):
        fit_at_site(tracker, start, tmp_path, Scores(0.5), **other)


def test_where_the_sensor_moves_there_is_no_static_memory(general, tmp_path):
    tracker, start, _ = general
    card, _ = fit_at_site(tracker, start, tmp_path, Scores(0.1, 0.9), drift=1, updates=1)
    shapes, theirs = ({name: value.shape for name, value in arrays_of(each).items()} for each in (card, start))
    assert shapes == theirs


def test_checkpoints_of_a_start_from_other_weights_are_refused(general, tmp_path):
    tracker, start, _ = general
    card, _ = fit_at_site(tracker, start, tmp_path, Scores(0.5))
    with pytest.raises(ConfigurationError, match="checkpoints of another training: another start;"):
        fit_at_site(tracker, None, tmp_path, Scores(0.5), **read_card(card).settings)

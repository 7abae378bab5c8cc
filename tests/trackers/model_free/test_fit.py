"""Weights of the model-free trackers: validation and training."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gridtrack.common.errors import RecordingError, WeightsError
from gridtrack.common.grid import GridSpec, Shift
from gridtrack.trackers.contract import FitTask, StreamSpec
from gridtrack.trackers.model_free.background import OUTSIDE_MAP
from gridtrack.trackers.model_free.kalman import KalmanTracker
from gridtrack.trackers.model_free.residence import fit_residence, resampled
from gridtrack.trackers.model_free.settings import ModelFreeSettings, PipelineSettings
from gridtrack.trackers.training import searched_fit
from gridtrack.trackers.training.card import card_for
from gridtrack.trackers.training.searched_fit import FINALISTS
from gridtrack.trackers.training.weights import load_weights, read_card, save_weights
from tests.trackers.scores import of_every_stratum

from scenes.frames import Frames
from scenes.hall import GLIDING, GRID, OPEN, PERIOD_S, card, frame_of, walk
from scenes.scrolling import scrolled


@pytest.mark.parametrize(
    ("name", "spoilt", "message"),
    [
        ("occupancy_rate", np.nan, "'occupancy_rate' is not finite"),
        ("neighbourhood_rate", -0.1, "'neighbourhood_rate' does not hold probabilities"),
        ("residence", 1.5, "'residence' does not hold probabilities"),
    ],
)
def test_weights_with_maps_that_are_not_probabilities_are_refused(tmp_path, name, spoilt, message):
    arrays = OPEN | {"residence": GLIDING}
    save_weights(tmp_path / "hall.toml", card(), arrays | {name: np.full_like(arrays[name], spoilt)})
    with pytest.raises(WeightsError, match=message):
        KalmanTracker(StreamSpec(GRID, PERIOD_S, "hall", weights=tmp_path / "hall.toml"), PipelineSettings())


def test_weights_with_an_unknown_setting_are_refused(tmp_path):
    path = tmp_path / "hall.toml"
    save_weights(path, card(link=1.0), OPEN | {"residence": GLIDING})
    with pytest.raises(WeightsError, match="link_m"):
        KalmanTracker(StreamSpec(GRID, PERIOD_S, "hall", weights=path), PipelineSettings())


def source(name="hall@0s-3s", **changed):
    """Thirty frames of a walk."""
    frames = [frame_of([place], step) for step, place in enumerate(walk((3.0, -1.5), (0.0, 1.0), 30))]
    return replace(Frames(frames, GRID, PERIOD_S, name, "0" * 64, "hall"), **changed)


def driven(name="hall@0s-3s"):
    """The same walk in a window that moves."""
    shifts = [Shift(-(step // 5), step // 2) for step in range(30)]
    return source(name, frames=[scrolled(*each, GRID) for each in zip(source(), shifts, strict=True)])


def fit(out, objective, options=None, train=None, validation=None, **more):
    """Train `kalman`; returns the path of the card."""
    sources, options = (train or [source()], [validation or source()]), options or ModelFreeSettings()
    KalmanTracker.fit(
        FitTask(*sources, objective, out, options, out.parent / "log", 3, "gridtrack train kalman", **more)
    )
    return out


def fit_hall(tmp_path, score, reported, validation=None):
    fit(tmp_path / "hall.toml", score, validation=validation, report=reported.append)


def test_the_validation_recordings_decide_between_the_best_settings(tmp_path, monkeypatch):
    monkeypatch.setattr(searched_fit, "SEARCH_ITERATIONS", 8)
    validation, searched, compared = source("hall@3s-6s"), [], []

    def score(tracker, scored, steps):
        """In training, more acceleration is better; in validation, less."""
        value = tracker._settings.acceleration
        (compared if scored is validation else searched).append(value)
        return of_every_stratum(value if scored is not validation else 1.0 - value, 0.0, steps)

    reported = []
    fit_hall(tmp_path, score, reported, validation)
    best = sorted(searched[:8], reverse=True)[:FINALISTS]
    assert compared[:FINALISTS] == best
    assert read_card(tmp_path / "hall.toml").settings["acceleration"] == best[-1]
    assert any(line.startswith(f"number {FINALISTS} of the {FINALISTS} best is chosen") for line in reported)
    stream = StreamSpec(GRID, PERIOD_S, "hall", weights=tmp_path / "hall.toml")
    settings = ModelFreeSettings(**read_card(tmp_path / "hall.toml").settings | {"acceleration": 0.2})
    assert KalmanTracker(stream, PipelineSettings(acceleration=0.2))._settings == settings


def test_a_stretch_without_scores_is_refused_in_one_line(tmp_path):
    def score(tracker, source, steps):
        return of_every_stratum(np.nan, np.nan, steps)

    with pytest.raises(RecordingError, match=r"selection score is not defined on .*; use a longer stretch"):
        fit_hall(tmp_path, score, [])
    assert not (tmp_path / "hall.toml").exists()


class Scores:
    """A score that depends on the settings, interrupted after some calls; counts its calls."""

    def __init__(self, interrupt_after: int = 10**6):
        self.calls, self.interrupt_after = 0, interrupt_after

    def __call__(self, tracker, source, steps):
        if self.calls == self.interrupt_after:
            raise KeyboardInterrupt
        self.calls += 1
        return of_every_stratum(1.0 / (1.0 + tracker._settings.acceleration), 0.0, steps)


def test_an_interrupted_search_keeps_its_best_and_continues_with_the_same_result(tmp_path, caplog, monkeypatch):
    monkeypatch.setattr("gridtrack.trackers.training.searched_fit.SEARCH_ITERATIONS", 6)
    fit_hall(tmp_path / "whole", Scores(), [])
    with pytest.raises(KeyboardInterrupt):
        fit_hall(tmp_path, Scores(interrupt_after=4), [])
    assert not caplog.records
    card = read_card(tmp_path / "hall.toml")
    assert card.interrupted == "search iteration 4 of 6, not calibrated"
    KalmanTracker(StreamSpec(GRID, PERIOD_S, "hall", weights=tmp_path / "hall.toml"), PipelineSettings())
    rest = Scores()
    fit_hall(tmp_path, rest, [])
    assert rest.calls == 2 + FINALISTS + 2  # and the scores of the result on both stretches
    assert read_card(tmp_path / "hall.toml") == read_card(tmp_path / "whole" / "hall.toml")
    assert read_card(tmp_path / "hall.toml").interrupted == ""


def test_an_interrupted_search_keeps_the_weights_of_an_earlier_training(tmp_path, monkeypatch):
    monkeypatch.setattr("gridtrack.trackers.training.searched_fit.SEARCH_ITERATIONS", 3)
    fit_hall(tmp_path, Scores(), [])
    earlier = (tmp_path / "hall.toml").read_bytes()
    with pytest.raises(KeyboardInterrupt):
        fit_hall(tmp_path, Scores(interrupt_after=2), [])
    assert (tmp_path / "hall.toml").read_bytes() == earlier


def test_training_on_a_moving_sensor_learns_no_map_and_reports_it(tmp_path, monkeypatch):
    monkeypatch.setattr("gridtrack.trackers.training.searched_fit.SEARCH_ITERATIONS", 1)
    reported = []
    out = fit(tmp_path / "hall.toml", Scores(), train=[driven()], validation=driven(), report=reported.append)
    assert any("the sensor moves: no map of the place is learned" in line for line in reported)
    stream = StreamSpec(GRID, PERIOD_S, "hall", weights=out)
    arrays = load_weights(stream, "kalman").arrays
    assert np.ptp(arrays["occupancy_rate"]) == 0.0
    assert (arrays["neighbourhood_rate"] == OUTSIDE_MAP).all()
    assert arrays["residence"][0, 1] > 0.05  # counted in cells that were open before
    tracker = KalmanTracker(stream, PipelineSettings())
    for frame in driven():
        tracker.update(frame)
    assert np.isfinite(tracker.predict(3).occupancy).all()


def fine():
    """The same walk at another site, in half the cells at twice the rate."""
    grid, quarters = GridSpec(2 * GRID.size, GRID.cell_m / 2, GRID.origin), np.ones((2, 2), bool)
    frames = [
        replace(frame, visible=np.kron(frame.visible, quarters), occupied=np.kron(frame.occupied, quarters))
        for frame in source()
    ]
    return Frames(frames, grid, PERIOD_S / 2, "yard@0s-1.5s", "1" * 64, "yard")


def test_a_general_training_learns_no_map_and_runs_on_any_grid_and_period(tmp_path, monkeypatch):
    monkeypatch.setattr("gridtrack.trackers.training.searched_fit.SEARCH_ITERATIONS", 1)
    out = fit(tmp_path / "general.toml", Scores(), train=[source(), fine()], validation=fine(), general=True)
    card = read_card(out)
    assert (card.general, card.cells_m) == (True, (GRID.cell_m / 2, GRID.cell_m))
    for own in (source(), fine()):
        stream = StreamSpec(own.grid, own.period_s, "elsewhere", weights=out)
        assert load_weights(stream, "kalman").arrays["occupancy_rate"].shape == (1, 1)
        tracker = KalmanTracker(stream, PipelineSettings())
        for frame in own:
            tracker.update(frame)
        assert np.isfinite(tracker.predict(3).occupancy).all()
        assert tracker.tracks


def general_weights(folder):
    """General weights with the settings for a training at a site."""
    path = folder / "general.toml"
    settings = PipelineSettings(acceleration=0.31, link_m=0.6)
    task = FitTask([source()], [], None, path, settings, folder / "log", general=True)
    save_weights(path, card_for("kalman", task, settings.model_dump()), {})
    return path


def test_a_site_searches_near_general_settings_and_its_map_settings_in_the_whole_range(tmp_path, monkeypatch):
    """General weights have no map of the place; classes are added to weights of the site."""
    monkeypatch.setattr("gridtrack.trackers.training.searched_fit.SEARCH_ITERATIONS", 9)
    general = general_weights(tmp_path)
    asked = []

    def score(tracker, source, steps):
        asked.append(tracker._settings)
        return of_every_stratum(0.5, 0.0, steps)

    fit(tmp_path / "hall.toml", score, ModelFreeSettings(link_m=0.7), start=general)
    assert {one.link_m for one in asked} == {0.7}, "was given"
    assert asked[0].acceleration == 0.31
    assert len({one.acceleration for one in asked}) == 9
    assert all(0.31 / 2 - 0.001 <= one.acceleration <= 2 * 0.31 + 0.001 for one in asked)
    of_place = [one.adaptation_s for one in asked]
    assert max(of_place) > 4 * min(of_place)
    assert KalmanTracker.starts_from_general(ModelFreeSettings())
    assert not KalmanTracker.starts_from_general(ModelFreeSettings(stage="classes"))


@pytest.mark.parametrize(
    ("made", "with_map", "chosen"),
    [(source, 0.485, "none"), (source, 0.495, "fitted"), (source, 0.7, "fitted"), (driven, 0.3, "fitted")],
)
def test_the_validation_recordings_decide_whether_the_map_of_the_place_is_used(
    tmp_path, monkeypatch, made, with_map, chosen
):
    """Objects that stand during a whole short training are walls on its map; only a map knows hidden cells."""
    monkeypatch.setattr("gridtrack.trackers.training.searched_fit.SEARCH_ITERATIONS", 3)
    general, validation, reported = general_weights(tmp_path), made("hall@3s-6s"), []

    def score(tracker, scored, steps):
        without = tracker._settings.background == "none"
        assert not (without and scored is not validation and not reported), "the search itself counts with the map"
        return of_every_stratum(0.5 if without else with_map, 0.0, steps)

    more = {"report": reported.append, "start": general}
    at_site = fit(tmp_path / "hall.toml", score, train=[made()], validation=validation, **more)
    assert read_card(at_site).settings["background"] == chosen
    assert any("the map is not used" in line for line in reported) == (chosen == "none")


def test_a_background_that_is_given_is_not_chosen(tmp_path, monkeypatch):
    monkeypatch.setattr("gridtrack.trackers.training.searched_fit.SEARCH_ITERATIONS", 1)
    asked = []

    def score(tracker, source, steps):
        asked.append(tracker._settings.background)
        return of_every_stratum(0.5, 0.0, steps)

    options = ModelFreeSettings(background="fitted")
    fit(tmp_path / "hall.toml", score, options, start=general_weights(tmp_path))
    assert set(asked) == {"fitted"}


def test_a_life_table_of_another_period_has_the_probabilities_of_its_times():
    """P = (age + 2 times the time ahead) / 10 s: linear, so the interpolation is exact within the table's span."""
    coarse = np.add.outer(np.arange(31), 2 * np.arange(31)) * 0.1 / 10
    fine = resampled(coarse, 0.1, 0.05)
    assert fine.shape == (61, 61)
    assert fine[3, 5] == pytest.approx((0.15 + 2 * 0.25) / 10)
    assert resampled(fine, 0.05, 0.1) == pytest.approx(coarse)


def test_residence_and_calibration_are_counted_in_the_world():
    """A return that stays in place in a window that moves is in place."""
    first, *_ = frames = source().frames
    still = [replace(first, stamp_ns=frame.stamp_ns) for frame in frames]
    tables = []
    for moves in (0, 1):
        frames = [
            scrolled(frame, Shift(-moves * (step // 5), moves * (step // 2)), GRID) for step, frame in enumerate(still)
        ]
        tables.append(
            fit_residence([frames] * 40, lambda: lambda frame: np.ones(GRID.shape, bool), (6, 6), GRID.cell_m)
        )
    assert tables[0][5, 5] > 0.9
    assert tables[1] == pytest.approx(tables[0])

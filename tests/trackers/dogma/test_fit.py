"""Training of the particle grid: the counted rate, the search, and the weights."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gridtrack.common.errors import WeightsError
from gridtrack.common.grid import GridSpec, Shift
from gridtrack.trackers.contract import FitTask, StreamSpec
from gridtrack.trackers.dogma.filter import DogmaSettings
from gridtrack.trackers.dogma.tracker import DogmaTracker, count_occupancy_rate
from gridtrack.trackers.site_map import count_frames
from gridtrack.trackers.training import searched_fit
from gridtrack.trackers.training.card import card_for
from gridtrack.trackers.training.searched_fit import FINALISTS
from gridtrack.trackers.training.weights import load_weights, read_card, save_weights
from tests.trackers.scores import of_every_stratum

from scenes.frames import Frames, frame_of
from scenes.scrolling import scrolled

GRID = GridSpec(3, 0.2)
PERIOD_S = 0.125
WALL, DOOR = (0, 0), (1, 1)


def task(out, objective, options, source=None, **more):
    source = source or yard()
    return FitTask([source], [source], objective, out, options, out.parent / "log", 3, "gridtrack train dogma", **more)


def yard() -> Frames:
    """Forty frames: a wall in each, a door in every other frame, a row that is never seen."""
    visible, frames = np.ones(GRID.shape, bool), []
    visible[2] = False
    for step in range(40):
        occupied = np.zeros(GRID.shape, bool)
        occupied[WALL], occupied[DOOR] = True, step % 2 == 0
        frames.append(frame_of(occupied, visible, grid=GRID, second=PERIOD_S * step))
    return Frames(frames, GRID, PERIOD_S, "yard@0s-5s", "0" * 64, "yard")


def test_the_occupancy_rate_is_the_share_of_each_cell_shrunk_to_the_base_rate() -> None:
    rate, moves = count_occupancy_rate([yard(), yard()])
    assert not moves
    base_rate = (40 + 20) / (6 * 40)
    assert rate[WALL] == pytest.approx((80 + 20 * base_rate) / 100)
    assert rate[DOOR] == pytest.approx((40 + 20 * base_rate) / 100)
    assert rate[0, 1] == pytest.approx(20 * base_rate / 100)
    assert rate[2] == pytest.approx([base_rate] * 3)


def test_fit_finds_the_best_settings_and_keeps_given_ones(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(searched_fit, "SEARCH_ITERATIONS", 11)
    asked = []

    def score(tracker, source, steps):
        asked.append(tracker.options)
        loss = abs(np.log(tracker.options.acceleration / 1.3))
        return of_every_stratum(1.0 - loss, loss, steps)

    paths = [tmp_path / run / "yard.toml" for run in ("one", "two")]
    for path in paths:
        DogmaTracker.fit(task(path, score, DogmaSettings(particles=800, free_decay_s=4.0)))
    one, two = (read_card(path) for path in paths)
    assert one == two
    assert all(settings.free_decay_s == 4.0 for settings in asked)
    assert [settings.particles for settings in asked[:18]] == [200] * 11 + [800] * (FINALISTS + 2)
    assert one.settings["particles"] == 800
    losses = [abs(np.log(settings.acceleration / 1.3)) for settings in asked[:11]]
    assert one.settings["acceleration"] == asked[int(np.argmin(losses))].acceleration
    assert len(set(losses)) == 11
    stream = StreamSpec(GRID, PERIOD_S, "yard", weights=paths[0])
    assert np.array_equal(load_weights(stream, "dogma").arrays["occupancy_rate"], count_occupancy_rate([yard()])[0])
    tracker = DogmaTracker(stream, DogmaSettings(acceleration=0.2))
    assert tracker._settings == DogmaSettings(**one.settings | {"acceleration": 0.2})


@pytest.fixture
def general(tmp_path):
    """The card of general weights with a time constant of free cells outside the range of the search."""
    settings = DogmaSettings(particles=1200, acceleration=0.7, birth_speed=3.0, free_decay_s=30.0)
    path = tmp_path / "general" / "general.toml"
    card = card_for("dogma", task(path, None, settings, general=True), settings.model_dump())
    save_weights(path, card, {"occupancy_rate": np.full((1, 1), 0.1, np.float32)})
    return path


@pytest.mark.parametrize(("best_s", "found_s"), [(2.0, (0.5, 20.0)), (300.0, (30.0, 30.0))])
def test_a_site_starts_from_general_settings_and_searches_near_them(
    best_s, found_s, general, tmp_path, monkeypatch
) -> None:
    """The weight of its map is searched in the whole range; the general settings are kept if nothing is better."""
    monkeypatch.setattr(searched_fit, "SEARCH_ITERATIONS", 6)
    asked = []

    def score(tracker, source, steps):
        asked.append(tracker.options)
        loss = abs(np.log(tracker.options.free_decay_s / best_s)) / 10
        return of_every_stratum(1.0 - loss, loss, steps)

    out = tmp_path / "yard.toml"
    DogmaTracker.fit(task(out, score, DogmaSettings(birth_speed=2.5), start=general))
    assert {settings.birth_speed for settings in asked} == {2.5}, "was given"
    assert len({settings.acceleration for settings in asked}) > 3
    assert all(0.35 <= settings.acceleration <= 1.4 for settings in asked)
    assert [settings.particles for settings in asked[:6]] == [300] * 6
    assert asked[0].free_decay_s == 20.0
    settings = read_card(out).settings
    assert found_s[0] <= settings["free_decay_s"] <= found_s[1]
    assert abs(np.log(settings["free_decay_s"] / best_s)) == min(abs(np.log(s.free_decay_s / best_s)) for s in asked)
    arrays = load_weights(StreamSpec(GRID, PERIOD_S, "yard", weights=out), "dogma").arrays
    assert np.array_equal(arrays["occupancy_rate"], count_occupancy_rate([yard()])[0])


def test_weights_of_another_site_are_no_start(general, tmp_path) -> None:
    from_site = task(tmp_path / "yard.toml", None, DogmaSettings(), start=general)
    save_weights(general, card_for("dogma", from_site, {}), {})
    with pytest.raises(WeightsError, match="weights of dogma for yard, expected general ones of dogma"):
        DogmaTracker.fit(from_site)


def driven() -> Frames:
    """The same frames in a window that moves."""
    moved = [scrolled(frame, Shift(step % 2, step // 10), GRID) for step, frame in enumerate(yard())]
    return replace(yard(), frames=moved, name="drive@0s-5s")


def test_training_on_a_moving_sensor_learns_no_map_and_reports_it(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(searched_fit, "SEARCH_ITERATIONS", 1)
    reported: list[str] = []
    out = tmp_path / "yard.toml"
    both = of_every_stratum(0.5, 0.5, 16)
    DogmaTracker.fit(task(out, lambda *_: both, DogmaSettings(particles=800), driven(), report=reported.append))
    assert any("the sensor moves: no map of the place is learned" in line for line in reported)
    stream = StreamSpec(GRID, PERIOD_S, "yard", weights=out)
    rate = load_weights(stream, "dogma").arrays["occupancy_rate"]
    assert rate.min() == rate.max() > 0.0
    tracker = DogmaTracker(stream, DogmaSettings())
    for frame in driven():
        tracker.update(frame)
    assert np.isfinite(tracker.predict(3).occupancy).all()


def test_a_source_with_a_sensor_elsewhere_is_counted_at_its_place() -> None:
    aside = [scrolled(frame, Shift(0, 1), GRID) for frame in yard()]
    home = [scrolled(frame, Shift(), GRID) for frame in yard()]
    (visible, occupied), moves = count_frames([home, aside], GRID.cell_m, lambda frame: (frame.visible, frame.occupied))
    assert not moves
    assert visible[0].tolist() == [40, 80, 80]
    assert (occupied[WALL], occupied[DOOR]) == (40, 40)

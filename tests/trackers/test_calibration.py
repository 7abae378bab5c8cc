"""Calibration: the fitted maps recover the observed frequencies and are monotonic."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from gridtrack.common.errors import WeightsError
from gridtrack.common.grid import GridSpec
from gridtrack.recordings import packaged_recording
from gridtrack.recordings.stream import open_stream
from gridtrack.trackers.contract import StreamSpec, stream_of
from gridtrack.trackers.model_free.kalman import KalmanTracker
from gridtrack.trackers.model_free.settings import PipelineSettings
from gridtrack.trackers.training.calibration import IDENTITY, Calibration, fit_calibration

from scenes.frames import frame_of

GRID, STEPS, PERIOD_S = GridSpec(40, 0.2), 3, 0.125
PARAMETERS = np.array([[0.7, 3.0, -2.0], [0.9, 1.2, -0.5]], np.float32)


def calibration(parameters):
    """The calibration with these parameters (2, 3) or (H, 2, 3)."""
    return Calibration(np.broadcast_to(parameters, IDENTITY.shape), PERIOD_S)


TRUE = calibration(PARAMETERS)


class Crystal:
    """A tracker that forecasts the next grid of a given list at all steps."""

    stream = StreamSpec(GRID, PERIOD_S)

    def __init__(self, said):
        self.said, self.frame = said, -1

    def reset(self, seed):
        self.frame, self.hidden_s = -1, np.full(GRID.shape, np.inf)

    def update(self, frame):
        self.frame += 1
        self.hidden_s = np.where(frame.visible, 0.0, self.hidden_s + PERIOD_S)

    def predict(self, steps):
        return SimpleNamespace(occupancy=np.repeat(self.said[self.frame][None], steps + 1, axis=0))


def mapped(by, p, hidden_s=0.0):
    """Probabilities (N,) calibrated `by` a calibration, of cells that were seen `hidden_s` ago."""
    forecast = np.array(p, np.float32).reshape(-1, 1, 1)
    by.apply(forecast, np.full((1, 1), hidden_s))
    return forecast.ravel()


def scene(count=120, seed=0):
    """Constant forecasts, drawn log-uniformly, and frames with the occupancy probabilities of TRUE."""
    draw = np.random.default_rng(seed)
    said = np.exp(draw.uniform(np.log(1e-3), np.log(0.97), GRID.shape)).astype(np.float32)
    often = mapped(TRUE, said).reshape(GRID.shape)
    return Crystal([said] * count), [frame_of(draw.random(GRID.shape) < often) for _ in range(count)]


def test_the_fit_recovers_the_true_calibration():
    learned = calibration(fit_calibration([(*scene(), STEPS)]))
    at = np.array([0.003, 0.02, 0.1, 0.3, 0.6, 0.9], np.float32)
    assert mapped(learned, at) == pytest.approx(mapped(TRUE, at), rel=0.1)


def test_cells_hidden_at_the_forecast_step_are_not_counted():
    tracker, frames = scene()
    hidden = np.zeros(GRID.shape, bool)
    hidden[:, :20] = True
    blinded = [frame_of(frame.occupied & ~hidden, ~hidden) for frame in frames]
    at = np.array([0.02, 0.3, 0.9], np.float32)
    learned = calibration(fit_calibration([(tracker, blinded, STEPS)]))
    assert mapped(learned, at) == pytest.approx(mapped(TRUE, at), rel=0.15)


def test_the_map_has_two_percent_accuracy_and_keeps_0_and_1():
    a, b, c = PARAMETERS[0]
    p = np.concatenate([np.geomspace(1e-4, 0.5, 300), 1.0 - np.geomspace(1e-4, 0.5, 300)]).astype(np.float32)
    log_odds = c + a * np.log(p) - b * np.log1p(-p)
    assert mapped(TRUE, p) == pytest.approx(1.0 / (1.0 + np.exp(-log_odds)), rel=2e-2)
    assert mapped(TRUE, [0.0, 1.0]).tolist() == [0.0, 1.0]


def test_the_maps_are_monotonic():
    p = np.linspace(0.0, 1.0, 20_001, dtype=np.float32)
    assert (np.diff(mapped(TRUE, p)) >= 0.0).all()


def test_cells_hidden_for_long_have_their_own_map():
    seen_as, hidden_as = (1.0 / (1.0 + np.exp(-c + (a - b) * np.log(2.0))) for a, b, c in PARAMETERS)
    forecast, hidden_s = np.full((2, 2, 2), 0.5, np.float32), np.array([[0.0, 0.9], [1.1, np.inf]])
    TRUE.apply(forecast, hidden_s)
    assert forecast == pytest.approx(np.array([[[seen_as] * 2, [hidden_as] * 2]] * 2), rel=1e-3)


def test_both_maps_are_fitted_to_cells_that_come_into_view():
    """The left half is hidden for two of three seconds, with another true map."""
    draw = np.random.default_rng(0)
    said = np.exp(draw.uniform(np.log(1e-3), np.log(0.97), GRID.shape)).astype(np.float32)
    left, frames = np.zeros(GRID.shape, bool), []
    left[:, :20] = True
    hidden_s = np.zeros(GRID.shape)
    for n in range(600):
        visible = ~left | (n % 24 >= 16)
        often = np.where(hidden_s < 1.0, *(mapped(TRUE, said, s).reshape(GRID.shape) for s in (0.0, 2.0)))
        frames.append(frame_of((draw.random(GRID.shape) < often) & visible, visible))
        hidden_s = np.where(visible, 0.0, hidden_s + PERIOD_S)
    learned = calibration(fit_calibration([(Crystal([said] * 600), frames, 1)]))
    at = np.array([0.02, 0.3, 0.9], np.float32)
    for age in (0.0, 2.0):
        assert mapped(learned, at, age) == pytest.approx(mapped(TRUE, at, age), rel=0.25)
    assert mapped(learned, at, 2.0)[0] > 1.5 * mapped(learned, at, 0.0)[0]


def test_a_step_has_the_parameters_of_its_time_and_between_two_times_their_mean():
    shifts = [-1.0, 0.0, 1.0, 3.0]  # at 0.25, 0.5, 1 and 2 s
    parameters = np.array([[[1.0, 1.0, shift]] * 2 for shift in shifts])
    forecast = np.full((20, 1, 1), 0.5, np.float32)
    calibration(parameters).apply(forecast, np.zeros((1, 1)))
    log_odds = np.log(forecast / (1.0 - forecast)).ravel()
    assert log_odds[[2, 4, 8, 16, 12, 1, 19]] == pytest.approx([*shifts, 2.0, -1.0, 3.0], abs=1e-2)


def test_a_forecast_that_is_soon_out_of_date_has_a_map_for_each_time():
    """Every second all cells are drawn again, a fifth of them occupied; the forecast is that nothing changes."""
    draw, steps, held = np.random.default_rng(3), round(2.0 / PERIOD_S), round(1.0 / PERIOD_S)
    drawn = [draw.random(GRID.shape) < 0.2 for _ in range(60)]
    frames = [frame_of(occupied) for occupied in drawn for _ in range(held)]
    said = [np.where(frame.occupied, 0.8, 0.05).astype(np.float32) for frame in frames]
    learned = mapped(calibration(fit_calibration([(Crystal(said), frames, steps)])), np.full(steps + 1, 0.8))
    assert learned[2] > 0.7
    assert learned[-1] == pytest.approx(0.2, abs=0.03)


def test_weights_of_version_0_2_have_one_map_for_all_steps():
    card = SimpleNamespace(tracker="kalman")
    old = Calibration.of(SimpleNamespace(arrays={"calibration": PARAMETERS}, card=card), PERIOD_S)
    p = np.full(20, 0.5, np.float32)
    assert (mapped(old, p) == mapped(TRUE, p)[0]).all()
    with pytest.raises(WeightsError, match=r"'calibration' is \(3,\), expected \(4, 2, 3\); train again"):
        Calibration.of(SimpleNamespace(arrays={"calibration": PARAMETERS[0]}, card=card), PERIOD_S)


def test_values_that_are_not_probabilities_are_mapped_to_probabilities():
    odd = mapped(TRUE, [-0.5, 1.5, np.nan, np.inf])
    assert ((odd >= 0.0) & (odd <= 1.0)).all()


@pytest.mark.parametrize("parameters", [(np.nan, 1.0, 0.0), (-1.0, 1.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, np.inf)])
def test_hostile_parameters_give_one_clear_line(parameters):
    with pytest.raises(WeightsError, match=r"calibration .*train again"):
        calibration(np.array([(1.0, 1.0, 0.0), parameters], np.float32))


def test_a_fit_without_occupied_cells_gives_no_certain_forecast():
    """Without an occupied cell in training the probabilities are reduced and remain positive."""
    tracker, frames = scene(count=20)
    empty = [frame_of(np.zeros(GRID.shape, bool))] * len(frames)
    learned = calibration(fit_calibration([(tracker, empty, STEPS)]))
    low, high = mapped(learned, [0.01, 0.9]).tolist()
    assert 0.0 < low < high < 0.2


DATA = packaged_recording("leg_tracker").parents[1]
HELD_OUT = {
    "leg_tracker": f"{DATA}/leg_tracker/leg_tracker.mcap@75s-90s",
    "junction": f"{DATA}/junction/validation.tracks@0s-20s",
}


@pytest.mark.parametrize("site", HELD_OUT)
def test_the_shipped_weights_forecast_the_observed_number_of_returns(site):
    stream = open_stream(HELD_OUT[site])
    tracker = KalmanTracker(stream_of(stream, DATA / "weights" / "kalman" / f"{site}.toml"), PipelineSettings())
    frames, ahead = list(stream), round(1.0 / stream.period_s)
    said = came = 0.0
    for frame, later in zip(frames, frames[ahead:], strict=False):
        tracker.update(frame)
        forecast = tracker.predict(ahead).occupancy[ahead]
        unsure = later.visible & (forecast > 0.05) & (forecast < 0.5)
        said, came = said + forecast[unsure].sum(), came + later.occupied[unsure].sum()
    assert 0.6 < said / came < 1.6

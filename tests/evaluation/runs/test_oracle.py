"""The oracle is a ceiling: no forecast of the same scene has a lower log loss, except by chance."""

from dataclasses import replace

import numpy as np
import pytest

from gridtrack.common.grid import GridSpec
from gridtrack.common.raycast import cast_scan
from gridtrack.evaluation.runs.oracle import expected_grid, range_errors
from gridtrack.evaluation.scores.cells import CLIP
from gridtrack.recordings.stream import open_stream
from gridtrack.simulation.expected_scan import true_ranges

from scenes import truth_scene

GRID = GridSpec.parse(truth_scene.GRID)
NOISE_M = 0.06
DRAWS = 16


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    """The observations of a recording with range noise, and the oracle's forecast of each."""
    path = truth_scene.write_recording(tmp_path_factory.mktemp("recording") / "room.mcap", noise_m=NOISE_M)
    stream = open_stream(path, rate_hz=5)
    errors = range_errors(stream.observations(), len(stream))
    return [(one, expected_grid(one, stream.grid, errors)) for one in stream.observations()]


def cast(observation, ranges):
    """The occupied cells of a scan of the scene with `ranges`."""
    (scan,), (pose,), shape = observation.scans, observation.grid_T_sensor, observation.frame.visible.shape
    visible, occupied = np.zeros((2, *shape), np.bool_)
    cast_scan(replace(scan, ranges=ranges.astype(np.float32)), GRID, pose, visible, occupied)
    return visible, occupied


def noise_free_scan(observation, _):
    return cast(observation, true_ranges(observation.scans[0], observation.scene))[1].astype(float)


def cautious_noise_free_scan(observation, _):
    return np.where(noise_free_scan(observation, _), 0.8, 0.05)


def share_of_drawn_scans(observation, _):
    random = np.random.default_rng(observation.frame.stamp_ns)
    true = true_ranges(observation.scans[0], observation.scene)
    drawn = [cast(observation, true + NOISE_M * random.standard_normal(true.size)) for _ in range(DRAWS)]
    visible, occupied = np.sum(drawn, axis=0)
    return (occupied + 0.5) / (visible + 1.0)


def scaled_log_odds(factor, shift=0.0):
    def forecast(_, oracle):
        p = np.clip(oracle.astype(float), CLIP, 1.0 - CLIP)
        return 1.0 / (1.0 + np.exp(-(factor * np.log(p / (1.0 - p)) + shift)))

    return forecast


def log_losses(observation, forecast):
    """Sum of the log loss over the visible cells of a frame, and their number."""
    seen = observation.frame.visible
    p = np.clip(forecast[seen], CLIP, 1.0 - CLIP)
    return -np.log(np.where(observation.frame.occupied[seen], p, 1.0 - p)).sum()


@pytest.mark.parametrize(
    ("rival", "clearly"),
    [
        pytest.param(noise_free_scan, True, id="the exact scene"),
        pytest.param(cautious_noise_free_scan, True, id="the exact scene, less certain"),
        pytest.param(share_of_drawn_scans, True, id="drawn scans"),
        pytest.param(scaled_log_odds(1.3), True, id="sharper"),
        pytest.param(scaled_log_odds(0.75), True, id="flatter"),
        pytest.param(scaled_log_odds(1.0, 0.3), True, id="more occupied"),
        pytest.param(scaled_log_odds(1.0, -0.3), True, id="less occupied"),
        pytest.param(scaled_log_odds(1.03), False, id="almost the same"),
    ],
)
def test_no_forecast_that_knows_the_scene_has_a_lower_log_loss(frames, rival, clearly):
    excess = np.array([log_losses(o, rival(o, oracle)) - log_losses(o, oracle) for o, oracle in frames])
    error = excess.std(ddof=1) / np.sqrt(len(excess))
    assert excess.mean() > -3.0 * error
    if clearly:
        assert excess.mean() > 2.0 * error


def test_its_probabilities_are_the_frequencies_of_occupied_cells(frames):
    seen = [(oracle[o.frame.visible], o.frame.occupied[o.frame.visible]) for o, oracle in frames]
    p, occupied = (np.concatenate(column) for column in zip(*seen, strict=True))
    for low, high in ((0.0, 0.02), (0.02, 0.2), (0.2, 0.4), (0.4, 0.6), (0.6, 0.8), (0.8, 0.98), (0.98, 1.0)):
        chosen = (p >= low) & (p <= high)
        error = np.sqrt((p * (1.0 - p))[chosen].sum()) / chosen.sum()
        assert chosen.sum() > 100
        assert occupied[chosen].mean() == pytest.approx(p[chosen].mean(), abs=4.0 * error + 1e-4)


def test_hidden_cells_are_the_true_outlines(frames):
    observation, oracle = frames[10]
    hidden = ~observation.frame.visible
    assert set(np.unique(oracle[hidden])) == {0.0, 1.0}


def test_the_forecast_of_a_frame_is_the_same_in_every_reading(frames, tmp_path):
    path = truth_scene.write_recording(tmp_path / "room.mcap", noise_m=NOISE_M)
    stream = open_stream(path, rate_hz=5)
    errors = range_errors(stream.observations(), len(stream))
    again = [expected_grid(one, stream.grid, errors) for one in list(stream.observations())[:3]]
    assert all(np.array_equal(one, oracle) for one, (_, oracle) in zip(again, frames, strict=False))

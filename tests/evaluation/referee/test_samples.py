"""Samples for viewing: round trip, and damaged files refused in one line."""

from dataclasses import replace

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from gridtrack.common.grid import GridSpec
from gridtrack.evaluation.referee import samples as samples_module
from gridtrack.evaluation.referee.referee import Schedule, ScoredForecast
from gridtrack.evaluation.referee.samples import SAMPLES, SamplesError, SampleWriter, kept_forecasts, read_samples
from gridtrack.evaluation.referee.strata import PARTS, region_maps_of
from gridtrack.evaluation.referee.targets import Target
from gridtrack.trackers.contract import Forecast, TrackedObject

from scenes.drawn_samples import write_samples
from scenes.scored_cells import frame

GRID = GridSpec(12, 0.25, (-1.0, 2.0))
STEPS, PERIOD_S = 15, 0.1
ORIGINS = np.array([[0.5, 2.25], [-0.75, 3.0]], np.float32)


def random_forecast(seed):
    """With states of hidden cells, cells in motion and an object."""
    rng = np.random.default_rng(seed)
    targets = []
    for n in range(STEPS + 1):
        stamp_ns = seed * 1_000_000_000 + n * 100_000_000
        seen = frame(rng.random(GRID.shape) < 0.6, rng.random(GRID.shape) < 0.3, stamp_ns)
        target = Target.of_frame(replace(seen, origins=ORIGINS))
        hidden, motion = rng.integers(2, 5, GRID.shape), rng.integers(0, 3, GRID.shape).astype(np.uint8)
        state = np.where(seen.visible, target.state, hidden).astype(np.uint8)
        targets.append(replace(target, state=state, motion=motion))
    box, velocity = rng.uniform(-3, 3, 5).astype(np.float32), rng.uniform(-2, 2, 2).astype(np.float32)
    tracked = TrackedObject(17, box, velocity, np.eye(4, dtype=np.float32))
    forecast = Forecast(rng.random((STEPS + 1, *GRID.shape), dtype=np.float32), objects=(tracked,))
    region_maps = region_maps_of(rng.integers(0, 3, GRID.shape).astype(np.uint8), GRID, ORIGINS)
    return ScoredForecast(forecast, tuple(targets), region_maps, np.zeros(GRID.shape, np.uint8))


@pytest.fixture
def written(tmp_path):
    written_forecasts = [random_forecast(seed) for seed in (1, 2, 3)]
    with SampleWriter(tmp_path / SAMPLES, GRID, PERIOD_S, STEPS) as writer:
        for scored in written_forecasts:
            writer.add(scored)
    return tmp_path / SAMPLES, written_forecasts


def test_samples_survive_a_round_trip(written):
    path, written_forecasts = written
    samples = list(read_samples(path))
    assert [s.stamp_ns for s in samples] == [m.stamp_ns for m in written_forecasts]
    for sample, scored in zip(samples, written_forecasts, strict=True):
        assert sample.grid == GRID
        assert sample.horizons_s == (0.5, 1.0)
        assert np.array_equal(sample.visible, scored.frames[0].visible)
        assert np.array_equal(sample.occupied, scored.frames[0].occupied)
        assert np.array_equal(sample.origins, ORIGINS)
        for i, step in enumerate((5, 10)):
            assert np.array_equal(sample.observed_visible[i], scored.frames[step].visible)
            assert np.array_equal(sample.observed_occupied[i], scored.frames[step].occupied)
            assert np.abs(sample.forecast[i] - scored.forecast.occupancy[step]).max() <= 0.5 / 255 + 1e-6
            target = scored.targets[step]
            assert np.array_equal(sample.state[i], target.state)
            expected = target.frame.visible & scored.region_maps.dynamic & (target.motion != PARTS.index("standing"))
            assert np.array_equal(sample.in_motion[i], expected)
        (kept,), (tracked,) = sample.objects, scored.forecast.objects
        assert kept.track == 17
        assert np.allclose(kept.box, tracked.box, atol=1e-5)
        assert np.allclose(kept.velocity, tracked.velocity, atol=1e-5)


def test_an_earlier_file_has_the_states_of_visible_cells_alone(written, monkeypatch):
    path, written_forecasts = written
    everything = samples_module._messages
    old = ("/input", "/came", "/forecast", "/sensors")
    monkeypatch.setattr(samples_module, "_messages", lambda path: (m for m in everything(path) if m[0].startswith(old)))
    sample = next(iter(read_samples(path)))
    frame = written_forecasts[0].frames[5]
    assert sample.in_motion is None
    assert np.array_equal(sample.state[0] < 2, frame.visible)
    assert np.array_equal(sample.state[0] == 1, frame.occupied)
    assert sample.objects == ()


def test_foxglove_finds_grids_with_x_along_columns_and_y_along_rows(written):
    path, written_forecasts = written
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        schema, channel, _, grid = next(reader.iter_decoded_messages(topics=["/input"]))
    assert (schema.name, channel.topic) == ("foxglove.Grid", "/input")
    assert (grid.pose.position.x, grid.pose.position.y, grid.column_count) == (-1.0, 2.0, 12)
    assert [field.name for field in grid.fields] == ["visible", "occupied", "shade"]
    row, column = 7, 2
    offset = row * grid.row_stride + column * grid.cell_stride
    assert (grid.data[offset] == 255) == written_forecasts[0].frames[0].visible[row, column]


def test_a_run_shorter_than_every_sample_horizon_keeps_its_input(tmp_path):
    with SampleWriter(tmp_path / SAMPLES, GRID, PERIOD_S, steps=2) as writer:
        writer.add(random_forecast(1))
    (sample,) = read_samples(tmp_path / SAMPLES)
    assert sample.horizons_s == ()
    assert sample.forecast.shape == (0, 12, 12)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda cloud: setattr(cloud, "point_stride", 24), "robots with other fields than x, y, vx"),
        (lambda cloud: cloud.fields.pop(), "robots with other fields than x, y, vx"),
        (lambda cloud: setattr(cloud, "data", cloud.data[:-4]), "cannot be read as samples"),
        (lambda cloud: setattr(cloud, "data", b"\xff" * len(cloud.data)), "a time that is not finite"),
    ],
)
def test_paths_of_robots_of_another_form_are_refused_in_one_line(tmp_path, monkeypatch, change, why):
    written_message = samples_module._robots_message

    def changed(*arguments):
        message = written_message(*arguments)
        change(message)
        return message

    monkeypatch.setattr(samples_module, "_robots_message", changed)
    write_samples(tmp_path / SAMPLES)
    with pytest.raises(SamplesError, match=why):
        list(read_samples(tmp_path / SAMPLES))


@pytest.mark.parametrize("kept", [0.2, 0.6, 0.95])
def test_a_cut_file_is_refused_in_one_line(written, kept):
    path, _ = written
    content = path.read_bytes()
    path.write_bytes(content[: int(kept * len(content))])
    with pytest.raises(SamplesError, match=r"forecasts\.mcap: cannot be read as samples") as refused:
        list(read_samples(path))
    assert "\n" not in str(refused.value)


def test_another_file_is_refused(tmp_path):
    (tmp_path / SAMPLES).write_bytes(b"not an mcap file at all, but long enough to look at")
    with pytest.raises(SamplesError):
        list(read_samples(tmp_path / SAMPLES))
    with pytest.raises(SamplesError):
        list(read_samples(tmp_path / "missing.mcap"))


@pytest.mark.parametrize(("frames", "expected"), [(30, 0), (36, 1), (60, 25), (1000, 40)])
def test_the_kept_forecasts_are_evenly_spaced_and_bounded(frames, expected):
    schedule = Schedule(frames, STEPS, every=1)
    kept = sorted(kept_forecasts(schedule))
    assert len(kept) == expected
    if kept:
        assert (kept[0], kept[-1]) == (0, schedule.expected - 1)

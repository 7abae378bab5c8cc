"""The kalman tracker on scenes whose truth is known: a laser in a corner, and round people who walk past it."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

pytest.importorskip("filterpy")
from gridtrack.common.errors import RecordingError, WeightsError
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec, with_neighbours
from gridtrack.common.raycast import cast_scan
from gridtrack.common.scan import Scan
from gridtrack.trackers.contract import FitOutput, StreamSpec, StretchScore
from gridtrack.trackers.model_free import KalmanTracker, tuning
from gridtrack.trackers.model_free.calibration import IDENTITY
from gridtrack.trackers.model_free.settings import ModelFreeSettings, PipelineSettings
from gridtrack.trackers.weights import Card, read_card, save_weights

GRID = GridSpec(60, 0.1, (0.0, -3.0))
PERIOD_S = 0.1
RADIUS_M = 0.2
WALL = (2.0, 4.0, 0.15)
"""Centre and radius of a pillar that stands in the background."""
GLIDING = np.zeros((31, 31), np.float32)
"""The life table of returns that never stay."""
OPEN = {
    "rate": np.full(GRID.shape, 1e-3, np.float32),
    "solid": np.zeros(GRID.shape, np.float32),
    "calibration": IDENTITY,
}
"""The map of a hall with nothing in it."""


def frame_of(people: list[tuple[float, float]], step: int = 0, wall: bool = False) -> GridFrame:
    """What a laser at the origin sees of discs at the given places, and of the pillar."""
    angles = -np.pi / 2 + np.arange(512) * np.pi / 511
    beams = np.stack([np.cos(angles), np.sin(angles)], 1)
    ranges = np.full(512, np.inf)
    for x, y, radius in [(x, y, RADIUS_M) for x, y in people] + ([WALL] if wall else []):
        along = beams @ np.array([x, y])
        inside = radius**2 - (x * x + y * y - along**2)
        hit = (inside > 0) & (along > 0)
        ranges[hit] = np.minimum(ranges[hit], along[hit] - np.sqrt(inside[hit]))
    visible, occupied = np.zeros(GRID.shape, bool), np.zeros(GRID.shape, bool)
    scan = Scan(0, ranges.astype(np.float32), -np.pi / 2, np.pi / 511, 0.02, 6.0)
    cast_scan(scan, GRID, SE2(), visible, occupied)
    points = GRID.cell_centres(occupied)
    origin = np.zeros((1, 2), np.float32)
    return GridFrame(step * 100_000_000, visible, occupied, SE2(), origin, points, np.zeros(len(points), np.uint8))


def card(**settings) -> Card:
    return Card(
        tracker="kalman",
        site="hall",
        grid=str(GRID),
        period_s=PERIOD_S,
        seed=0,
        command="",
        train=(),
        settings=settings,
    )


@pytest.fixture
def weights(tmp_path):
    """An open hall with nothing in it; the people here are discs that glide, and their velocity lasts."""
    path = tmp_path / "hall.toml"
    save_weights(path, card(velocity_memory_s=50.0), OPEN | {"dwell": GLIDING})
    return path


@pytest.fixture
def tracker(weights):
    return KalmanTracker(StreamSpec(GRID, PERIOD_S, "hall", weights=weights), PipelineSettings())


def walk(start, velocity, steps):
    return [(start[0] + velocity[0] * PERIOD_S * n, start[1] + velocity[1] * PERIOD_S * n) for n in range(steps)]


def watch(tracker, *paths):
    """Show the people who walk along `paths`; the forecast objects after each frame."""
    seen = []
    for step, people in enumerate(zip(*paths, strict=True)):
        tracker.update(frame_of(list(people), step))
        seen.append(tracker.predict(0).objects)
    return seen


def nearest(objects, place):
    return min(objects, key=lambda one: np.hypot(*(one.box[:2] - np.array(place))))


@pytest.mark.parametrize("velocity", [(1.0, 0.0), (0.0, 1.0), (-0.5, -0.8), (0.0, 0.0)])
def test_velocity_is_known_after_a_second(tracker, velocity):
    path = walk((3.0, -velocity[1]), velocity, 21)
    seen = watch(tracker, path)
    assert all(len(objects) == 1 for objects in seen[5:])
    errors = np.array([objects[0].velocity - np.array(velocity) for objects in seen[11:]])
    assert np.sqrt((errors**2).mean()) < 0.2


@pytest.mark.parametrize("every", [2, 3])
def test_missed_frames_are_bridged(tracker, every):
    path = walk((3.0, -1.5), (0.0, 1.2), 37)
    for step in range(0, 25, every):
        tracker.update(frame_of([path[step]], step))
    objects = tracker.predict(0).objects
    assert len(objects) == 1
    assert objects[0].velocity == pytest.approx((0.0, 1.2), abs=0.15)
    ahead = tracker.predict(10).occupancy[10]
    came = frame_of([path[34]]).occupied
    assert ahead[came].mean() > 4 * ahead[with_neighbours(frame_of([path[24]]).occupied)].mean()


@pytest.mark.parametrize("velocity", [(0.8, 0.0), (0.0, 0.8), (-0.6, 0.6)])
def test_the_forecast_leads_the_object_to_where_it_will_be(tracker, velocity):
    path = walk((3.0, -velocity[1]), velocity, 31)
    watch(tracker, path[:21])
    occupancy = tracker.predict(10).occupancy
    for step in (5, 10):
        came = frame_of([path[20 + step]])
        rows, columns = np.nonzero(came.occupied)
        mass = occupancy[step] - occupancy[step].min()
        centre = np.array([(mass.sum(0) * np.arange(60)).sum(), (mass.sum(1) * np.arange(60)).sum()]) / mass.sum()
        assert np.hypot(centre[0] - columns.mean(), centre[1] - rows.mean()) < 2.0  # cells; it moved by 8 of them


def test_a_forecast_grows_more_uncertain_and_stays_a_probability(tracker):
    watch(tracker, walk((3.0, -1.0), (0.0, 1.0), 20))
    occupancy = tracker.predict(10).occupancy
    assert occupancy.dtype == np.float32
    assert occupancy.min() >= 0.0
    assert occupancy.max() <= 1.0
    assert (np.diff(occupancy[2:].max(axis=(1, 2))) < 0).all()


def test_an_object_keeps_its_identity_through_a_full_occlusion(tracker):
    standing, passing = [(1.5, 0.0)] * 45, walk((3.5, -2.0), (0.0, 0.9), 45)
    hidden = [step for step in range(45) if not _sees(standing[step], passing[step])]
    assert 4 <= len(hidden) <= 20
    identities = []
    for step, objects in enumerate(watch(tracker, standing, passing)):
        if step >= 5:
            one = nearest(objects, passing[step])
            identities.append(one.track)
            assert np.hypot(*(one.box[:2] - np.array(passing[step]))) < 0.6
    assert len(set(identities)) == 1


def _sees(occluder, place) -> bool:
    alone, both = frame_of([occluder]), frame_of([occluder, place])
    return int(both.occupied.sum()) > int(alone.occupied.sum())


def test_a_hidden_object_goes_on_being_forecast_and_a_vanished_one_does_not(tracker):
    standing, passing = [(1.5, 0.0)] * 45, walk((3.5, -2.0), (0.0, 0.9), 45)
    first_hidden = next(step for step in range(45) if not _sees(standing[step], passing[step]))
    watch(tracker, standing[: first_hidden + 3], passing[: first_hidden + 3])
    column, row = (np.array(passing[first_hidden + 3]) - np.array(GRID.origin)) // GRID.cell_m
    about = np.s_[1, int(row) - 4 : int(row) + 5, int(column) - 4 : int(column) + 5]
    assert tracker.predict(1).occupancy[about].sum() > 1.0
    for step in range(10):
        tracker.update(frame_of([], step))
    assert tracker.predict(1).objects == ()
    assert tracker.predict(1).occupancy.max() < 0.01


def test_two_people_apart_keep_their_identities(tracker):
    one, other = walk((2.0, -2.0), (0.2, 0.8), 40), walk((4.0, 2.0), (0.0, -0.8), 40)
    seen = watch(tracker, one, other)[5:]
    for path in (one, other):
        tracks = {nearest(objects, place).track for objects, place in zip(seen, path[5:], strict=True)}
        assert len(tracks) == 1
    assert {len(objects) for objects in seen} == {2}


def test_a_wall_that_flickers_bears_no_track(tmp_path):
    rate, solid = OPEN["rate"].copy(), OPEN["solid"].copy()
    pillar = frame_of([], wall=True).occupied
    rate[pillar] = 0.9
    solid[with_neighbours(pillar)] = 1.0
    path = tmp_path / "hall.toml"
    save_weights(path, card(), OPEN | {"rate": rate, "solid": solid, "dwell": GLIDING})
    tracker = KalmanTracker(StreamSpec(GRID, PERIOD_S, "hall", weights=path), PipelineSettings())
    for step in range(20):
        tracker.update(frame_of([], step, wall=step % 3 > 0))
    forecast = tracker.predict(5)
    assert forecast.objects == ()
    assert forecast.occupancy[5][pillar] == pytest.approx(0.9)


def test_who_stands_is_forecast_to_stand_as_the_life_table_says(tmp_path):
    table = GLIDING.copy()
    table[20:] = 0.75
    path = tmp_path / "hall.toml"
    save_weights(path, card(sink_above=0.99), OPEN | {"dwell": table})
    tracker = KalmanTracker(StreamSpec(GRID, PERIOD_S, "hall", weights=path), PipelineSettings())
    frame = frame_of([(3.0, 1.0)])
    for step in range(30):
        tracker.update(frame)
        if step == 10:
            at_first = tracker.predict(10).occupancy[10][frame.occupied].mean()
    assert tracker.predict(10).occupancy[10][frame.occupied].mean() > at_first + 0.2


def test_now_is_forecast_as_it_was_seen(tracker):
    watch(tracker, walk((3.0, -1.0), (0.0, 1.0), 5))
    frame = frame_of([(3.0, -0.5)])
    tracker.update(frame)
    assert np.array_equal(tracker.predict(3).occupancy[0][frame.visible], frame.occupied[frame.visible])


def test_predicting_changes_nothing_and_a_reset_forgets(tracker):
    path = walk((3.0, -1.0), (0.3, 0.7), 20)

    def forecasts(ask: bool):
        tracker.reset(seed=1)
        for step, place in enumerate(path):
            tracker.update(frame_of([place], step))
            if ask:
                tracker.predict(7)
        return tracker.predict(5).occupancy

    once = forecasts(ask=False)
    watch(tracker, walk((5.0, 1.0), (-1.0, 0.0), 9))
    assert np.array_equal(once, forecasts(ask=True))


def test_an_empty_stream_is_forecast_as_background(tracker):
    nothing = np.zeros(GRID.shape, bool)
    no_points = np.empty((0, 2), np.float32)
    tracker.update(GridFrame(0, nothing, nothing, SE2(), no_points, no_points, np.empty(0, np.uint8)))
    occupancy = tracker.predict(2).occupancy
    assert occupancy.shape == (3, *GRID.shape)
    assert occupancy.max() < 2e-3


# Weights and fit


def test_without_weights_it_says_how_to_make_them():
    with pytest.raises(WeightsError, match="gridtrack train kalman"):
        KalmanTracker(StreamSpec(GRID, PERIOD_S, "hall"), PipelineSettings())


@pytest.mark.parametrize(
    ("name", "spoilt", "message"),
    [
        ("rate", np.nan, "'rate' is not finite"),
        ("solid", -0.1, "'solid' does not hold probabilities"),
        ("dwell", 1.5, "'dwell' does not hold probabilities"),
    ],
)
def test_weights_whose_maps_are_no_probabilities_are_refused(tmp_path, name, spoilt, message):
    arrays = OPEN | {"dwell": GLIDING}
    save_weights(tmp_path / "hall.toml", card(), arrays | {name: np.full_like(arrays[name], spoilt)})
    with pytest.raises(WeightsError, match=message):
        KalmanTracker(StreamSpec(GRID, PERIOD_S, "hall", weights=tmp_path / "hall.toml"), PipelineSettings())


def test_weights_with_a_setting_that_is_not_one_are_refused(tmp_path):
    path = tmp_path / "hall.toml"
    save_weights(path, card(link=1.0), OPEN | {"dwell": GLIDING})
    with pytest.raises(WeightsError, match="link_m"):
        KalmanTracker(StreamSpec(GRID, PERIOD_S, "hall", weights=path), PipelineSettings())


class Source:
    """Frames of a stretch, from memory."""

    name, sha256, grid, period_s, site, classes = "hall@0s-3s", "0" * 64, GRID, PERIOD_S, "hall", ()

    def __init__(self):
        self.frames = [frame_of([place], step) for step, place in enumerate(walk((3.0, -1.5), (0.0, 1.0), 30))]

    def __iter__(self):
        return iter(self.frames)

    def __len__(self):
        return len(self.frames)


def test_fit_finds_the_settings_that_score_best_and_keeps_those_that_were_given(tmp_path, monkeypatch):
    monkeypatch.setattr(tuning, "TRIALS", 25)
    asked = []

    def score(tracker, source, steps):
        settings = tracker._settings
        asked.append(settings)
        far = abs(np.log(settings.acceleration / 0.3))
        loss = np.full(steps + 1, far)
        return StretchScore({"moving": 1 - loss, "visible": 1 - loss}, {"moving": loss, "visible": loss})

    paths = [tmp_path / run / "hall.toml" for run in ("one", "two")]
    for path in paths:
        out = FitOutput(path, "gridtrack train kalman", 3, path.parent / "log", report=lambda line: None)
        KalmanTracker.fit([Source()], [Source()], score, out, ModelFreeSettings(link_m=0.77))
    one, two = (read_card(path) for path in paths)
    assert one == two
    assert all(settings.link_m == 0.77 for settings in asked)
    assert asked[1].dwell_speed == tuning.STARTS[1].dwell_speed
    losses = [abs(np.log(settings.acceleration / 0.3)) for settings in asked[:25]]
    assert one.settings["acceleration"] == asked[int(np.argmin(losses))].acceleration
    assert len(set(losses)) > 20
    assert any(a != b for a, b in pairwise(losses))
    tracker = KalmanTracker(StreamSpec(GRID, PERIOD_S, "hall", weights=paths[0]), PipelineSettings(acceleration=0.2))
    assert tracker._settings == ModelFreeSettings(**one.settings | {"acceleration": 0.2})


def fit_hall(tmp_path, score, told):
    out = FitOutput(tmp_path / "hall.toml", "gridtrack train kalman", 3, tmp_path / "log", report=told.append)
    KalmanTracker.fit([Source()], [Source()], score, out, ModelFreeSettings())


def test_a_stretch_on_which_nothing_can_be_scored_is_told_in_one_line(tmp_path):
    def score(tracker, source, steps):
        undefined = np.full(steps + 1, np.nan)
        return StretchScore({"moving": undefined, "visible": undefined}, {"moving": undefined, "visible": undefined})

    with pytest.raises(RecordingError, match=r"mean F1 is not defined on what is trained on: .*name a longer stretch"):
        fit_hall(tmp_path, score, [])
    assert not (tmp_path / "hall.toml").exists()


def test_an_interrupted_search_tells_the_best_so_far(tmp_path, caplog):
    told, values = [], iter([0.3, 0.5, 0.4])

    def score(tracker, source, steps):
        try:
            flat = np.full(steps + 1, next(values))
        except StopIteration:
            raise KeyboardInterrupt from None
        return StretchScore({"moving": flat, "visible": flat}, {"moving": flat, "visible": flat})

    with pytest.raises(KeyboardInterrupt):
        fit_hall(tmp_path, score, told)
    assert told[-1].startswith("interrupted; best of 3 trials, mean F1 0.50000: unforeseen_share=0.541,")
    assert not caplog.records


def test_a_smoother_that_begins_anew_is_counted_until_the_reset(weights):
    gtsam = pytest.importorskip("gtsam")
    from gridtrack.trackers.model_free import FactorGraphTracker
    from gridtrack.trackers.model_free.motion.factor_graph import LAG_S

    save_weights(weights, card().model_copy(update={"tracker": "factor-graph"}), OPEN | {"dwell": GLIDING})
    tracker = FactorGraphTracker(StreamSpec(GRID, PERIOD_S, "hall", weights=weights), PipelineSettings())
    path = walk((3.0, -1.0), (0.0, 1.0), 12)
    watch(tracker, path[:10])
    assert tracker.recoveries == 0
    knows_nothing = gtsam.IncrementalFixedLagSmoother(LAG_S)
    tracker.tracks[0].estimator.estimators[0]._smoother = knows_nothing
    seen = watch(tracker, path[10:])
    assert tracker.recoveries == 1
    assert seen[-1][0].track == 0
    tracker.reset(seed=0)
    assert tracker.recoveries == 0

"""Forecasts of a sensor that moves: scored in the window in which they were made, against scans cast into it."""

from dataclasses import replace

import numpy as np
import pytest

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.common.scan import Scan
from gridtrack.evaluation.referee.kinds import KindsOfWindow, Regions, observed_kinds, regions_of
from gridtrack.evaluation.referee.motion import OnceFree
from gridtrack.evaluation.referee.referee import KeptMoments, Moment, Schedule, moments, scored_forecasts
from gridtrack.evaluation.referee.strata import AGES_S, CELL_KINDS, PARTS, STRATA, LastSeen
from gridtrack.evaluation.referee.targets import NOT_SCORED, SEEN_FREE, SEEN_OCCUPIED
from gridtrack.evaluation.runs.oracle import Oracle
from gridtrack.evaluation.scores.beam_error import BEAM_ERROR, BINS, median_size
from gridtrack.evaluation.scores.cells import Tally, count_cells
from gridtrack.evaluation.scores.definition import TrialFacts
from gridtrack.evaluation.scores.f1 import f1_of
from gridtrack.evaluation.scores.thresholds import half
from gridtrack.recordings.observation import Observation
from gridtrack.recordings.stream import open_stream
from gridtrack.trackers.baselines import PersistenceTracker
from gridtrack.trackers.contract import stream_of

from scenes import drive

GRID = GridSpec(5, 1.0)
NOTHING = np.zeros((0, 2), np.float32)
DYNAMIC = CELL_KINDS.index("dynamic")


class Source:
    """A FrameSource of hand-drawn frames."""

    name, sha256, site, classes, grid, period_s = "drawn", "", "here", (), GRID, 1.0


REGIONS = Regions(GRID, KindsOfWindow(np.full(GRID.shape, DYNAMIC, np.uint8)))


def drawn(rows, x=0.0, y=0.0):
    """A frame as text, the upper row first: # occupied, . free, blank unseen; its window lies at (x, y)."""
    cells = np.array([list(row) for row in reversed(rows)])
    return GridFrame(0, cells != " ", cells == "#", SE2(x, y), np.zeros((1, 2), np.float32), NOTHING, NOTHING[:, 0])


def states(target):
    """The states of a target as text, the upper row first."""
    text = {SEEN_FREE: ".", SEEN_OCCUPIED: "#", NOT_SCORED: " "}
    return ["".join(text[state] for state in row) for row in target.state[::-1].tolist()]


def moment(observation, earlier=None):
    return Moment(observation, OnceFree(earlier), Source(), REGIONS)


BEFORE = drawn(["....#", "....#", "....#", "...##", "    #"])
AFTER_A_STEP_RIGHT = drawn(["...# ", "...# ", "...# ", "..## ", "   # "], x=1.0)


def test_a_wall_that_stays_while_the_window_moves_by_a_cell_is_where_it_was_forecast():
    now, then = moment(Observation(BEFORE)), moment(Observation(AFTER_A_STEP_RIGHT))
    assert states(now.target_in(now.window, now.region_maps)) == ["....#", "....#", "....#", "...##", "    #"]
    target = then.target_in(now.window, now.region_maps)
    assert states(target) == [" ...#", " ...#", " ...#", " ..##", "    #"]
    tally = count_cells(BEFORE.occupied[None].astype(np.float32), [target], now.region_maps)
    assert tally.confusion(half(0).bins)[0, 0].tolist() == [6, 0, 0, 11], "every cell of the wall is a hit"


def test_a_window_that_moved_up_and_left():
    then = moment(Observation(drawn(["     ", " ### ", " ... ", " ... ", "     "], x=-1.0, y=1.0)))
    assert states(then.target_in(SE2(), REGIONS.of(Observation(BEFORE)))) == [
        "###  ",
        "...  ",
        "...  ",
        "     ",
        "     ",
    ]


def test_cells_of_the_forecasts_window_that_have_left_the_frames_window_are_scored_where_a_beam_reaches_them():
    sensor = SE2(-7.5, 0.5)
    scan = Scan(0, np.array([6.0], np.float32), 0.0, 0.0, 0.0, 30.0, world_T_sensor=sensor)
    then = moment(Observation(drawn(["     "] * 5, x=-8.0), (scan,), (SE2(0.5, 0.5),)))
    target = then.target_in(SE2(), REGIONS.of(Observation(BEFORE)))
    assert states(target) == ["     ", ".#   ", "     ", "     ", "     "]


def test_a_return_is_in_motion_where_its_place_in_the_world_was_free_a_second_before():
    earlier = Observation(drawn([".....", "...#.", ".....", ".....", "....."]))
    now = moment(Observation(drawn([".....", "..#..", ".....", ".....", "....."], x=1.0)), earlier)
    motion = now.target_in(SE2(), now.region_maps).motion
    assert PARTS[motion[3, 3]] == "standing", "the cell of the world is the one that was occupied"
    passer = moment(Observation(drawn([".....", ".....", ".....", "..#..", "....."], x=1.0)), earlier)
    assert PARTS[passer.target_in(SE2(), passer.region_maps).motion[1, 3]] == "in-motion"


def test_the_parts_of_a_window_that_stands_follow_its_regions_which_change_with_time():
    """A cell is static in one block of time and dynamic in another; the sensor, and so the window, stand still."""
    now = moment(Observation(BEFORE), Observation(drawn(["....."] * 5)))
    static = Regions(GRID, KindsOfWindow(np.full(GRID.shape, CELL_KINDS.index("static"), np.uint8)))
    assert now.target_in(SE2(), now.region_maps).motion.any()
    assert not now.target_in(SE2(), static.of(Observation(BEFORE))).motion.any()


def test_the_age_of_a_cell_belongs_to_its_place_in_the_world():
    seen = LastSeen()
    seen.add(replace(drawn(["#    ", "     ", "     ", "     ", "     "]), stamp_ns=0), GRID.cell_m)
    seen.add(replace(drawn(["     "] * 5, x=-1.0), stamp_ns=1_000_000_000), GRID.cell_m)
    bands = seen.bands(1_000_000_000)
    assert bands[4, 1] == AGES_S.index(1.0)
    assert (np.delete(bands.reshape(-1), 4 * 5 + 1) == len(AGES_S)).all()


STEPS, EVERY = 15, 10


def scores(stream, tracker, regions=None, strata=("visible", "static", "dynamic", "in-motion", "standing")):
    """F1 (steps+1) by stratum at 0.5, and the counts."""
    regions = regions or regions_of(stream, strata)
    tally = Tally.empty(STEPS, regions.strata)
    schedule = Schedule(len(stream), STEPS, EVERY)
    for scored in scored_forecasts(tracker, moments(stream, regions), schedule, 0):
        tally.add(count_cells(scored.forecast.occupancy, scored.targets, scored.region_maps, scored.ages))
    f1 = f1_of(tally.confusion(half(STEPS, regions.strata).bins))
    return {name: f1[:, k] for k, name in enumerate(regions.strata)}, tally


def persistence(stream):
    return PersistenceTracker(stream_of(stream), PersistenceTracker.Options())


@pytest.mark.parametrize("with_truth", [True, False])
def test_persistence_of_a_static_scene_is_right_from_a_sensor_that_drives(tmp_path, with_truth):
    stream = open_stream(drive.write_recording(tmp_path / "d.mcap", 20, people=False, with_truth=with_truth))
    f1, tally = scores(stream, persistence(stream))
    confusion = tally.confusion(half(STEPS).bins)[:, 0]
    assert confusion[10, 0] / confusion[10, [0, 2]].sum() > 0.9, "walls that come into view were not seen before"
    assert (f1["visible"] > 0.93).all()


def test_beams_of_a_later_frame_start_where_the_sensor_is_by_then(tmp_path):
    stream = open_stream(drive.write_recording(tmp_path / "d.mcap", 20, people=False))
    delivered = moments(stream, regions_of(stream, STRATA))
    sizes, driven, windows = np.zeros(BINS), 0.0, set()
    facts = TrialFacts(stream.grid.cell_m, STEPS, STRATA, half(STEPS))
    for scored in scored_forecasts(persistence(stream), delivered, Schedule(len(stream), STEPS, EVERY), 0):
        now, later = (scored.targets[step].beams.paths.starts[0] for step in (0, 10))
        driven = max(driven, np.hypot(*(later - now)))
        sizes += BEAM_ERROR.count(scored, facts, None)[10, STRATA.index("visible"), 2:]
        windows.add((round(scored.reference_T_grid.x, 6), round(scored.reference_T_grid.y, 6)))
    assert driven > 3, "cells"
    assert windows <= {(round(frame.world_T_grid.x, 6), round(frame.world_T_grid.y, 6)) for frame in stream}
    assert len(windows) > 1
    assert median_size(sizes) < stream.grid.cell_m / 2, "of a static scene persistence knows most walls"


def test_the_oracle_of_a_drive_is_near_one_with_poses_that_are_perfect_and_with_noisy_ones(tmp_path):
    for name, noise in (("perfect", (0.0, 0.0)), ("noisy", (0.1, 0.02))):
        stream = open_stream(drive.write_recording(tmp_path / f"{name}.mcap", 12, pose_noise=noise))
        f1, _ = scores(stream, Oracle(KeptMoments(stream, regions_of(stream, STRATA))))
        assert (f1["visible"] > 0.97).all(), name
        assert (f1["in-motion"] > 0.97).all(), name


def test_scores_do_not_depend_on_where_the_worlds_of_the_poses_lie(tmp_path, monkeypatch):
    stream = open_stream(drive.write_recording(tmp_path / "d.mcap", 8))
    expected, tally = scores(stream, persistence(stream))
    elsewhere, scans = SE2(20 * drive.CELL_M, -7 * drive.CELL_M), stream.recording.scans
    moved = open_stream(tmp_path / "d.mcap")
    monkeypatch.setattr(
        moved.recording,
        "scans",
        lambda *span: (replace(one, world_T_sensor=elsewhere @ one.world_T_sensor) for one in scans(*span)),
    )
    found, counted = scores(moved, persistence(moved))
    assert found.keys() == expected.keys()
    different = np.abs(counted.cells - tally.cells).sum() / tally.cells.sum()
    assert different < 1e-3, "but for rounding"


@pytest.mark.parametrize(("noise", "in_static"), [((0.0, 0.0), 0.99), ((0.05, 0.01), 0.95), ((0.1, 0.02), 0.95)])
def test_walls_are_static_though_the_poses_have_errors_and_people_who_walk_are_not(tmp_path, noise, in_static):
    path = drive.write_recording(tmp_path / "d.mcap", 48, range_noise_m=0.03, pose_noise=noise, with_truth=False)
    stream = open_stream(path)
    kinds = observed_kinds(stream.observations(), stream.grid)
    counts = {"walls": np.zeros(3), "walkers": np.zeros(3)}
    for index, observation in enumerate(stream.observations()):
        window = observation.frame.world_T_grid
        centres = window.apply(stream.grid.cell_centres(observation.frame.occupied))
        found = kinds.at(window, observation.frame.stamp_ns)[observation.frame.occupied]
        people = [body.world_T_object for body in drive.scene(index).objects]
        away = [np.hypot(*(centres - [pose.x, pose.y]).T) > 0.6 for pose in people]
        counts["walls"] += np.bincount(found[np.all(away, axis=0)], minlength=3)
        counts["walkers"] += np.bincount(found[~away[0] | ~away[1]], minlength=3)
    walls, walkers = (counts[name] / counts[name].sum() for name in ("walls", "walkers"))
    assert walls[CELL_KINDS.index("static")] > in_static
    assert walls[CELL_KINDS.index("dynamic")] < 0.003
    assert walkers[CELL_KINDS.index("dynamic")] > 0.85

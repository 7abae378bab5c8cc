"""Beam errors: hand-computed beams, and cells found by sorting the crossings of grid lines instead of walking."""

import numpy as np
import pytest

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridSpec
from gridtrack.common.scan import Scan
from gridtrack.evaluation.referee.targets import crossing_beams, target_of
from gridtrack.evaluation.scores.beam_error import BEAM_ERROR, EDGES_M, expected_ranges, median_size
from gridtrack.recordings.observation import Observation

from scenes.scored_cells import DYNAMIC_CELL, counted, frame, region_maps, scored, values

SIZE = 40
GRID = GridSpec(SIZE, 0.5, (-5.0, -10.0))
EMPTY = frame(np.ones(GRID.shape), np.zeros(GRID.shape))


def scan_of(ranges, angle_min=0.0, angle_increment=0.0, range_max=30.0):
    return Scan(0, np.array(ranges, np.float32), angle_min, angle_increment, 0.1, range_max)


def observed(*scans_and_poses):
    scans, poses = zip(*scans_and_poses, strict=True)
    return Observation(EMPTY, scans, poses)


def row_of(probabilities, columns):
    """A forecast with these probabilities in columns of the row that a beam along x from the origin crosses."""
    p = np.zeros(GRID.shape, np.float32)
    p[20, columns] = probabilities
    return p


def ends_in(p, beams):
    """The expected range of each beam that crosses the window, in one forecast."""
    return expected_ranges(p[None], beams.paths, np.zeros((1, beams.ranges.size)))[0]


def measured(beams):
    return beams.ranges[~np.isnan(beams.ranges)]


ALONG_X = observed((scan_of([4.25]), SE2(0.25, 0.25)))
"""One beam from the middle of cell [20, 10] along x; it ends 4.25 m away, at the border of columns 18 and 19."""


def test_a_hand_computed_beam():
    beams = crossing_beams(ALONG_X, GRID)
    assert (beams.paths.starts, beams.ranges, beams.paths.ends) == (pytest.approx(np.array([[10.5, 20.5]])), 8.5, 29.5)
    found = {
        "a certain return, at the middle of its cell": row_of(1.0, 16),
        "half the beams go on": row_of([0.5, 1.0], [12, 22]),
        "three cells": row_of([0.1, 0.2, 1.0], [11, 12, 13]),
        "nothing: to where the beam leaves the window": row_of(0.0, 0),
        "behind the sensor, and beside the beam": row_of(1.0, 9) + np.roll(row_of(1.0, 16), 1, axis=0),
        "the sensor's own cell: half of the way out of it": row_of(1.0, 10),
    }
    ranges = [ends_in(p, beams)[0] for p in found.values()]
    assert ranges == pytest.approx([6.0, 7.0, 0.1 * 1.0 + 0.18 * 2.0 + 0.72 * 3.0, 29.5, 29.5, 0.25])


def test_a_beam_that_would_go_on_ends_at_the_sensors_maximum_range():
    beams = crossing_beams(observed((scan_of([4.25], range_max=8.0), SE2(0.25, 0.25))), GRID)
    assert ends_in(row_of(0.0, 0), beams)[0] == pytest.approx(16.0)


def test_every_valid_beam_that_crosses_the_window_counts_up_to_its_edge():
    scan = scan_of([np.inf, np.nan, -np.inf, 0.05, 29.0, 40.0, 4.0])
    beams = crossing_beams(observed((scan, SE2(0.25, 0.25))), GRID)
    assert measured(beams) == pytest.approx([29.5, 29.5, 29.5, 8.0]), "no return, and two beyond the window; one inside"
    outside = crossing_beams(observed((scan_of([3.0, 8.0, 40.0]), SE2(-10.0, 0.25)), (scan, SE2(0.25, 11.0))), GRID)
    assert measured(outside) == pytest.approx([16.0, 50.0]), "one ends before the window, and seven miss it"
    assert len(crossing_beams(Observation(EMPTY), GRID).ranges) == 0, "a frame without scans has none"


def by_crossings(p, start, direction, longest):
    """Expected range: the cells between sorted crossings of grid lines."""
    with np.errstate(divide="ignore", invalid="ignore"):
        lines = np.concatenate([(np.arange(SIZE + 1) - start[axis]) / direction[axis] for axis in (0, 1)])
    at = np.unique(np.concatenate([[0.0, longest], lines[(lines > 0) & (lines < longest)]]))
    middle = (at[:-1] + at[1:]) / 2
    column, row = np.floor(np.asarray(start)[:, None] + np.asarray(direction)[:, None] * middle).astype(int)
    inside = (column >= 0) & (column < SIZE) & (row >= 0) & (row < SIZE)
    own = p[row[inside], column[inside]].astype(float)
    reached = np.concatenate([[1.0], np.cumprod(1 - own)])
    return (reached[:-1] * own * middle[inside]).sum() + reached[-1] * at[1:][inside][-1]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("pose", [SE2(0.1, -0.4, 0.3), SE2(-8.0, 3.0, -0.2), SE2(2.0, 20.0, -1.6)], ids=str)
def test_beams_in_all_directions_agree_with_the_crossings_of_grid_lines(seed, pose):
    """From inside the window and from outside of it, through a forecast that is spread thin, and has certain cells."""
    rng = np.random.default_rng(seed)
    p = rng.beta(0.1, 4.0, GRID.shape).astype(np.float32)
    p[rng.random(GRID.shape) < 0.02] = 1.0
    scan = scan_of(rng.uniform(1.0, 25.0, 360), -np.pi, 2 * np.pi / 360)
    beams = crossing_beams(observed((scan, pose)), GRID)
    assert len(beams.ranges) > 5
    expected = [
        by_crossings(p, *one) for one in zip(beams.paths.starts, beams.paths.directions, beams.paths.ends, strict=True)
    ]
    assert ends_in(p, beams) == pytest.approx(expected, abs=1e-3)


def test_beams_in_forecasts_of_several_frames_end_as_in_each_alone():
    """Of a sensor at rest all at once; a beam that no frame measured is not followed."""
    rng = np.random.default_rng(0)
    p = rng.beta(0.1, 4.0, (3, *GRID.shape)).astype(np.float32)
    frames = rng.uniform(1.0, 25.0, (3, 360))
    frames[:, 7] = frames[1, 9] = np.nan
    several = [
        crossing_beams(observed((scan_of(one, -np.pi, 2 * np.pi / 360), SE2(0.1, -0.4))), GRID) for one in frames
    ]
    assert len({id(one.paths) for one in several}) == 1
    ranges = np.stack([one.ranges for one in several])
    found = expected_ranges(p, several[0].paths, ranges)
    assert np.flatnonzero(np.isnan(found).any(axis=0)).tolist() == [7]
    alone = np.stack([ends_in(one, beams) for one, beams in zip(p, several, strict=True)])
    np.testing.assert_array_equal(np.delete(found, 7, axis=1), np.delete(alone, 7, axis=1))


def test_beams_along_the_lines_of_the_grid_and_through_its_corners_stay_in_the_window():
    scan = scan_of([3.0] * 8, 0.0, np.pi / 4)
    beams = crossing_beams(observed((scan, SE2(0.0, 0.0)), (scan, SE2(0.25, 0.25))), GRID)
    ones = ends_in(np.ones(GRID.shape, np.float32), beams)
    assert ((ones > 0) & (ones <= 1)).all(), "the first cell that a beam has length in"


def test_errors_are_summed_over_all_beams_of_the_visible_cells():
    """A beam that ends early, one that ends late, and one that leaves the window where a return was forecast."""
    poses = SE2(0.25, 0.25), SE2(0.25, 2.25), SE2(0.25, 4.25)
    scans = observed(*((scan_of([range_m]), pose) for range_m, pose in zip([4.25, 2.0, np.inf], poses, strict=True)))
    target = target_of(scans, GRID, (), np.zeros(GRID.shape, np.uint8))
    forecast = sum(np.roll(row_of(1.0, column), rows, axis=0) for column, rows in ((16, 0), (20, 4), (26, 8)))
    maps = region_maps(np.full(GRID.shape, DYNAMIC_CELL))
    strata, errors = counted(BEAM_ERROR, scored(forecast[None], [target], maps), cell_m=GRID.cell_m)
    assert strata == ("visible",)
    assert errors["early"][0] == pytest.approx([1.25 + 14.75 - 8.0])
    assert errors["late"][0] == pytest.approx([3.0])
    assert errors.block("beams")[0].sum(axis=-1).tolist() == [3]
    found = values(BEAM_ERROR, errors)
    assert (found["mean"][0], found["bias"][0]) == (pytest.approx([11.0 / 3]), pytest.approx([-5.0 / 3]))
    low, high = (EDGES_M[np.nonzero(errors.block("beams")[0, 0])[0] + end] for end in (0, 1))
    assert ((low <= [1.25, 3.0, 6.75]) & (high > [1.25, 3.0, 6.75])).all()


@pytest.mark.parametrize("number", [1, 501, 4000])
def test_the_median_of_binned_errors_is_right_within_a_part_of_a_bin(number):
    errors = np.random.default_rng(number).lognormal(-1.0, 1.5, number)
    counts = np.histogram(errors, EDGES_M)[0].astype(float)
    assert median_size(counts) == pytest.approx(np.median(errors), rel=0.12)
    assert np.isnan(median_size(np.zeros_like(counts)))

"""The expected scan, against the frequencies in many drawn scans."""

from dataclasses import replace

import numpy as np
import pytest

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridSpec
from gridtrack.common.raycast import cast_scan
from gridtrack.common.scan import Scan
from gridtrack.simulation.expected_scan import MIN_ERRORS, ExpectedScan, RangeErrors, measure_range_errors, true_ranges

from scenes import truth_scene

GRID = GridSpec(40, 0.25, (-5.1, -1.05))
"""No surface of the scene is on a grid line, where rounding decides in which cell a beam ends."""
POSE = SE2(0.0, 0.0, np.pi / 2)


def noisy(true, random):
    """Ranges with normal errors, some invalid, some lost; a beam without a surface rarely returns."""
    ranges = true + 0.06 * random.standard_normal(true.size)
    ranges[random.random(true.size) < 0.03] = np.nan
    ranges[random.random(true.size) < 0.02] = np.inf
    clutter = np.isinf(true) & (random.random(true.size) < 0.1)
    return np.where(clutter, random.uniform(0.0, 8.0, true.size), ranges).astype(np.float32)


def cast(scan, grid, pose):
    visible, occupied = np.zeros((2, *grid.shape), np.bool_)
    cast_scan(scan, grid, pose, visible, occupied)
    return visible, occupied


def expected(scan, scene, errors, grid, pose):
    found = ExpectedScan.nothing(grid)
    found.add(scan, true_ranges(scan, scene), errors, grid, pose)
    return found


def test_the_probabilities_are_the_frequencies_in_many_scans():
    scan, scene, random = truth_scene.scan(13), truth_scene.scene(13), np.random.default_rng(1)
    scan = replace(scan, range_max=6.9)
    true = true_ranges(scan, scene)
    assert np.isinf(true).any(), "some beams have no surface within reach"
    draws = [replace(scan, ranges=noisy(true, random)) for _ in range(1500)]
    errors = measure_range_errors((draw, scene) for draw in draws)[scan.sensor]
    cast_draws = [cast(draw, GRID, POSE) for draw in draws]
    visible, occupied = (np.mean([one[i] for one in cast_draws], axis=0) for i in range(2))
    found = expected(scan, scene, errors, GRID, POSE)
    for frequency, probability in ((visible, 1.0 - found.unseen), (occupied, 1.0 - found.unoccupied)):
        spread = np.sqrt(probability * (1.0 - probability) / len(draws))
        # a band shares its errors, and not every beam of it has had all of them
        assert (np.abs(frequency - probability) < 5.0 * spread + 0.002).all()
    seen = visible > 0.02
    given = found.occupied_where_visible()
    assert given[seen] == pytest.approx((occupied / np.where(seen, visible, 1.0))[seen], abs=0.07)
    assert ((given[seen] > 0.1) & (given[seen] < 0.9)).sum() > 50, "much is uncertain here"


@pytest.mark.parametrize(
    "pose", [POSE, SE2(-0.1, -0.05, 0.0), SE2(0.15, 0.45, np.pi), SE2(0.131, -0.377, 2.2), SE2(-5.4, 3.0, -0.3)]
)
def test_without_errors_it_is_the_scan_itself(pose):
    """Also with beams along grid lines, and with a sensor outside the grid."""
    scene = truth_scene.scene(0)
    scan = replace(truth_scene.scan(0), world_T_sensor=pose)
    exact = replace(scan, ranges=true_ranges(scan, scene))
    errors = measure_range_errors([(exact, scene)])[scan.sensor]
    visible, occupied = cast(exact, GRID, pose)
    found = expected(scan, scene, errors, GRID, pose)
    assert np.array_equal(found.unseen == 0.0, visible)
    assert np.array_equal(found.unseen == 1.0, ~visible)
    assert np.array_equal(found.unoccupied == 0.0, occupied)
    assert np.array_equal(found.occupied_where_visible()[visible], occupied[visible].astype(float))
    assert np.isnan(found.occupied_where_visible()[~visible]).all()


def test_scans_of_several_sensors_are_one_frame():
    scene, poses = truth_scene.scene(4), (POSE, SE2(1.0, 2.0, -1.0))
    scans = [replace(truth_scene.scan(4), world_T_sensor=pose) for pose in poses]
    scans = [replace(scan, ranges=true_ranges(scan, scene)) for scan in scans]
    together, visible, occupied = ExpectedScan.nothing(GRID), *np.zeros((2, *GRID.shape), np.bool_)
    for scan, pose in zip(scans, poses, strict=True):
        errors = measure_range_errors([(scan, scene)])[scan.sensor]
        together.add(scan, scan.ranges, errors, GRID, pose)
        cast_scan(scan, GRID, pose, visible, occupied)
    assert np.array_equal(together.unseen == 0.0, visible)
    assert np.array_equal(together.unoccupied == 0.0, occupied)


def test_a_band_of_ranges_has_its_own_errors_and_a_rare_one_the_errors_of_all():
    scene, random = truth_scene.scene(0), np.random.default_rng(2)
    scan = truth_scene.scan(0)
    true = true_ranges(scan, scene)
    spread = np.where(true < 3.0, 0.01, 0.1)
    scans = [
        replace(scan, ranges=(true + spread * random.standard_normal(true.size)).astype(np.float32)) for _ in range(60)
    ]
    errors = measure_range_errors((one, scene) for one in scans)[scan.sensor]
    near, far, rare = errors.bands(np.array([2.5, 4.5, 19.5], np.float32)).tolist()
    assert np.std(errors.values[errors.starts[near] : errors.ends[near]]) == pytest.approx(0.01, rel=0.05)
    assert np.std(errors.values[errors.starts[far] : errors.ends[far]]) == pytest.approx(0.1, rel=0.05)
    few = measure_range_errors([(scans[0], scene)])[scan.sensor]
    assert np.bincount(few.bands(true)).max() < MIN_ERRORS
    sizes = (few.ends - few.starts)[few.bands(np.array([1.5, 2.5, rare], np.float32))]
    assert sizes.tolist() == [true.size] * 3


def test_every_nth_scan_of_each_sensor_is_measured():
    scene = truth_scene.scene(0)
    scans = [(replace(truth_scene.scan(0), sensor=name), scene) for name in "abababab"]
    errors = measure_range_errors(scans, 2)
    assert {sensor: one.ends.max() - one.values.size for sensor, one in errors.items()} == {"a": 0, "b": 0}
    assert measure_range_errors([]) == {}
    assert isinstance(scans[0][0], Scan)


def test_a_beam_through_the_corners_of_cells_does_not_reach_the_cells_beside_it():
    grid = GridSpec(8, 0.5, (-1.0, -1.0))
    scan = Scan(0, np.array([3.0], np.float32), np.pi / 4, 0.0, 0.1, 10.0)
    errors = RangeErrors(np.linspace(-0.4, 0.4, 101), np.zeros(12, np.int64), np.full(12, 101))
    found = ExpectedScan.nothing(grid)
    found.add(scan, scan.ranges, errors, grid, SE2())
    assert not np.diag(found.unseen)[2:6].any()
    assert np.array_equal(found.unseen < 1.0, np.diag(np.diag(found.unseen) < 1.0))
    assert found.unoccupied.sum() == pytest.approx(63.0), "the beam ends in one cell"

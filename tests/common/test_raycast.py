"""The visible cells are exactly the cells that beams cross, against a slow and simple implementation."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridSpec
from gridtrack.common.raycast import cast_scan, end_cells
from gridtrack.common.scan import Scan

UNIT = GridSpec(5, 1.0, (0.0, 0.0))


def beam(angle: float, distance: float, range_max: float = 100.0, range_min: float = 0.0) -> Scan:
    return Scan(0, np.array([distance], np.float32), angle, 0.0, range_min, range_max)


def cast(scan: Scan, grid: GridSpec, pose: SE2) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    visible, occupied = np.zeros(grid.shape, bool), np.zeros(grid.shape, bool)
    points = cast_scan(scan, grid, pose, visible, occupied)
    return visible, occupied, points


def drawn(scan: Scan, pose: SE2) -> str:
    """The 5 x 5 grid as text: `#` occupied, `.` free, `?` unseen; the last row is row 0, so y points up."""
    visible, occupied, _ = cast(scan, UNIT, pose)
    rows = [
        "".join("#" if o else "." if v else "?" for v, o in zip(*r, strict=True))
        for r in zip(visible, occupied, strict=True)
    ]
    return " ".join(reversed(rows))


def split_and_test_midpoints(scan: Scan, grid: GridSpec, pose: SE2) -> tuple[np.ndarray, np.ndarray]:
    """Cut each beam wherever it meets a grid line, and mark the cell in which the middle of each piece lies."""
    visible, occupied = np.zeros(grid.shape, bool), np.zeros(grid.shape, bool)
    x0, y0 = ((pose.x - grid.origin[0]) / grid.cell_m, (pose.y - grid.origin[1]) / grid.cell_m)
    for i, distance in enumerate(scan.ranges.tolist()):
        if math.isnan(distance) or distance < scan.range_min:
            continue
        angle = scan.angle_min + pose.theta + i * scan.angle_increment
        length = min(distance, scan.range_max) / grid.cell_m
        dx, dy = math.cos(angle) * length, math.sin(angle) * length
        shares = {0.0, 1.0}
        for start, along in ((x0, dx), (y0, dy)):
            low, high = sorted((start, start + along))
            shares |= {(line - start) / along for line in range(math.ceil(low), math.floor(high) + 1) if along}
        cuts = sorted(s for s in shares if 0.0 <= s <= 1.0)
        middles = [((a + b) / 2.0) for a, b in itertools.pairwise(cuts) if b - a > 1e-12]
        for share in [*middles, 1.0]:
            column, row = math.floor(x0 + share * dx), math.floor(y0 + share * dy)
            if 0 <= row < grid.size and 0 <= column < grid.size:
                visible[row, column] = True
                occupied[row, column] |= share == 1.0 and distance <= scan.range_max
    return visible, occupied


@pytest.mark.parametrize(
    ("angle_deg", "distance", "start", "picture"),
    [
        pytest.param(0, 3.0, (0.5, 2.5), "????? ????? ...#? ????? ?????", id="along x"),
        pytest.param(180, 3.0, (4.5, 2.5), "????? ????? ?#... ????? ?????", id="against x"),
        pytest.param(90, 2.0, (1.5, 0.5), "????? ????? ?#??? ?.??? ?.???", id="along y, which points up"),
        pytest.param(-90, 2.0, (1.5, 4.5), "?.??? ?.??? ?#??? ????? ?????", id="against y"),
        pytest.param(0, 3.0, (-1.5, 0.5), "????? ????? ????? ????? .#???", id="from outside the grid"),
        pytest.param(0, 50.0, (2.5, 2.5), "????? ????? ??... ????? ?????", id="ends outside the grid"),
        pytest.param(180, 50.0, (30.5, 2.5), "????? ????? ..... ????? ?????", id="crosses the whole grid"),
        pytest.param(0, 3.0, (0.5, 9.5), "????? ????? ????? ????? ?????", id="misses the grid"),
        pytest.param(
            0, 3.0, (0.5, 2.0), "????? ????? ...#? ????? ?????", id="on a grid line, which is of the upper cell"
        ),
        pytest.param(0, 3.0, (0.5, 5.0), "????? ????? ????? ????? ?????", id="on the grid's upper edge, outside"),
        pytest.param(0, 2.0, (1.0, 2.5), "????? ????? ?..#? ????? ?????", id="from border to border"),
        pytest.param(0, 0.0, (2.5, 2.5), "????? ????? ??#?? ????? ?????", id="zero length marks its own cell alone"),
    ],
)
def test_hand_drawn_beams(angle_deg: float, distance: float, start: tuple[float, float], picture: str) -> None:
    assert drawn(beam(0.0, distance), SE2(*start, math.radians(angle_deg))) == picture


@pytest.mark.parametrize("noise", [0.0, 1e-14, -1e-14, 1e-16, -1e-16])
@pytest.mark.parametrize(
    ("angle_deg", "start", "picture"),
    [
        (0, (0.5, 2.0), "????? ????? ...#? ????? ?????"),
        (180, (3.5, 2.0), "????? ????? #...? ????? ?????"),
        (90, (2.0, 0.5), "????? ??#?? ??.?? ??.?? ??.??"),
        (-90, (2.0, 3.5), "????? ??.?? ??.?? ??.?? ??#??"),
    ],
)
def test_a_beam_along_a_grid_line_is_in_the_upper_cells_in_either_direction_and_up_to_rounding(
    angle_deg: int, start: tuple[float, float], picture: str, noise: float
) -> None:
    turned = SE2(start[0] + noise, start[1] + noise, math.radians(angle_deg))
    assert drawn(beam(0.0, 3.0), turned) == picture
    assert drawn(beam(math.radians(angle_deg + noise), 3.0), SE2(start[0], start[1] - noise)) == picture


@pytest.mark.parametrize("noise", [0.0, 1e-14, -1e-14])
def test_a_beam_that_begins_or_ends_on_a_grid_line_up_to_rounding_is_in_the_upper_cell(noise: float) -> None:
    assert drawn(beam(0.0, 2.0), SE2(1.0 + noise, 2.5)) == "????? ????? ?..#? ????? ?????"
    assert drawn(beam(math.pi, 2.0), SE2(3.0 + noise, 2.5)) == "????? ????? ?#.?? ????? ?????"


def segment(x: float, y: float) -> Scan:
    return beam(math.atan2(y, x), math.hypot(x, y))


def test_a_diagonal_through_corners_touches_no_neighbour() -> None:
    # the pose has no rounding errors, so the beam meets the corners up to errors of cos and sin
    visible, occupied, _ = cast(segment(4.0, 4.0), UNIT, SE2(0.5, 0.5))
    on_diagonal = np.eye(5, dtype=bool)
    assert visible[on_diagonal].all()
    assert occupied[4, 4]
    assert occupied.sum() == 1


def test_a_slanted_beam_sees_both_cells_of_a_slab() -> None:
    assert drawn(segment(4.0, 2.0), SE2(0.5, 0.6)) == "????? ????? ???.# ?...? ..???"


def test_no_return_is_free_up_to_the_largest_range() -> None:
    picture = "????? ????? ....? ????? ?????"
    for distance in (math.inf, 80.0, 3.5):
        assert drawn(beam(0.0, distance, range_max=3.0), SE2(0.5, 2.5)) == picture


@pytest.mark.parametrize("distance", [math.nan, -math.inf, 0.0, 0.29, -3.0])
def test_an_invalid_range_marks_no_cell(distance: float) -> None:
    visible, occupied, points = cast(beam(0.0, distance, range_min=0.3), UNIT, SE2(0.5, 2.5))
    assert not visible.any()
    assert not occupied.any()
    assert len(points) == 0


def test_occupied_wins_over_free_within_a_scan() -> None:
    scan = Scan(0, np.array([2.0, 4.0], np.float32), 0.0, 0.0, 0.0, 100.0)
    for ranges in (scan.ranges, scan.ranges[::-1]):
        both = Scan(0, ranges, 0.0, 0.0, 0.0, 100.0)
        assert drawn(both, SE2(0.5, 2.5)) == "????? ????? ..#.# ????? ?????"


def test_points_are_the_returns_inside_the_window_in_metres() -> None:
    scan = Scan(0, np.array([2.0, 40.0, math.inf, math.nan], np.float32), 0.0, math.pi / 2, 0.0, 50.0)
    _, _, points = cast(scan, GridSpec(50, 0.2), SE2(1.0, -1.0))
    np.testing.assert_allclose(points, [[3.0, -1.0]], atol=1e-6)


@st.composite
def scenes(draw: st.DrawFn) -> tuple[Scan, GridSpec, SE2]:
    size = draw(st.integers(1, 40))
    cell_m = draw(st.floats(0.05, 2.0))
    reach = size * cell_m
    beams = draw(st.integers(1, 24))
    distance = st.one_of(st.floats(0.0, 2 * reach), st.sampled_from([math.inf, math.nan, -math.inf]))
    ranges = np.array(draw(st.lists(distance, min_size=beams, max_size=beams)), np.float32)
    scan = Scan(0, ranges, draw(st.floats(-3.1, 3.1)), draw(st.floats(-0.3, 0.3)), 0.01, max(1.5 * reach, 0.02))
    place = st.floats(-reach, reach)
    return scan, GridSpec(size, cell_m), SE2(draw(place), draw(place), draw(st.floats(-3.1, 3.1)))


@settings(max_examples=150)
@given(scenes())
def test_agrees_with_splitting_every_beam_at_every_grid_line(scene: tuple[Scan, GridSpec, SE2]) -> None:
    scan, grid, pose = scene
    visible, occupied, points = cast(scan, grid, pose)
    slow_visible, slow_occupied = split_and_test_midpoints(scan, grid, pose)
    differing = (visible != slow_visible) | (occupied != slow_occupied)
    assert not differing[~near_a_corner(scan, grid, pose)].any()
    assert not (occupied & ~visible).any()
    assert occupied.sum() <= len(points) <= scan.ranges.size


def near_a_corner(scan: Scan, grid: GridSpec, pose: SE2) -> np.ndarray:
    """Cells with a corner or border within the rounding error of a beam or its end."""
    near = np.zeros(grid.shape, bool)
    corners = np.stack(np.meshgrid(np.arange(grid.size + 1), np.arange(grid.size + 1)), axis=-1).reshape(-1, 2)
    start = np.array([pose.x - grid.origin[0], pose.y - grid.origin[1]]) / grid.cell_m
    for i, distance in enumerate(np.minimum(scan.ranges, np.float32(scan.range_max)).tolist()):
        if not distance >= scan.range_min:
            continue
        angle = scan.angle_min + pose.theta + i * scan.angle_increment
        along = np.array([math.cos(angle), math.sin(angle)])
        across = abs((corners - start) @ np.array([-along[1], along[0]]))
        end = start + along * min(distance, scan.range_max) / grid.cell_m
        on_border = (abs(end - np.round(end)) < 1e-9).any()
        for column, row in [*corners[across < 1e-9], *([np.floor(end).astype(int)] if on_border else [])]:
            near[max(row - 1, 0) : max(row + 1, 0), max(column - 1, 0) : max(column + 1, 0)] = True
    if abs(start - np.round(start)).min() < 1e-9:
        near[:] = True
    return near


@pytest.mark.parametrize(
    ("scan", "pose"),
    [
        (beam(0.3, math.inf, range_max=1e308), SE2()),
        (beam(math.nan, 2.0), SE2()),
        (beam(0.3, 2.0), SE2(math.nan, 0.0, 0.0)),
        (beam(0.3, 2.0), SE2(1e300, -1e300, 0.0)),
        (beam(0.3, 2.0), SE2(0.0, 0.0, math.inf)),
    ],
)
@pytest.mark.filterwarnings("ignore:invalid value encountered:RuntimeWarning")
def test_values_that_are_not_finite_mark_no_cell_and_change_no_other_memory(scan: Scan, pose: SE2) -> None:
    grid = GridSpec(20, 0.01)
    guarded = np.zeros((2, 1 << 20), bool)
    visible, occupied = guarded[:, 1 << 19 : (1 << 19) + 400].reshape(2, 20, 20)
    assert len(cast_scan(scan, grid, pose, visible, occupied)) == 0
    assert not guarded.any()


@pytest.mark.parametrize(
    "edge", [SE2(0.0, 2.5), SE2(2.5, 0.0), SE2(0.0, 0.0), SE2(5.0, 0.0), SE2(0.0, 5.0), SE2(5.0, 5.0)]
)
@pytest.mark.parametrize("quarter", range(4))
@pytest.mark.parametrize("slope", [-1e-16, 0.0, 1e-16])
def test_a_beam_along_the_edge_of_the_window_changes_no_other_memory(edge: SE2, quarter: int, slope: float) -> None:
    around = np.zeros((4, *UNIT.shape), bool)
    visible, occupied = around[1], around[2]
    cast_scan(beam(quarter * math.pi / 2.0 + slope, 4.0), UNIT, edge, visible, occupied)
    assert not around[[0, 3]].any()
    assert visible.sum() <= UNIT.size


def test_a_laser_without_a_range_limit_observes_cells_to_the_edge() -> None:
    assert drawn(beam(0.0, math.inf, range_max=3.4e38), SE2(0.5, 0.5)).split()[-1] == "....."


@settings(max_examples=50)
@given(
    ranges=st.lists(st.one_of(st.floats(0.0, 12.0, width=32), st.sampled_from([np.inf, -np.inf, np.nan])), min_size=1),
    x=st.floats(-8.0, 8.0),
    theta=st.floats(-3.2, 3.2),
)
def test_the_end_cells_of_beams_are_the_occupied_cells(ranges, x, theta):
    scan = Scan(0, np.array(ranges, np.float32), -1.0, 2.0 / len(ranges), 0.1, 10.0)
    grid, pose = GridSpec(20, 0.5), SE2(x, 0.3, theta)
    occupied = np.zeros(grid.shape, bool)
    cast_scan(scan, grid, pose, np.zeros(grid.shape, bool), occupied)
    cells = end_cells(scan, grid, pose)
    assert set(cells[cells >= 0].tolist()) == set(np.flatnonzero(occupied).tolist())

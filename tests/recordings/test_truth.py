"""Rasterised truth, against hand-drawn cases and a slow version that clips every edge against every cell."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gridtrack.common.errors import RecordingError
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridSpec
from gridtrack.common.scene import Scene, SceneObject
from gridtrack.recordings.truth import FREE, INTERIOR, OUTLINE, static_cells, truth_grid

from scenes.drives import box

GRID = GridSpec(5, 1.0, (0.0, 0.0))
HERE = SE2()


def outline(*corners):
    return np.array(corners, np.float32)


def scene(static=(), objects=(), static_label=4):
    return Scene(tuple(static), static_label, tuple(objects))


def body(shape, label=0, pose=HERE, track=1):
    return SceneObject(track, label, pose, shape)


def drawn(cover):
    """Rows as text, y upwards: `.` free, `#` outline, `i` interior."""
    return ["".join(".#i"[cell] for cell in row) for row in cover[::-1]]


def test_a_slope_passes_through_the_cells_in_which_it_has_length():
    truth = truth_grid(scene(static=[outline((0.5, 0.5), (4.5, 0.5), (0.5, 4.5))]), GRID, HERE)
    assert drawn(truth.cover) == [
        "#....",
        "##...",
        "#i#..",
        "#ii#.",
        "#####",
    ]


def test_an_edge_on_a_border_is_in_the_cell_that_starts_there():
    truth = truth_grid(scene(static=[box(1, 1, 2, 2)]), GRID, HERE)
    assert drawn(truth.cover) == [
        ".....",
        ".##..",
        ".#i#.",
        ".###.",
        ".....",
    ]


def test_objects_and_grid_are_placed_by_their_poses():
    turned = body(box(-2, -1, 4, 2), label=2, pose=SE2(12.5, 7.5, math.pi / 2))
    truth = truth_grid(scene(objects=[turned]), GRID, SE2(10.0, 5.0, 0.0))
    assert drawn(truth.cover) == [
        ".###.",
        ".#i#.",
        ".#i#.",
        ".#i#.",
        ".###.",
    ]
    assert (truth.labels == 2).sum() == (truth.cover == OUTLINE).sum()


@pytest.mark.parametrize("quarter", range(4))
@pytest.mark.parametrize("noise", [0.0, 1e-14, -1e-14])
def test_an_outline_on_grid_lines_is_in_the_upper_cells_however_it_is_placed(quarter, noise):
    """A square of 2 x 2 cells about (2, 2): its lower and left sides are in its own cells, the others are not."""
    square = body(box(-1.0, -1.0, 2.0, 2.0), pose=SE2(2.0 + noise, 2.0 - noise, quarter * np.pi / 2))
    expected = [".....", ".##..", ".#i#.", ".###.", "....."]
    assert drawn(truth_grid(scene(objects=[square]), GRID, HERE).cover) == expected


def test_an_outline_inside_another_object_counts_and_road_users_take_precedence():
    room, within = box(0.5, 0.5, 4, 4), box(2.2, 2.2, 0.5, 0.5)
    truth = truth_grid(scene(static=[room], objects=[body(within, label=1)]), GRID, HERE)
    assert drawn(truth.cover)[2] == "#i#i#"
    assert truth.labels[2].tolist() == [4, 255, 1, 255, 4]
    leaning = truth_grid(scene(static=[room], objects=[body(box(0.1, 0.1, 1.5, 0.5), 3)]), GRID, HERE)
    assert leaning.labels[0].tolist() == [3, 3, 4, 4, 4]


def test_static_cells_are_on_static_outlines_only():
    found = static_cells(scene(static=[box(0.5, 0.5, 4, 4)], objects=[body(box(2.2, 2.2, 0.5, 0.5))]), GRID, HERE)
    assert found.sum() == 16
    assert not found[2, 2]


def test_an_empty_scene_is_free_everywhere():
    assert (truth_grid(scene(), GRID, HERE).cover == FREE).all()
    assert not static_cells(scene(), GRID, HERE).any()


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e30])
def test_corners_that_are_not_finite_are_refused(bad):
    with pytest.raises(RecordingError, match="not finite"):
        truth_grid(scene(objects=[body(outline((0, 0), (1, 0), (1, bad)))]), GRID, HERE)


def length_inside(a, b, row, column):
    """Length of the segment a-b inside the closed cell, by clipping it against each side in turn."""
    enter, leave = 0.0, 1.0
    for start, along, low in ((a[0], b[0] - a[0], column), (a[1], b[1] - a[1], row)):
        if abs(along) < 1e-15:
            if not low <= start <= low + 1:
                return 0.0
            continue
        ends = sorted(((low - start) / along, (low + 1 - start) / along))
        enter, leave = max(enter, ends[0]), min(leave, ends[1])
    return max(leave - enter, 0.0) * math.dist(a, b)


def winds_round(polygon, x, y):
    """Whether (x, y) is inside, by the sum of the angles under which the edges are seen."""
    towards = np.arctan2(polygon[:, 1] - y, polygon[:, 0] - x)
    turns = np.diff(np.concatenate([towards, towards[:1]]))
    return abs(((turns + np.pi) % (2 * np.pi) - np.pi).sum()) > np.pi


def slow_cover(polygons, size):
    cover = np.full((size, size), FREE, np.uint8)
    for row in range(size):
        for column in range(size):
            if any(length_inside(p[i - 1], p[i], row, column) > 1e-9 for p in polygons for i in range(len(p))):
                cover[row, column] = OUTLINE
            elif any(winds_round(p, column + 0.5, row + 0.5) for p in polygons):
                cover[row, column] = INTERIOR
    return cover


angle = st.floats(-3.2, 3.2)
place = st.floats(-3.0, 11.0)
shape = st.tuples(place, place, angle, st.integers(3, 9), st.floats(0.3, 6.0), st.floats(0.3, 3.0))


@settings(max_examples=60)
@given(st.lists(shape, min_size=1, max_size=3))
def test_random_bodies_agree_with_the_slow_version(shapes):
    grid = GridSpec(8, 1.0, (0.0, 0.0))
    bodies, polygons = [], []
    for x, y, theta, corners, length, width in shapes:
        around = 2 * np.pi * (np.arange(corners) + 0.123) / corners
        shape_ = np.stack([length / 2 * np.cos(around), width / 2 * np.sin(around)], axis=1).astype(np.float32)
        pose = SE2(x + 0.0137, y + 0.0071, theta)
        bodies.append(body(shape_, pose=pose))
        polygons.append(pose.apply(shape_))
    assert drawn(truth_grid(scene(objects=bodies), grid, HERE).cover) == drawn(slow_cover(polygons, 8))

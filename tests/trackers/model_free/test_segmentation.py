"""Clusters of returns, cut-off returns on drawn scenes, and clusters that appear beside them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse.csgraph import connected_components

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.trackers.model_free.estimators import SwitchingEstimator
from gridtrack.trackers.model_free.kalman import KalmanEstimator
from gridtrack.trackers.model_free.pipeline import MOVING_MPS, initiate
from gridtrack.trackers.model_free.segmentation import BACKGROUND, Cluster, clusters_of, cut_off_returns, segment
from gridtrack.trackers.model_free.settings import PipelineSettings
from gridtrack.trackers.model_free.shape import Shape
from gridtrack.trackers.model_free.tracks import Track


def test_returns_nearer_than_the_link_are_one_cluster_and_chains_hold_together():
    points = np.array([[0.0, 0.0], [0.9, 0.0], [1.8, 0.0], [5.0, 0.0]])
    labels = segment(points, np.zeros(4), link_m=1.0, link_per_m=0.0)
    clusters = clusters_of(points, np.array([False, True, False, False]), labels)
    assert sorted(len(cluster.points) for cluster in clusters) == [1, 3]
    assert [cluster.points[cluster.cut].tolist() for cluster in clusters if cluster.cut.any()] == [[[0.9, 0.0]]]


def test_the_link_grows_with_range_and_the_nearer_return_decides():
    points = np.array([[0.0, 0.0], [1.5, 0.0]])
    assert len(set(segment(points, np.array([10.0, 10.0]), 1.0, 0.1))) == 1
    assert len(set(segment(points, np.array([2.0, 10.0]), 1.0, 0.1))) == 2


@given(st.integers(0, 60), st.integers(0, 10_000))
def test_clusters_are_the_connected_components_of_the_links(count, seed):
    random = np.random.default_rng(seed)
    points, ranges = random.uniform(0, 6, (count, 2)).round(1), random.uniform(0, 20, count)
    reach = 0.3 + 0.03 * ranges
    apart = np.linalg.norm(points[:, None] - points, axis=2)
    _, wanted = connected_components(apart <= np.minimum(reach[:, None], reach), directed=False)
    assert segment(points, ranges, 0.3, 0.03).tolist() == wanted.tolist()


def test_no_returns_are_no_clusters():
    nothing = np.empty((0, 2))
    assert clusters_of(nothing, np.empty(0, bool), segment(nothing, np.empty(0), 1.0, 0.0)) == []


GRID = GridSpec(9, 1.0, (0.0, 0.0))
SETTINGS = PipelineSettings()


def drawn(*rows: str) -> tuple[GridFrame, np.ndarray]:
    """A frame and the label of each of its returns: the rows from the top, `.` free, `#` hidden, letters are returns.

    The sensor is in the middle of the bottom row; a digit is the cluster of its return, `w` is background.
    """
    cells = np.array([list(row) for row in reversed(rows)])
    occupied = (cells != ".") & (cells != "#")
    points = GRID.cell_centres(occupied)
    origin = np.array([[4.5, 0.5]], np.float32)
    frame = GridFrame(0, cells != "#", occupied, SE2(), origin, points, np.zeros(len(points), np.uint8))
    labels = np.array([BACKGROUND if cell == "w" else int(cell) for cell in cells[occupied]])
    return frame, labels


def cells_cut_off(*rows: str) -> set[tuple[int, int]]:
    frame, labels = drawn(*rows)
    columns, lines = frame.points[cut_off_returns(frame, GRID, labels)].astype(int).T
    return set(zip(lines.tolist(), columns.tolist(), strict=True))


@pytest.mark.parametrize("nearer", ["1", "w"], ids=["object", "wall"])
def test_a_side_is_cut_off_where_something_nearer_hides_it_and_not_where_it_ends(nearer):
    assert cells_cut_off(
        "...#####.",
        "...######",
        "...######",
        "...0000##",
        ".......##",
        "......##.",
        f"......{nearer}..",
        ".........",
        ".........",
    ) == {(5, 6)}


def test_a_body_does_not_cut_itself_off():
    assert not cells_cut_off(
        "..#####..",
        "..#####..",
        "..####0..",
        "..####0..",
        "..00000..",
        ".........",
        ".........",
        ".........",
        ".........",
    )


def test_a_body_is_cut_off_at_the_edge_of_the_grid():
    nothing = "........."
    assert cells_cut_off(nothing, nothing, nothing, nothing, "0000.....", *[nothing] * 4) == {(4, 0)}


def moving_body(speed: float, length_m: float = 4.0) -> Track:
    """A body along x that moves along x; its front, at x = 0, is cut off."""
    offsets = np.stack([np.linspace(-length_m, 0.0, 9), np.zeros(9)], 1)
    estimator = SwitchingEstimator(KalmanEstimator, np.zeros(3), np.eye(3) * 0.01, SETTINGS.motion(0.1, 10.0))
    mean = np.array([0.0, 0.0, 0.0, speed, 0.0, 0.0])
    estimator.reinitialise(mean, np.eye(6) * 0.01)
    shape = Shape.of(offsets, np.arange(9) == 8, 0.1)
    return Track(0, estimator, shape, offsets, np.zeros(9, np.int64), 0.9, confirmed=True)


def initiated(tracks: list[Track], x: float, cut: bool) -> SwitchingEstimator:
    points = np.array([[x, 0.0], [x + 0.5, 0.0]])
    cluster = Cluster(points, np.array([cut, False]))
    return initiate(KalmanEstimator, cluster, tracks, SETTINGS.motion(0.1, 10.0), SETTINGS)


def test_a_cluster_beyond_a_shadow_has_the_velocity_of_the_cut_off_body():
    moving = initiated([moving_body(6.0)], 1.0, cut=True)
    assert moving.mean[3:5] == pytest.approx([6.0, 0.0])
    assert np.sqrt(moving.covariance[3, 3]) < SETTINGS.initial_speed


@pytest.mark.parametrize(
    ("body", "x", "cut"),
    [
        (moving_body(6.0), 5.0, True),
        (moving_body(6.0), 1.0, False),
        (moving_body(0.9 * MOVING_MPS), 1.0, True),
        (moving_body(6.0, length_m=0.5), 1.0, True),
    ],
    ids=["far away", "seen whole", "a stopped body", "a person"],
)
def test_other_clusters_are_initiated_without_velocity(body, x, cut):
    assert initiated([body], x, cut).mean[3:5] == pytest.approx([0.0, 0.0])

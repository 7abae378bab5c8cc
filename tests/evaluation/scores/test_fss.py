"""Sums over neighbourhoods: against loops written from the definition, and `fss_2d` of the package `scores`."""

import numpy as np
import pytest

from gridtrack.evaluation.referee.strata import CELL_KINDS, PARTS, STRATA, STRATA_WITH_TRUTH
from gridtrack.evaluation.referee.targets import NOT_SCORED, Target
from gridtrack.evaluation.scores.fss import FSS
from gridtrack.evaluation.scores.neighbourhoods import NEIGHBOURHOOD_STRATA, SCALES
from gridtrack.evaluation.scores.soft_iou import SOFT_IOU

from scenes.scored_cells import counted, frame, members_of, random_forecast, region_maps, scored, values

DYNAMIC = CELL_KINDS.index("dynamic")


def found_of(occupancy, targets, cell_kinds, strata=STRATA, ages=None):
    """FSS (S, K, W) by scale, sum P^2 + sum O^2, sum p o and sum p + o - p o, and the strata."""
    forecast = scored(occupancy, targets, region_maps(cell_kinds, strata), ages)
    names, sums = counted(FSS, forecast)
    fss = np.stack([values(FSS, sums)[f"{scale}_cells"] for scale in SCALES], axis=-1)
    squares = np.stack([sums[f"squares {scale}"] for scale in SCALES], axis=-1)
    soft = counted(SOFT_IOU, forecast)[1]
    return fss, squares, soft["intersection"], soft["union"], names


def all_visible(occupied):
    return Target.of_frame(frame(np.ones_like(occupied), occupied))


def by_loops(p, o, members, scale):
    """Sum (P - O)^2 and sum P^2 + sum O^2, neighbourhood by neighbourhood."""
    half, apart, each = scale // 2, 0.0, 0.0
    for r, c in zip(*np.nonzero(members), strict=True):
        rows, columns = slice(max(r - half, 0), r + half + 1), slice(max(c - half, 0), c + half + 1)
        chosen = members[rows, columns]
        mean_p, mean_o = p[rows, columns][chosen].mean(dtype=float), o[rows, columns][chosen].mean()
        apart += (mean_p - mean_o) ** 2
        each += mean_p**2 + mean_o**2
    return apart, each


@pytest.mark.parametrize("seed", range(3))
def test_every_stratum_agrees_with_loops_over_its_cells(seed):
    rng = np.random.default_rng(seed)
    size, steps = 24, 1
    occupancy, cell_kinds = random_forecast(rng, size, steps), rng.integers(0, 3, (size, size)).astype(np.uint8)
    states = rng.integers(0, 5, occupancy.shape).astype(np.uint8)
    ages = rng.integers(0, 5, (size, size)).astype(np.uint8)
    motions = rng.integers(0, len(PARTS), occupancy.shape).astype(np.uint8) * (cell_kinds == DYNAMIC)
    targets = [Target(frame(s < 2, s == 1), s, m) for s, m in zip(states, motions, strict=True)]
    fss, squares, both, either, strata = found_of(occupancy, targets, cell_kinds, STRATA_WITH_TRUTH, ages)
    assert strata == NEIGHBOURHOOD_STRATA
    for n, (state, motion) in enumerate(zip(states, motions, strict=True)):
        members, o = members_of(cell_kinds, state, motion, ages), (state & 1) * (state != NOT_SCORED)
        for k, name in enumerate(strata):
            for w, scale in enumerate(SCALES):
                apart, each = by_loops(occupancy[n], o, members[name], scale)
                assert fss[n, k, w] == pytest.approx(1 - apart / each, abs=1e-6)
                assert squares[n, k, w] == pytest.approx(each, rel=1e-5)
            p_in, o_in = occupancy[n][members[name]].astype(float), o[members[name]]
            assert either[n, k] == pytest.approx((p_in + o_in - p_in * o_in).sum(), rel=1e-5)
            assert both[n, k] == pytest.approx((p_in * o_in).sum(), rel=1e-5)


@pytest.mark.parametrize("zero_padding", [False, True])
def test_a_frame_that_is_visible_as_a_whole_agrees_with_the_package_scores(zero_padding):
    """Its border is empty, wide enough that no neighbourhood at the edge of the window has anything in it."""
    xarray = pytest.importorskip("xarray", reason="the extra dev is not installed")
    spatial = pytest.importorskip("scores.spatial", reason="the extra dev is not installed")
    utils = pytest.importorskip("scores.utils")
    rng, size, border = np.random.default_rng(5), 60, 2 * (max(SCALES) // 2)
    occupancy, occupied = np.zeros((1, size, size), np.float32), np.zeros((size, size), bool)
    inside = slice(border, size - border)
    occupancy[0, inside, inside] = rng.beta(0.2, 2.0, (size - 2 * border,) * 2)
    occupied[inside, inside] = rng.random((size - 2 * border,) * 2) < 0.05
    fss, *_ = found_of(occupancy, [all_visible(occupied)], np.full((size, size), DYNAMIC, np.uint8))
    forecast, observed = (xarray.DataArray(a.astype(float), dims=("y", "x")) for a in (occupancy[0], occupied))
    for w, scale in enumerate(SCALES):
        expected = spatial.fss_2d(
            forecast,
            observed,
            event_threshold=0.0,
            threshold_operator=utils.left_identity_operator,
            window_size=(scale, scale),
            spatial_dims=("y", "x"),
            zero_padding=zero_padding,
        )
        assert fss[0, :, w] == pytest.approx(float(expected), abs=1e-6)


def test_a_forecast_that_is_a_cell_off_is_forgiven_from_three_cells_on():
    occupied, forecast = np.zeros((2, 25, 25))
    occupied[12, 12], forecast[12, 13] = 1, 1
    kinds = np.full((25, 25), DYNAMIC, np.uint8)
    fss, _, _, either, _ = found_of(forecast[None].astype(np.float32), [all_visible(occupied)], kinds)
    shares = [0.0, 2 / 3, 4 / 5, 8 / 9]
    assert fss[0, 0] == pytest.approx(shares), "the part of its neighbourhoods that have both cells"
    assert either[0, 0] == 2


def test_a_frame_without_scored_cells_has_sums_of_zero():
    unseen = Target.of_frame(frame(*np.zeros((2, 10, 10))))
    kinds = np.full((10, 10), DYNAMIC, np.uint8)
    fss, squares, both, either, _ = found_of(np.ones((1, 10, 10), np.float32), [unseen], kinds)
    assert np.isnan(fss).all()
    assert not any(sums.any() for sums in (squares, both, either))

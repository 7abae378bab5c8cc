"""Counts of one forecast, against hand-computed cases and scikit-learn."""

import numpy as np
import pytest
from sklearn.metrics import average_precision_score, brier_score_loss, f1_score, log_loss, precision_score, recall_score

from gridtrack.evaluation.results.columns import CALIBRATION_EDGES, PROBABILITY_BINS, PROBABILITY_EDGES
from gridtrack.evaluation.scoring import metrics
from gridtrack.evaluation.scoring.counting import HALF, Tally, count_forecast
from gridtrack.evaluation.referee.strata import CELL_KINDS, STRATA, STRATA_WITH_TRUTH
from gridtrack.evaluation.referee.targets import Target
from gridtrack.evaluation.scoring.thresholds import half

from scenes.scored_cells import frame, members_of, random_forecast, region_maps

VISIBLE, DYNAMIC, STATIC = (STRATA.index(name) for name in ("visible", "dynamic", "static"))
RING_CELL, STATIC_CELL, DYNAMIC_CELL = (CELL_KINDS.index(name) for name in ("ring", "static", "dynamic"))


def binned_by(edges, p):
    """The bin of each probability, the last one with p = 1 too."""
    return (np.digitize(p, edges) - 1).clip(0, len(edges) - 2)


def count(occupancy, frames, cell_kinds):
    return count_forecast(occupancy, [Target.of_frame(observed) for observed in frames], region_maps(cell_kinds))


def random_case(seed, size=30, steps=3):
    rng = np.random.default_rng(seed)
    occupancy = random_forecast(rng, size, steps)
    frames = [frame(rng.random((size, size)) < 0.7, rng.random((size, size)) < occupancy[n]) for n in range(steps + 1)]
    return occupancy, frames, rng.integers(0, 3, (size, size)).astype(np.uint8)


def test_a_hand_computed_forecast():
    occupancy = np.array([[[0.9, 0.4], [0.6, 0.8]]], np.float32)
    observed = frame([[1, 1], [1, 0]], [[1, 1], [0, 0]])
    cell_kinds = [[STATIC_CELL, DYNAMIC_CELL], [DYNAMIC_CELL, DYNAMIC_CELL]]
    tally = count(occupancy, [observed], cell_kinds)
    at_half = tally.confusion(half(0).bins)
    assert at_half[0, VISIBLE].tolist() == [1, 1, 1, 0]
    assert at_half[0, STATIC].tolist() == [1, 0, 0, 0]
    assert at_half[0, DYNAMIC].tolist() == [0, 1, 1, 0]
    assert tally.squared_error[0, :3] == pytest.approx([0.01 + 0.36 + 0.36, 0.36 + 0.36, 0.01], abs=1e-6)
    assert tally.log_loss[0, STATIC] == pytest.approx(-np.log(0.9))
    assert tally.log_loss[0, DYNAMIC] == pytest.approx(-2 * np.log(0.4))


def test_a_ring_cell_counts_as_visible_only():
    tally = count(np.full((1, 1, 1), 0.7, np.float32), [frame([[1]], [[1]])], [[RING_CELL]])
    assert tally.cells.sum(axis=(0, 2)).tolist() == [1, 0, 0, 0, 0]


def test_cells_that_are_hidden_in_the_observed_frame_are_not_scored():
    nothing_seen = frame(np.zeros((5, 5)), np.zeros((5, 5)))
    tally = count(np.ones((1, 5, 5), np.float32), [nothing_seen], np.full((5, 5), DYNAMIC_CELL))
    assert tally.cells.sum() == 0
    assert tally.squared_error.sum() == tally.log_loss.sum() == 0


@pytest.mark.parametrize("seed", range(4))
def test_every_score_of_every_stratum_agrees_with_scikit_learn(seed):
    rng = np.random.default_rng(seed)
    size, steps = 30, 2
    occupancy, cell_kinds = random_forecast(rng, size, steps), rng.integers(0, 3, (size, size)).astype(np.uint8)
    states = rng.integers(0, 5, occupancy.shape).astype(np.uint8)
    ages = rng.integers(0, 5, (size, size)).astype(np.uint8)
    motions = rng.integers(0, 3, occupancy.shape).astype(np.uint8) * (cell_kinds == DYNAMIC_CELL)
    targets = [
        Target(frame(state < 2, state == 1), state, motion) for state, motion in zip(states, motions, strict=True)
    ]
    bins = rng.choice([5, 250, HALF + 15, PROBABILITY_BINS - 1], (steps + 1, len(STRATA_WITH_TRUTH)))
    tally = count_forecast(occupancy, targets, region_maps(cell_kinds, STRATA_WITH_TRUTH), ages)
    confusion = tally.confusion(bins)
    for step, state in enumerate(states):
        members = members_of(cell_kinds, state, motions[step], ages)
        assert tuple(members) == tally.strata
        for k, scored in enumerate(members.values()):
            truth, p = state[scored] % 2 == 1, occupancy[step][scored]
            binned = binned_by(PROBABILITY_EDGES, p)
            called = binned >= bins[step, k]
            assert metrics.f1_score(confusion)[step, k] == pytest.approx(f1_score(truth, called))
            assert metrics.precision(confusion)[step, k] == pytest.approx(
                precision_score(truth, called, zero_division=np.nan), nan_ok=True
            )
            assert metrics.recall(confusion)[step, k] == pytest.approx(recall_score(truth, called))
            assert metrics.brier_score(tally)[step, k] == pytest.approx(brier_score_loss(truth, p), rel=1e-6)
            assert metrics.log_loss(tally)[step, k] == pytest.approx(
                log_loss(truth, np.clip(p.astype(float), 0.001, 0.999)), rel=1e-6
            )
            assert metrics.average_precision(tally)[step, k] == pytest.approx(average_precision_score(truth, binned))
            coarse = binned_by(CALIBRATION_EDGES, p)
            assert metrics.calibration_error(tally)[step, k] == calibration_error(truth, p, coarse)
            thought = p >= np.float32(metrics.THOUGHT_OCCUPIED)
            assert metrics.calibration_error(tally, metrics.THOUGHT_OCCUPIED)[step, k] == calibration_error(
                truth[thought], p[thought], coarse[thought]
            )


def calibration_error(truth, p, binned):
    gaps = [abs(p[binned == b].mean() - truth[binned == b].mean()) * (binned == b).mean() for b in np.unique(binned)]
    return pytest.approx(sum(gaps), rel=1e-5)


SHAPES = {"mostly near 0": (0.02, 2.0), "spread": (0.3, 3.0), "even": (1.0, 1.0), "mostly near 1": (5.0, 0.3)}


@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
@pytest.mark.parametrize("strength", [1.0, 0.7], ids=["calibrated", "too timid"])
def test_pr_auc_is_within_a_few_thousandths_of_that_of_the_probabilities_themselves(shape, strength):
    rng = np.random.default_rng(9)
    size = 300
    p = rng.beta(*shape, (1, size, size)).astype(np.float32)
    observed = frame(np.ones((size, size)), rng.random((size, size)) < p[0] ** strength)
    exact = average_precision_score(observed.occupied.ravel(), p.ravel())
    tally = count(p, [observed], np.full((size, size), DYNAMIC_CELL))
    assert metrics.average_precision(tally)[0, VISIBLE] == pytest.approx(exact, abs=0.002)


@pytest.mark.parametrize("levels", [2, 5, 30])
def test_pr_auc_of_a_forecast_with_few_levels_is_exact(levels):
    rng = np.random.default_rng(levels)
    size = 100
    values = PROBABILITY_EDGES[rng.choice(PROBABILITY_BINS, levels, replace=False)].astype(np.float32)
    p = rng.choice(values, (1, size, size))
    observed = frame(np.ones((size, size)), rng.random((size, size)) < p[0])
    tally = count(p, [observed], np.full((size, size), DYNAMIC_CELL))
    exact = average_precision_score(observed.occupied.ravel(), p.ravel())
    assert metrics.average_precision(tally)[0, VISIBLE] == pytest.approx(exact)


def test_the_brier_decomposition_agrees_with_its_definition_and_adds_up():
    occupancy, frames, cell_kinds = random_case(4)
    tally = count(occupancy, frames, cell_kinds)
    parts = metrics.brier_decomposition(tally)
    for step, observed in enumerate(frames):
        truth, p = observed.occupied[observed.visible].astype(float), occupancy[step][observed.visible].astype(float)
        binned = binned_by(CALIBRATION_EDGES, occupancy[step][observed.visible])
        bins = [(p[binned == b], truth[binned == b]) for b in np.unique(binned)]
        reliability = sum(q.size * (q.mean() - t.mean()) ** 2 for q, t in bins) / p.size
        murphys_resolution = sum(q.size * (t.mean() - truth.mean()) ** 2 for q, t in bins) / p.size
        variance = sum(((q - q.mean()) ** 2).sum() for q, _ in bins) / p.size
        covariance = 2 * sum(((q - q.mean()) * (t - t.mean())).sum() for q, t in bins) / p.size
        assert parts.reliability[step, VISIBLE] == pytest.approx(reliability, abs=1e-9)
        assert parts.uncertainty[step, VISIBLE] == pytest.approx(truth.var())
        assert parts.resolution[step, VISIBLE] == pytest.approx(murphys_resolution - variance + covariance, abs=1e-7)
        score = parts.reliability - parts.resolution + parts.uncertainty
        assert score[step, VISIBLE] == pytest.approx(brier_score_loss(truth, p), rel=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_f1_and_average_precision_agree_with_torchmetrics(seed):
    import torch
    from torchmetrics.functional.classification import binary_average_precision, binary_f1_score

    occupancy, frames, cell_kinds = random_case(seed, steps=0)
    tally = count(occupancy, frames, cell_kinds)
    seen = frames[0].visible
    truth = torch.from_numpy(frames[0].occupied[seen].astype(np.int64))
    binned = torch.from_numpy(PROBABILITY_EDGES[binned_by(PROBABILITY_EDGES, occupancy[0][seen])])
    assert metrics.f1_score(tally.confusion(half(0).bins))[0, VISIBLE] == pytest.approx(
        float(binary_f1_score((binned >= 0.5).long(), truth))
    )
    assert metrics.average_precision(tally)[0, VISIBLE] == pytest.approx(
        float(binary_average_precision(binned, truth)), rel=1e-5
    )


def test_the_log_loss_of_many_certain_mistakes_does_not_underflow():
    size = 200
    everywhere = np.ones((size, size))
    wrong = count(np.zeros((1, size, size), np.float32), [frame(everywhere, everywhere)], DYNAMIC_CELL * everywhere)
    assert wrong.log_loss[0, VISIBLE] == pytest.approx(-np.log(0.001) * size**2)


def test_a_probability_on_a_bins_edge_belongs_to_the_bin_above():
    size = 27
    more = size**2 - len(PROBABILITY_EDGES)
    edges = np.append(PROBABILITY_EDGES, np.zeros(more)).astype(np.float32).reshape(1, size, size)
    free, dynamic = frame(np.ones((size, size)), np.zeros((size, size))), np.full((size, size), DYNAMIC_CELL)
    tally = count(edges, [free], dynamic)
    assert tally.cells[0, VISIBLE].tolist() == [1 + more] + [1] * (PROBABILITY_BINS - 2) + [2]
    below = np.nextafter(edges, np.float32(-1)).clip(0, 1)
    tally = count(below, [free], dynamic)
    assert tally.cells[0, VISIBLE].tolist() == [2 + more] + [1] * (PROBABILITY_BINS - 1)


def test_edges_are_exact_and_the_bins_for_calibration_are_made_of_whole_bins():
    assert np.array_equal(PROBABILITY_EDGES.astype(np.float32), PROBABILITY_EDGES)
    assert (np.diff(PROBABILITY_EDGES) > 0).all()
    for edges in (PROBABILITY_EDGES, CALIBRATION_EDGES):
        assert (edges[0], edges[-1], 0.5 in edges) == (0.0, 1.0, True)
    assert set(CALIBRATION_EDGES) <= set(PROBABILITY_EDGES)
    assert metrics.THOUGHT_OCCUPIED in CALIBRATION_EDGES


def test_scores_of_an_empty_tally_are_undefined():
    tally = Tally.empty(2)
    for score in (metrics.average_precision, metrics.brier_score, metrics.log_loss, metrics.calibration_error):
        assert np.isnan(score(tally)).all()
    assert np.isnan(metrics.f1_score(tally.confusion(half(2).bins))).all()


def test_f1_is_zero_where_no_occupied_cell_is_found_and_undefined_without_occupied_cells():
    assert metrics.f1_score(np.array([0, 0, 4, 6])) == 0.0
    assert np.isnan(metrics.f1_score(np.array([0, 3, 0, 6])))


def test_tallies_add_up():
    one, other = (count(*random_case(seed)) for seed in (1, 2))
    total = Tally.empty(3)
    total.add(one)
    total.add(other)
    assert np.array_equal(total.cells, one.cells + other.cells)
    assert total.log_loss == pytest.approx(one.log_loss + other.log_loss)
